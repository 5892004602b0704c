// The one implementation of Reconstructor, over any Exec.
#pragma once
#include "backends/backend.hpp"
#include "sweep/grid.hpp"
#include "sweep/plus.hpp"

namespace globule::core {

template <class Exec> class ReconstructorImpl final : public Reconstructor {
public:
    template <class... Args>
    explicit ReconstructorImpl(Args&&... args) : exec_(std::forward<Args>(args)...), plus_(exec_) {}

    int device() const noexcept override { return exec_.device(); }
    void begin() override { exec_.interrupt().clear(); }
    void cancel() noexcept override { exec_.interrupt().request(); }

    void plus(PlusRequest& request) override { plus_.run(request); }

    SweepGrid* grid(ScalarType type) override {
        if (!grid_ || type != type_) {
            grid_.reset();
            type_ = type;
            if (type == ScalarType::u8) grid_ = std::make_unique<GridImpl<Exec, std::uint8_t>>(exec_);
            else if (type == ScalarType::u16) grid_ = std::make_unique<GridImpl<Exec, std::uint16_t>>(exec_);
            else grid_ = std::make_unique<GridImpl<Exec, float>>(exec_);
        }
        return grid_.get();
    }
    std::uint64_t free_bytes() override { return exec_.free_bytes(); }

private:
    Exec exec_;
    Plus<Exec> plus_;
    ScalarType type_{};
    std::unique_ptr<SweepGrid> grid_;
};

}  // namespace globule::core
