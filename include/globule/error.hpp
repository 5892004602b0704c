// What globule throws.
#pragma once
#include <stdexcept>
#include <string>

#include "globule/version.hpp"

namespace globule {

enum class ErrorCode {
    invalid,    ///< an argument; nothing was changed
    cancelled,  ///< the call was interrupted; the object is as it was, or asks to be updated
    stale,      ///< an interrupted or failed call left nothing to ask: update the object first
    busy,       ///< the same thread is inside another call on this object (a signal handler, say)
    forked,     ///< this process was forked from one that had used globule
    memory,     ///< not enough memory, of the host or of the device
    device,     ///< the device, its driver or its backend library cannot be used
    internal,   ///< anything else; the message says what
    diverged    ///< a simulation's step made a velocity that is not a number
};

/// The only exception that leaves globule's calls, but for std::bad_alloc where a returned array finds no room. what():
/// one line that names the argument, what was expected and what came.
class GLOBULE_API Error : public std::runtime_error {
public:
    Error(ErrorCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    ~Error() override;
    ErrorCode code() const noexcept { return code_; }

private:
    ErrorCode code_;
};

}  // namespace globule
