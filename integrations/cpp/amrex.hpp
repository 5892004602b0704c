// Particles of AMReX's tiles: structs of each tile's array go into one array of positions, as float32, in one pass.
//
//     globule::adaptors::AMReXTiles tiles;
//     tiles.clear();
//     for (amrex::ParIter<...> it(container, level); it.isValid(); ++it) tiles.add(it.GetParticleTile(), Comp::speed);
//     scene.update(tiles.particles());
#pragma once
#include <globule/globule.hpp>

#include <vector>

namespace globule::adaptors {

/// The particles of several tiles in host memory.
class AMReXTiles {
public:
    /// origin: subtracted before positions become float32, whose digits end far from 0; world.
    explicit AMReXTiles(Vec3 origin = {0, 0, 0}) : origin_(origin) {}

    /// Forget the tiles of the last step; the memory stays.
    void clear() { positions_.clear(), values_.clear(); }

    /// The particles of a tile (amrex::ParticleTile), without those that AMReX has marked as gone (id <= 0).
    /// component: of the real ones in the tile's struct of arrays, for `values`; -1: none.
    template <class Tile> void add(const Tile& tile, int component = -1) {
        const auto& structs = tile.GetArrayOfStructs();
        const std::size_t n = std::size_t(structs.numParticles()), before = positions_.size() / 3;
        positions_.resize(3 * (before + n));
        float* out = positions_.data() + 3 * before;
        const auto* values = component < 0 ? nullptr : tile.GetStructOfArrays().GetRealData(component).data();
        for (std::size_t i = 0; i < n; ++i) {
            const auto& particle = structs[i];
            if (!(particle.id() > 0)) continue;
            for (int k = 0; k < 3; ++k) *out++ = float(particle.pos(k) - origin_[std::size_t(k)]);
            if (values) values_.push_back(float(values[i]));
        }
        positions_.resize(std::size_t(out - positions_.data()));
    }

    /// All particles that were added.  They stay valid until the next `clear` or `add`.
    Particles particles() const { return {.positions = {positions_.data(), Shape(size(), 3)}}; }
    /// Of each of them, the component.
    const std::vector<float>& values() const { return values_; }
    std::size_t size() const { return positions_.size() / 3; }

private:
    Vec3 origin_;
    std::vector<float> positions_{}, values_{};
};

}  // namespace globule::adaptors
