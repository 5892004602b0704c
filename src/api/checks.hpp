// Checks of single arguments, and arrays of the caller's where an object can use them.  Each message names the
// argument, what was expected and what came.
#pragma once
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "api/guard.hpp"
#include "globule/array.hpp"
#include "globule/vector.hpp"

namespace globule {

[[noreturn]] inline void refuse(const std::string& name, const std::string& expected, const std::string& got) {
    throw Error(ErrorCode::invalid, name + ": expected " + expected + ", got " + got);
}

std::string text(double value);
std::string text(const Vec3& value);
std::string text(const Shape& shape);
const char* name_of(DType type);
/// Of a device, as core numbers them.
std::string name_of_device(int device);

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// A finite number in [least, most].
float number(const char* name, double value, double least = -kInfinity, double most = kInfinity);
/// A finite number above 0.
double positive(const char* name, double value);
int whole(const char* name, int value, int least, int most);
/// Three finite numbers in [least, most], as single precision has them.
core::float3 three(const char* name, const Vec3& value, double least = -kInfinity, double most = kInfinity);
/// A direction, made of unit length; made of single precision first, as in Python.
Vec3 unit(const char* name, const Vec3& value);
inline core::float3 single(const Vec3& v) { return {float(v[0]), float(v[1]), float(v[2])}; }

inline double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline double norm(const Vec3& a) { return std::sqrt(dot(a, a)); }
inline Vec3 cross(const Vec3& a, const Vec3& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline Vec3 operator*(const Vec3& a, double s) { return {a[0] * s, a[1] * s, a[2] * s}; }
inline Vec3 operator+(const Vec3& a, const Vec3& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Vec3 operator-(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

/// Rows of a view that holds `columns` numbers in each: (n, columns) or flat; columns 1: (n,) or (n, 1).
std::size_t rows_of(const char* name, const ArrayView& view, std::size_t columns);

/// Of n numbers of one type in host memory; null where none is given.
const void* on_host(const std::string& name, const ArrayView& view, DType type, std::size_t n);
template <class T> const T* on_host(const std::string& name, const ArrayView& view, std::size_t n) {
    return static_cast<const T*>(on_host(name, view, dtype_of<T>(), n));
}
template <class T> T* out_on_host(const std::string& name, const MutableArrayView& view, std::size_t n) {
    return static_cast<T*>(const_cast<void*>(on_host(name, view, dtype_of<T>(), n)));
}

/// Arrays that an object on `device` reads, as float32, and the copies that this takes; it lives as long as they are
/// read.
class Inputs {
public:
    explicit Inputs(int device) : arrays_(device), device_(device) {}

    /// Of n rows.
    core::FloatArray floats(const char* name, const ArrayView& view, std::size_t columns, std::size_t n);
    /// As above, of any number of rows, which it tells.
    core::FloatArray rows(const char* name, const ArrayView& view, std::size_t columns, std::size_t& n) {
        n = rows_of(name, view, columns);
        return floats(name, view, columns, n);
    }
    core::AnyArray bytes(const char* name, const ArrayView& view) {
        return arrays_.reach_bytes(
            name, {view.data(), view.where().device, view.where().stream}, view.shape().size() * size_of(view.dtype()));
    }
    /// An array of ours.
    core::FloatArray keep(std::vector<float> values) {
        return {converted_.emplace_back(std::move(values)).data(), core::kHost, 0};
    }

private:
    core::Arrays arrays_;
    int device_;
    std::vector<std::vector<float>> converted_;
};

/// An array of results, in host memory or that of any GPU, to which they are copied.  No array: nobody wants them.
class Output {
public:
    Output(const char* name, const MutableArrayView& view, DType type, std::size_t n);
    template <class T> T* as() { return static_cast<T*>(room_.empty() ? to_.data : room_.data()); }
    void deliver() const;

private:
    core::ArrayAt<void> to_;
    std::vector<char> room_;
};

/// Throws unless all numbers of a host array are finite and in [least, most]; arrays on a GPU are not looked at.
void check_range(
    const char* name, const core::FloatArray& array, std::size_t n, std::size_t columns, double least, double most);

}  // namespace globule
