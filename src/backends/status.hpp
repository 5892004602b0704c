// What a call across a library's border comes back with: a code and a message, never an exception.
#pragma once
#include <stdexcept>
#include <string>

namespace globule::core {

enum class Code : int { ok, cancelled, refused, stale, memory, device, failed };

struct Status {
    Code code = Code::ok;
    std::string message;
};

/// The caller's mistake, found before anything was changed.
struct Refused : std::invalid_argument { using std::invalid_argument::invalid_argument; };
/// What the call needs was half made by one that was interrupted or failed; it has to be made again first.
struct Stale : std::logic_error { using std::logic_error::logic_error; };

}  // namespace globule::core
