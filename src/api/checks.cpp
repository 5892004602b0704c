#include "api/checks.hpp"

#include <cstdio>

#include "backends/open.hpp"

namespace globule {

std::string text(double value) {
    char out[32];
    std::snprintf(out, sizeof out, "%g", value);
    return out;
}
std::string text(const Vec3& v) { return std::string("(") + text(v[0]) + ", " + text(v[1]) + ", " + text(v[2]) + ")"; }
std::string text(const Shape& shape) {
    std::string out = "(";
    for (int k = 0; k < shape.rank(); ++k) out += (k ? ", " : "") + std::to_string(shape[k]);
    return out + (shape.rank() == 1 ? ",)" : ")");
}
const char* name_of(DType type) {
    constexpr const char* names[] = {"uint8", "uint16", "uint32", "uint64", "int32", "int64", "float32", "float64"};
    return names[int(type)];
}
std::string name_of_device(int device) {
    return device == core::kHost         ? "the host"
           : device == core::kSomeDevice ? "a GPU"
                                         : "cuda:" + std::to_string(device);
}

namespace {
std::string range(double least, double most) {
    if (most < kInfinity) return text(least) + " to " + text(most);
    return least > -kInfinity ? "a number >= " + text(least) : "a finite number";
}
}  // namespace

float number(const char* name, double value, double least, double most) {
    if (!(std::isfinite(value) && value >= least && value <= most)) refuse(name, range(least, most), text(value));
    return float(value);
}
double positive(const char* name, double value) {
    if (!(std::isfinite(value) && value > 0)) refuse(name, "a positive number", text(value));
    return value;
}
int whole(const char* name, int value, int least, int most) {
    if (value < least || value > most)
        refuse(name, std::to_string(least) + " to " + std::to_string(most), std::to_string(value));
    return value;
}
core::float3 three(const char* name, const Vec3& value, double least, double most) {
    const core::float3 v = single(value);
    for (const double x : {double(v.x), double(v.y), double(v.z)})
        if (!(std::isfinite(x) && x >= least && x <= most))
            refuse(name,
                "three finite numbers" + (least > -kInfinity || most < kInfinity ? ", " + range(least, most) : ""),
                text(value));
    return v;
}
Vec3 unit(const char* name, const Vec3& value) {
    const core::float3 v = three(name, value);
    const Vec3 d{v.x, v.y, v.z};
    const double length = norm(d);
    if (!(length > 0)) refuse(name, "a direction", text(value));
    return {d[0] / length, d[1] / length, d[2] / length};
}

std::size_t rows_of(const char* name, const ArrayView& view, std::size_t columns) {
    const Shape& s = view.shape();
    if (s.rank() == 2 && s[1] == columns) return s[0];
    if (s.rank() == 1 && s[0] % columns == 0) return s[0] / columns;
    if (s.rank() == 3 && s[1] * s[2] == columns) return s[0];
    const std::string each = std::to_string(columns);
    refuse(name, columns == 1 ? "shape (N,)" : "shape (N, " + each + ") or (" + each + " N,)", text(s));
}

const void* on_host(const std::string& name, const ArrayView& view, DType type, std::size_t n) {
    if (!view.given()) return nullptr;
    if (view.where().device != Location::host || view.dtype() != type)
        refuse(name, std::string(name_of(type)) + " in host memory",
            view.where().device == Location::host ? name_of(view.dtype()) : "memory of a GPU");
    if (view.shape().size() != n) refuse(name, std::to_string(n) + " numbers", text(view.shape()));
    if (n && !view.data()) refuse(name, "an address", "null");
    return view.data();
}

core::FloatArray Inputs::floats(const char* name, const ArrayView& view, std::size_t columns, std::size_t n) {
    if (const std::size_t there = rows_of(name, view, columns); there != n)
        refuse(name, std::to_string(n) + " rows", std::to_string(there));
    if (n && !view.data()) refuse(name, "an address", "null");
    if (view.dtype() == DType::float32) {
        const core::AnyArray a = bytes(name, view);
        return {static_cast<const float*>(a.data), a.device, a.stream};
    }
    const bool convertible = view.dtype() == DType::float64 || (view.dtype() == DType::uint8 && columns == 3);
    if (view.where().device != Location::host || !convertible)
        refuse(name, view.where().device == Location::host ? "float32 or float64" : "float32 on a GPU",
            name_of(view.dtype()));
    std::vector<float>& to = converted_.emplace_back(n * columns);
    if (view.dtype() == DType::float64) {
        const double* from = static_cast<const double*>(view.data());
        for (std::size_t i = 0; i < to.size(); ++i) to[i] = float(from[i]);
    } else {
        const std::uint8_t* from = static_cast<const std::uint8_t*>(view.data());
        for (std::size_t i = 0; i < to.size(); ++i) to[i] = float(from[i]) / 255.0f;
    }
    return {to.data(), core::kHost, 0};
}

Output::Output(const char* name, const MutableArrayView& view, DType type, std::size_t n) {
    const std::size_t bytes = n * size_of(type);
    if (!view.shape().rank()) {
        room_.resize(bytes);
        return;
    }
    if (view.dtype() != type) refuse(name, std::string("an array of ") + name_of(type), name_of(view.dtype()));
    if (view.shape().size() != n) refuse(name, std::to_string(n) + " numbers", text(view.shape()));
    if (n && !view.data()) refuse(name, "an address", "null");
    const core::AnyArray found =
        core::Arrays(core::kHost + 1).reach_bytes(name, {view.data(), view.where().device, view.where().stream}, bytes);
    to_ = {view.data(), found.device, found.stream};
    if (found.device != core::kHost) room_.resize(bytes);
}
void Output::deliver() const {
    if (to_.data && !room_.empty())
        core::check_status(core::open_backend("cuda").deliver(to_, room_.data(), room_.size()));
}

void check_range(
    const char* name, const core::FloatArray& array, std::size_t n, std::size_t columns, double least, double most) {
    if (!array.data || array.device != core::kHost) return;
    const float lo = float(least), hi = float(most), limit = std::numeric_limits<float>::max();
    for (std::size_t i = 0; i < n * columns; ++i) {
        const float v = array.data[i];
        if (!(v >= lo && v <= hi && v >= -limit && v <= limit))
            refuse(name, range(least, most), text(v) + " (particle " + std::to_string(i / columns) + ")");
    }
}

}  // namespace globule
