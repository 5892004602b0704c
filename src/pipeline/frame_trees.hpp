// The octree of the present frame.  On a device the next frame's is built beside it, on a stream of its own, while
// the present one is still being traced: a build is many short steps that leave most of the device idle.
#pragma once
#include <memory>

#include "octree/build.hpp"

namespace globule::core {

template <class Exec>
class FrameTrees {
public:
    explicit FrameTrees(std::shared_ptr<Exec> exec) : exec_(std::move(exec)), builder_(exec_) {
        trees_[0] = std::make_unique<Octree<Exec>>(*exec_);
    }

    Octree<Exec>& now() const { return *trees_[now_]; }

    /// Where the next tree will be built and its input has to be.  A scene that is built once needs no second tree.
    Exec& next_exec() {
        if constexpr (Exec::on_device) {
            if (n_builds_ == 1 && builder_ == exec_ && exec_->free_bytes() / 4 > now().bytes()) {
                builder_ = exec_->sibling(true);
                builder_->follow(*exec_);
            }
        }
        return *builder_;
    }

    void build(const ParticleInput& in, const TreeParams& params) {
        Exec& exec = next_exec();
        const bool beside = &exec != exec_.get();
        if constexpr (Exec::on_device) {
            if (beside) {
                exec.follow(*exec_, kRead);  // what reads the older tree was asked for before the last build
                exec_->mark(kRead);
                now_ = 1 - now_;
                if (n_builds_ <= 2) trees_[now_] = std::make_unique<Octree<Exec>>(exec);
            }
        }
        exec.mark(0);
        now().build(in, params);
        exec.mark(1);
        if (beside) exec_->follow(exec);
        ++n_builds_;
    }
    /// Waits for the last build.
    double build_seconds() { return builder_->elapsed(0, 1); }

private:
    static constexpr int kRead = 4;  ///< marks 0 to 3: build and trace

    std::shared_ptr<Exec> exec_, builder_;
    std::unique_ptr<Octree<Exec>> trees_[2];
    int now_ = 0;
    std::size_t n_builds_ = 0;
};

}  // namespace globule::core
