// What a program is asked while calls work.
#pragma once
#include <atomic>

namespace globule {

/// What the thread that made a call asks now and then: a place to show that work goes on, and to end it.  It must
/// outlive the objects that have it.
struct Poll {
    static constexpr int kPause = 50;   ///< ms
    bool (*stop)();                     ///< true: the call ends with Error: cancelled
    std::atomic<int> pause_ms{kPause};  ///< between two questions, and before the first of a call
};

}  // namespace globule
