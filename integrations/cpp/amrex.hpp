// Particles of AMReX's tiles: structs of each tile's array go into one array of positions, as float32, in one pass.
//
//     globule::adaptors::AMReXTiles tiles;
//     tiles.clear();
//     for (amrex::ParIter<...> it(container, level); it.isValid(); ++it) tiles.add(it.GetParticleTile(), Comp::speed);
//     scene.update(tiles.particles());
#pragma once
#include <globule/globule.hpp>

#include <array>
#include <vector>

namespace globule::adaptors {

/// The particles of several tiles in host memory.
class AMReXTiles {
public:
    /// origin: subtracted before positions become float32, whose digits end far from 0; world.
    explicit AMReXTiles(Vec3 origin = {0, 0, 0}) : origin_(origin) {}

    /// Forget the tiles of the last step; the memory stays.
    void clear() { positions_.clear(), values_.clear(); }

    /// The particles of a tile (amrex::ParticleTile, also of a container that is a pure struct of arrays), without
    /// those that AMReX has marked as gone.  component: of the real ones in the tile's struct of arrays, for `values`;
    /// -1: none.
    template <class Tile> void add(const Tile& tile, int component = -1) {
        const auto& arrays = tile.GetStructOfArrays();
        const auto* values = component < 0 ? nullptr : arrays.GetRealData(component).data();
        if constexpr (requires { requires Tile::ParticleType::is_soa_particle; }) {
            const auto* ids = arrays.GetIdCPUData().data();
            const std::array at{
                arrays.GetRealData(0).data(), arrays.GetRealData(1).data(), arrays.GetRealData(2).data()};
            each(
                std::size_t(tile.numParticles()), values, [&](std::size_t i) { return bool(ids[i] >> 63); },
                [&](std::size_t i, int k) { return at[k][i]; });
        } else {
            const auto& structs = tile.GetArrayOfStructs();
            each(
                std::size_t(tile.numParticles()), values, [&](std::size_t i) { return structs[int(i)].id() > 0; },
                [&](std::size_t i, int k) { return structs[int(i)].pos(k); });
        }
    }

    /// All particles that were added.  They stay valid until the next `clear` or `add`.
    Particles particles() const { return {.positions = {positions_.data(), Shape(size(), 3)}}; }
    /// Of each of them, the component.
    const std::vector<float>& values() const { return values_; }
    std::size_t size() const { return positions_.size() / 3; }

private:
    template <class Value, class There, class Place>
    void each(std::size_t n, const Value* values, const There& there, const Place& place) {
        const std::size_t before = positions_.size();
        positions_.resize(before + 3 * n);
        float* out = positions_.data() + before;
        for (std::size_t i = 0; i < n; ++i) {
            if (!there(i)) continue;
            for (int k = 0; k < 3; ++k) *out++ = float(place(i, k) - origin_[std::size_t(k)]);
            if (values) values_.push_back(float(values[i]));
        }
        positions_.resize(std::size_t(out - positions_.data()));
    }

    Vec3 origin_;
    std::vector<float> positions_{}, values_{};
};

}  // namespace globule::adaptors
