// Cuts of tissue: the blade on its grid, and the pieces that are left.
#pragma once
#include "sim/tissue.hpp"

namespace globule::core {

template <class Exec> std::uint32_t TissueImpl<Exec>::cut(const BladeSweep& blade) {
    if (n_ == 0 || blade.n_triangles == 0) return 0;
    const tissue::SweptSurface sweep = on_grid(blade);
    const float3* before = blade.n_moving ? before_.data() : nullptr;
    return counted(
        [&](std::uint32_t* n_cut) { exec_.for_each(n_, tissue::Cut{bonds(), at_.data(), before, sweep, n_cut}); });
}

template <class Exec> tissue::SweptSurface TissueImpl<Exec>::on_grid(const BladeSweep& blade) {
    tissue::SweptSurface sweep;
    sweep.grid.cells_per_unit = std::exp2(std::floor(std::log2(65536.0 / contact_)));
    std::vector<tissue::GridPoint> vertices(blade.n_vertices);
    double lo[3] = {1e300, 1e300, 1e300}, hi[3] = {-1e300, -1e300, -1e300};
    for (std::uint32_t v = 0; v < blade.n_vertices; ++v) {
        const double* p = blade.vertices + 3 * std::size_t(v);
        vertices[v] = {sweep.grid.snap(p[0], 0), sweep.grid.snap(p[1], 1), sweep.grid.snap(p[2], 2)};
        for (int k = 0; k < 3; ++k) lo[k] = std::min(lo[k], p[k]), hi[k] = std::max(hi[k], p[k]);
    }
    const double margin = 1e-3 * contact_;
    sweep.lo = {float(lo[0] - margin), float(lo[1] - margin), float(lo[2] - margin)};
    sweep.hi = {float(hi[0] + margin), float(hi[1] + margin), float(hi[2] + margin)};
    put(vertices_, vertices.data(), vertices.size());
    put(triangles_, blade.triangles, 3 * std::size_t(blade.n_triangles));
    sweep.vertices = vertices_.data();
    sweep.triangles = triangles_.data();
    sweep.n = blade.n_triangles;
    sweep.n_moving = blade.n_moving;
    return sweep;
}

template <class Exec> std::uint32_t TissueImpl<Exec>::pieces() {
    if (pieces_known_) return n_pieces_;
    std::uint32_t* label = label_.reserve(n_);
    find_labels(label);
    std::uint32_t* least_id = least_id_.reserve(n_);
    exec_.for_each(n_, sim::Fill{least_id, ~0u});
    n_pieces_ = count(
        [&](std::uint32_t* n) { exec_.for_each(n_, tissue::LeastId{label, id_.data(), hold_.data(), least_id, n}); });
    exec_.for_each(n_, tissue::TakeLeastId{label, least_id, piece_.reserve(n_)});
    pieces_known_ = true;
    return n_pieces_;
}

template <class Exec> void TissueImpl<Exec>::find_labels(std::uint32_t* label) {
    exec_.for_each(n_, tissue::OwnLabel{label});
    for (std::uint32_t changed = n_ > 0; changed;) {
        std::uint32_t* flag = count_.reserve(1);
        exec_.clear(flag, sizeof *flag);
        exec_.for_each(n_, tissue::Hook{bonds(), label, flag});
        exec_.for_each(n_, tissue::Jump{label});
        exec_.download(&changed, flag, sizeof changed);
    }
}

}  // namespace globule::core
