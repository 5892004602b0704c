// Where an array lies.
#pragma once
#include <cstdint>
#include <stdexcept>

namespace globule::core {

inline constexpr int kHost = -1;        ///< memory that the processor reads, page-locked or not
inline constexpr int kSomeDevice = -2;  ///< memory of a GPU; which one its address tells
inline constexpr int kPinned = -3;      ///< host memory that a GPU writes by itself (BackendApi::take_pinned)

/// An array of the caller's: its address, whose memory that is (kHost, or a GPU's number), and the stream on which
/// it is written or read there: 0 none to wait for, else as __cuda_array_interface__ counts.
template <class T> struct ArrayAt {
    T* data = nullptr;
    int device = kHost;
    std::uintptr_t stream = 0;
};
using FloatArray = ArrayAt<const float>;
using AnyArray = ArrayAt<const void>;

/// What the device or its driver could not do.
struct DeviceFailure : std::runtime_error { using std::runtime_error::runtime_error; };

}  // namespace globule::core
