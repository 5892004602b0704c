// The rays of one tile: which they are, and how far each has come.
#pragma once
#include "trace/camera.hpp"
#include "trace/hits.hpp"

namespace globule::core {

/// Tiles of `size` rays: of a picture, rectangles of pixels `across` wide, or of all kDither-th pixels of larger ones;
/// else rays that follow one another.  Where pixels have several rays, a rectangle has as many tiles, which its marked
/// pixels' rays fill one after the other.
template <int across, int size> struct TileLayout {
    const RaySource& rays;
    std::uint32_t* marked = nullptr;  ///< pixels of the rectangle that have several rays
    int n_marked = 0;
    static constexpr int kHeight = (size + across - 1) / across;
    static_assert(across <= Share::kTile && kHeight <= Share::kTile && RaySource::kBlock % size == 0);

    GB_FN std::size_t n_tiles() const {
        if (rays.origins && !rays.of_pixels) return ceil_div<std::size_t>(rays.n, size);
        const int step = rays.apart ? int(kDither) : 1;
        return std::size_t(ceil_div(rays.camera.width, across * step)) * ceil_div(rays.rows(), kHeight * step) * step *
               step * rays.samples;
    }
    /// Ray k of a tile; rays.n_rays(): none.
    GB_FN std::size_t ray(std::size_t tile, int k) const {
        if (rays.origins && !rays.of_pixels) return tile * size + k;
        if (rays.samples == 1) return pixel(std::uint32_t(tile), k);
        const std::uint32_t at = std::uint32_t(tile % rays.samples) * size + k, of = at / rays.samples;
        return int(of) < n_marked ? marked[of] + rays.n * (at - of * rays.samples) : rays.n_rays();
    }
    /// Before the rays of such a tile are asked for; false: it has none.
    template <class Group> GB_FN bool mark(Group& g, std::size_t tile, std::uint32_t* room) {
        marked = room;
        for (int first = 0; first < size; first += Group::width) {
            typename Group::B has = g.none();
            Group::for_lanes([&](int lane) {
                const std::size_t i = pixel(std::uint32_t(tile / rays.samples), first + g.lane_number(lane));
                Group::put(has, lane, i < rays.n && rays.only[i]);
            });
            n_marked = g.append(has, n_marked, [&](int lane, int place) {
                marked[place] = std::uint32_t(pixel(std::uint32_t(tile / rays.samples), first + lane));
            });
        }
        g.sync();
        return n_marked * int(rays.samples) > int(tile % rays.samples) * size;
    }

private:
    /// Pixel k of a rectangle; rays.n: none.
    GB_FN std::size_t pixel(std::uint32_t at, int k) const {
        const std::uint32_t step = rays.apart ? kDither : 1, which = at % (step * step);
        at /= step * step;
        const std::uint32_t columns = ceil_div(rays.camera.width, across * int(step));
        const int x = int((at % columns * across + k % across) * step + which % step);
        const int y = int((at / columns * kHeight + k / across) * step + which / step);
        return x < rays.camera.width && y < rays.rows() ? std::size_t(y) * rays.camera.width + x : rays.n;
    }
};

/// In a group's vectors of lanes, a ray a lane.
template <class Group> struct TileRays {
    using F = typename Group::F;
    using B = typename Group::B;
    static constexpr int V = Group::vectors;
    using Layout = TileLayout<8, Group::width * V>;

    Vec3<F> o[V], d[V];
    F t[V];        ///< no root before
    F sign[V];     ///< +1 outside, -1 inside
    B pending[V];  ///< may still hit
    B fresh[V];    ///< not known yet whether it begins inside
    B missed[V];   ///< neither hit nor left undecided so far

    /// Rays of the tile up to where they meet `box`; `slack` makes up for rounding there.  They begin at `from`; known:
    /// outside.
    GB_FN void start(Group& g, const Layout& layout, std::size_t tile, const float3& lo, const float3& hi, float slack,
        float from = 0.0f, bool known = false) {
        for (int v = 0; v < V; ++v) {
            const B valid = load(g, layout, tile, v);
            // Slab test; per axis, a direction of zero never divides.
            F enter(0.0f), leave(infinity());
            const auto axis = [&](const F& from, const F& along, float low, float high) {
                const F safe = select(abs(along) > F(1e-18f), along, F(1e-18f));
                const F a = (F(low) - from) / safe, b = (F(high) - from) / safe;
                enter = max(enter, min(a, b));
                leave = min(leave, max(a, b));
            };
            axis(o[v].x, d[v].x, lo.x, hi.x);
            axis(o[v].y, d[v].y, lo.y, hi.y);
            axis(o[v].z, d[v].z, lo.z, hi.z);
            pending[v] = valid & (enter <= leave * F(1.00001f));
            t[v] = max(enter * F(0.99999f) - F(slack), F(from));
            fresh[v] = known ? g.none() : !(t[v] > F(0.0f));
            sign[v] = F(1.0f);
            missed[v] = valid;
        }
    }
    /// Nothing reaches these rays before z: they are outside there, and no root lies before.
    GB_FN void advance(const B* which, float z) {
        for (int v = 0; v < V; ++v) {
            const B moved = which[v] & (F(z) > t[v]);
            t[v] = select(moved, F(z), t[v]);
            fresh[v] = fresh[v] & !moved;
        }
    }

private:
    /// Origins and directions of one vector's rays; returns the lanes that have one.
    GB_FN B load(Group& g, const Layout& layout, std::size_t tile, int v) {
        const RaySource& rays = layout.rays;
        F column(0.0f), row(0.0f), ox(0.0f), oy(0.0f), oz(0.0f), dx(0.0f), dy(0.0f), dz(1.0f);
        B valid = g.none();
        g.per_lane(g.first_lanes(Group::width), [&](int lane) {
            const std::size_t i = layout.ray(tile, v * Group::width + lane);
            const bool is_there = i < rays.n_rays() && (rays.samples > 1 || rays.has(i, Share::kTile));
            Group::put(valid, lane, is_there);
            if (!is_there) return;
            if (rays.origins) {
                Group::put(ox, lane, rays.origins[3 * i]);
                Group::put(oy, lane, rays.origins[3 * i + 1]);
                Group::put(oz, lane, rays.origins[3 * i + 2]);
                Group::put(dx, lane, rays.directions[3 * i]);
                Group::put(dy, lane, rays.directions[3 * i + 1]);
                Group::put(dz, lane, rays.directions[3 * i + 2]);
            } else {
                float x, y;
                rays.on_picture(i, x, y);
                Group::put(column, lane, x);
                Group::put(row, lane, y);
            }
        });
        o[v] = {ox, oy, oz};
        d[v] = {dx, dy, dz};
        if (!rays.origins) rays.camera(column, row, o[v], d[v]);
        return valid;
    }
};

}  // namespace globule::core
