// Memory that a backend owns; grows, never shrinks, so that a steady state allocates nothing.
#pragma once
#include <cstddef>
#include <utility>

#include "base/fn.hpp"

namespace globule::core {

template <class T, class Exec> class Buffer {
public:
    explicit Buffer(Exec& exec) : exec_(&exec) {}
    Buffer(const Buffer&) = delete;
    Buffer& operator=(const Buffer&) = delete;
    ~Buffer() { exec_->release(data_); }

    /// At least n items; contents are lost when it grows.  What grew once will again: then there is room for an eighth
    /// more.
    T* reserve(std::size_t n) {
        if (n > capacity_) {
            if (capacity_ > 0) n += n / 8;
            exec_->release(data_);
            data_ = nullptr;
            capacity_ = 0;
            data_ = static_cast<T*>(exec_->allocate(n * sizeof(T)));
            capacity_ = n;
        }
        return data_;
    }
    /// As reserve, 0 where nothing was written yet: groups of lanes read past the last item.
    T* reserve_zero(std::size_t n) {
        const bool grows = n > capacity_;
        T* data = reserve(n);
        if (grows) exec_->clear(data, capacity_ * sizeof(T));
        return data;
    }
    /// At least n items, the first `used` as they were; half as many again when it grows.
    T* keep(std::size_t used, std::size_t n) {
        if (n <= capacity_) return data_;
        if (used == 0) return reserve(n);
        const std::size_t room = n + n / 2;
        data_ = static_cast<T*>(exec_->extend(data_, used * sizeof(T), room * sizeof(T)));
        capacity_ = room;
        return data_;
    }
    void swap(Buffer& other) {
        std::swap(data_, other.data_);
        std::swap(capacity_, other.capacity_);
    }
    T* data() const { return data_; }
    std::size_t bytes() const { return capacity_ * sizeof(T); }
    std::size_t capacity() const { return capacity_; }

private:
    Exec* exec_;
    T* data_ = nullptr;
    std::size_t capacity_ = 0;
};

}  // namespace globule::core
