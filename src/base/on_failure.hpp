// What has to be put right when a scope is left by an exception.
#pragma once
#include <exception>
#include <utility>

namespace globule::core {

/// Calls fn when its scope is left by an exception; what fn throws then is lost.
template <class Fn> class OnFailure {
public:
    explicit OnFailure(Fn fn) : fn_(std::move(fn)) {}
    ~OnFailure() {
        if (std::uncaught_exceptions() == before_) return;
        try {
            fn_();
        } catch (...) {}
    }
    OnFailure(const OnFailure&) = delete;
    OnFailure& operator=(const OnFailure&) = delete;

private:
    Fn fn_;
    int before_ = std::uncaught_exceptions();
};

}  // namespace globule::core
