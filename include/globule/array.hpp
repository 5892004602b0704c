// Arrays that belong to the caller: address, shape, type, device, stream.
//
// A view owns nothing.  globule uses an array where it lies if that is the object's device, and copies it otherwise:
// from a GPU to the host for a CPU object, from the host or another GPU to a GPU object.
#pragma once
#include <array>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

namespace globule {

enum class DType : int { uint8, uint16, uint32, uint64, int32, int64, float32, float64 };

template <class T>
concept Element = std::same_as<T, std::uint8_t> || std::same_as<T, std::uint16_t> || std::same_as<T, std::uint32_t> ||
                  std::same_as<T, std::uint64_t> || std::same_as<T, std::int32_t> || std::same_as<T, std::int64_t> ||
                  std::same_as<T, float> || std::same_as<T, double>;

template <Element T> constexpr DType dtype_of() {
    if constexpr (std::same_as<T, std::uint8_t>) return DType::uint8;
    else if constexpr (std::same_as<T, std::uint16_t>) return DType::uint16;
    else if constexpr (std::same_as<T, std::uint32_t>) return DType::uint32;
    else if constexpr (std::same_as<T, std::uint64_t>) return DType::uint64;
    else if constexpr (std::same_as<T, std::int32_t>) return DType::int32;
    else if constexpr (std::same_as<T, std::int64_t>) return DType::int64;
    else if constexpr (std::same_as<T, float>) return DType::float32;
    else return DType::float64;
}

/// Bytes of one element.
constexpr std::size_t size_of(DType type) {
    constexpr std::size_t bytes[] = {1, 2, 4, 8, 4, 8, 4, 8};
    return bytes[int(type)];
}

/// Whose memory an array is, and when it is complete.
struct Location {
    static constexpr int host = -1;      ///< memory that the processor reads, page-locked or not
    static constexpr int some_gpu = -2;  ///< memory of a GPU; the address tells which
    int device = host;                   ///< or the GPU's number
    /// The CUDA stream on which the array is written or read, as a number: 1 the default stream, 2 the per-thread
    /// default stream, else a cudaStream_t; 0: nothing to wait for.  globule reads an array after what the stream was
    /// given before the call, and the stream goes on after globule has read or written it.
    std::uintptr_t stream = 0;
};

/// Memory of a GPU that is ordered by a stream: cudaStream_t, nullptr for the default stream.
inline Location on_gpu(void* stream = nullptr, int device = Location::some_gpu) {
    return {device, stream ? reinterpret_cast<std::uintptr_t>(stream) : 1};
}

/// Up to four sizes, the last one contiguous: {n}, {n, 3}, {height, width, 3}, ...
class Shape {
public:
    constexpr Shape() = default;
    template <std::integral... I>
        requires(sizeof...(I) >= 1 && sizeof...(I) <= 4)
    constexpr Shape(I... sizes) : rank_(sizeof...(I)), sizes_{std::size_t(sizes)...} {}

    constexpr int rank() const { return rank_; }
    constexpr std::size_t operator[](int k) const { return sizes_[std::size_t(k)]; }
    /// Elements in all.
    constexpr std::size_t size() const {
        std::size_t n = rank_ ? 1 : 0;
        for (int k = 0; k < rank_; ++k) n *= sizes_[std::size_t(k)];
        return n;
    }
    constexpr bool operator==(const Shape&) const = default;

private:
    int rank_ = 0;
    std::array<std::size_t, 4> sizes_{};
};

/// An array that globule writes: contiguous, the last index fastest.
class MutableArrayView {
public:
    MutableArrayView() = default;
    template <Element T>
    MutableArrayView(T* data, Shape shape, Location where = {}) : MutableArrayView(data, dtype_of<T>(), shape, where) {}
    MutableArrayView(void* data, DType type, Shape shape, Location where = {})
        : data_(data), type_(type), shape_(shape), where_(where) {}
    template <Element T>
    MutableArrayView(std::vector<T>& values) : MutableArrayView(values.data(), Shape(values.size())) {}
    template <Element T>
    MutableArrayView(std::span<T> values) : MutableArrayView(values.data(), Shape(values.size())) {}

    void* data() const { return data_; }
    DType dtype() const { return type_; }
    const Shape& shape() const { return shape_; }
    const Location& where() const { return where_; }
    explicit operator bool() const { return data_ != nullptr; }

private:
    void* data_ = nullptr;
    DType type_ = DType::float32;
    Shape shape_;
    Location where_;
};

/// An array that globule reads: contiguous, the last index fastest.  It must stay alive and unchanged as long as the
/// function that takes it says, which is the call itself if it says nothing.
class ArrayView {
public:
    /// No array.
    ArrayView() = default;
    template <Element T>
    ArrayView(const T* data, Shape shape, Location where = {}) : ArrayView(data, dtype_of<T>(), shape, where) {}
    ArrayView(const void* data, DType type, Shape shape, Location where = {})
        : data_(data), type_(type), shape_(shape), where_(where) {}
    /// (n,) in host memory.
    template <Element T> ArrayView(const std::vector<T>& values) : ArrayView(values.data(), Shape(values.size())) {}
    template <Element T> ArrayView(std::span<const T> values) : ArrayView(values.data(), Shape(values.size())) {}
    template <Element T> ArrayView(std::span<T> values) : ArrayView(values.data(), Shape(values.size())) {}
    /// (n, K) in host memory.
    template <Element T, std::size_t K>
    ArrayView(const std::vector<std::array<T, K>>& rows)
        : ArrayView(rows.empty() ? nullptr : rows[0].data(), Shape(rows.size(), K)) {}
    template <Element T, std::size_t K>
    ArrayView(std::span<const std::array<T, K>> rows)
        : ArrayView(rows.empty() ? nullptr : rows[0].data(), Shape(rows.size(), K)) {}
    ArrayView(const MutableArrayView& a) : data_(a.data()), type_(a.dtype()), shape_(a.shape()), where_(a.where()) {}

    const void* data() const { return data_; }
    DType dtype() const { return type_; }
    const Shape& shape() const { return shape_; }
    const Location& where() const { return where_; }
    /// Whether there is an array; an empty one counts.
    bool given() const { return shape_.rank() > 0; }

private:
    const void* data_ = nullptr;
    DType type_ = DType::float32;
    Shape shape_;
    Location where_;
};

}  // namespace globule
