// The one implementation of Reconstructor, over any Exec.
#pragma once
#include "backend.hpp"
#include "plus.hpp"

namespace globule {

template <class Exec>
class ReconstructorOf final : public Reconstructor {
public:
    template <class... Args>
    explicit ReconstructorOf(Args&&... args) : exec_(std::forward<Args>(args)...), plus_(exec_) {}

    void plus(PlusRequest& request) override {
        plus_.run(request);
        check_cancelled();
    }

private:
    void check_cancelled() {
        if (!exec_.cancelled()) return;
        exec_.reset_cancelled();
        throw Cancelled{};
    }

    Exec exec_;
    PlusOf<Exec> plus_;
};

}  // namespace globule
