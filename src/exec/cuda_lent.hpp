// A GPU's memory that other GPUs of the host, and other processes, read without the host.  It is not of the pool, whose
// memory its own device and process alone see.
#pragma once
#include <cstring>
#include <vector>

#include "exec/cuda_check.hpp"
#include "exec/lent.hpp"

namespace globule::core {

/// What this object lends.  The caller's device is current.
class CudaLent {
public:
    CudaLent() = default;
    CudaLent(const CudaLent&) = delete;
    CudaLent& operator=(const CudaLent&) = delete;
    ~CudaLent() {
        if (data_) cudaFree(data_);
    }
    char* reserve(std::size_t bytes, int device) {
        if (bytes <= capacity_) return data_;
        if (data_) check(cudaFree(data_));
        data_ = nullptr;
        capacity_ = 0;
        check(cudaMalloc(reinterpret_cast<void**>(&data_), bytes));
        capacity_ = bytes;
        cudaIpcMemHandle_t handle;
        place_ = {getpid(), device, cudaIpcGetMemHandle(&handle, data_) == cudaSuccess, data_, {}};
        static_assert(sizeof handle == sizeof place_.handle);
        if (place_.has_handle) std::memcpy(place_.handle.data(), &handle, sizeof handle);
        else cudaGetLastError();
        return data_;
    }
    const LentPlace& place() const { return place_; }

private:
    char* data_ = nullptr;
    std::size_t capacity_ = 0;
    LentPlace place_;
};

/// What others lend to an object of one device.
class CudaBorrowed {
public:
    CudaBorrowed() = default;
    CudaBorrowed(const CudaBorrowed&) = delete;
    CudaBorrowed& operator=(const CudaBorrowed&) = delete;
    ~CudaBorrowed() {
        for (const Open& o : open_)
            if (o.data) cudaIpcCloseMemHandle(o.data);
    }
    /// Where kernels of `device` find what lender k lends; null: they cannot.
    const char* reach(std::size_t k, const LentPlace& place, int device) {
        if (place.device == kHost) return nullptr;
        if (place.is_here()) return may_read(device, place.device) ? place.address : nullptr;
        if (!place.has_handle) return nullptr;
        if (open_.size() <= k) open_.resize(k + 1);
        Open& o = open_[k];
        if (o.data && o.handle == place.handle) return static_cast<const char*>(o.data);
        if (o.data) cudaIpcCloseMemHandle(o.data);
        o = {nullptr, place.handle};
        cudaIpcMemHandle_t handle;
        std::memcpy(&handle, place.handle.data(), sizeof handle);
        if (cudaIpcOpenMemHandle(&o.data, handle, cudaIpcMemLazyEnablePeerAccess) != cudaSuccess) {
            cudaGetLastError();
            o.data = nullptr;
        }
        return static_cast<const char*>(o.data);
    }

private:
    struct Open {
        void* data = nullptr;
        std::array<char, 64> handle{};
    };
    /// `device` is current.
    static bool may_read(int device, int other) {
        if (device == other) return true;
        int can = 0;
        if (cudaDeviceCanAccessPeer(&can, device, other) == cudaSuccess && can) {
            const cudaError_t status = cudaDeviceEnablePeerAccess(other, 0);
            can = status == cudaSuccess || status == cudaErrorPeerAccessAlreadyEnabled;
        }
        cudaGetLastError();
        return can;
    }
    std::vector<Open> open_;
};

}  // namespace globule::core
