// The adaptor for AMReX on three tiles; every seventh particle is one that AMReX has marked as gone.
#include "amrex.hpp"
#include "amrex_like.hpp"
#include "drop.hpp"

int main() {
    try {
        using Tile = amrex_like::ParticleTile<4, 1>;
        const globule::Vec3 origin{1e6, -2e6, 0};  // float32 has steps of 0.06 there
        std::vector<Tile> tiles(3);
        for (Tile& tile : tiles) tile.soa.real.resize(2);
        const auto places = drop();
        const auto add = [&](std::size_t i, std::int64_t id, double up) {
            Tile& tile = tiles[i % tiles.size()];
            Tile::ParticleType particle{};
            for (std::size_t k = 0; k < 3; ++k) particle.m_pos[k] = places[i][k] + origin[k];
            particle.m_pos[1] += up;
            particle.set_id(id);
            tile.aos.push_back(particle);
            tile.soa.real[0].push_back(0);
            tile.soa.real[1].push_back(double(i) / double(places.size()));
        };
        for (std::size_t i = 0; i < places.size(); ++i) {
            add(i, std::int64_t(i) + 1, 0);
            if (i % 7 == 0) add(i, -std::int64_t(i) - 1, 1);
        }
        globule::adaptors::AMReXTiles all(origin);
        globule::Scene scene({.surface = globule::Surface::smooth, .spacing = kSpacing, .device = "cpu"});
        for (int step = 0; step < 2; ++step) {
            all.clear();
            for (const Tile& tile : tiles) all.add(tile, 1);
            scene.update(all.particles());
        }
        draw("amrex", scene, all.values(), false);
    } catch (const globule::Error& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
}
