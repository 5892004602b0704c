// Rays that have neighbors, a picture's above all, by tiles: a flock of close rays at a time goes slab by slab
// through what its bundle meets.  bundle -> gather -> march -> what the hit looks like, all in float32; a ray that
// float32 cannot decide is left to trace/resolve.hpp.
#pragma once
#include "trace/flock.hpp"
#include "trace/march.hpp"
#include "trace/slab.hpp"

namespace globule::core {

inline constexpr float kSlab = 1.5f;  ///< depth of a slab to begin with, in typical supports, where particles are balls
inline constexpr float kSpread = 8.0f;  ///< of a flock to begin with, likewise

/// shadows: the rays begin outside, at a surface, and ask for distances alone.
template <class Kernel, bool PerParticle, bool shadows> struct TraceTiles {
    static constexpr int tile_blocks = PerParticle ? 4 : 5;  ///< of tiles at one time on a GPU's processor
    static constexpr int tiles_of_block = Kernel::stretched ? 1 : 4;
    static constexpr float slab_depth = Kernel::stretched ? 1.25f : kSlab, window = Kernel::stretched ? 0.75f : kWindow;
    using Candidate = std::conditional_t<Kernel::stretched, EllipsoidCandidate,
        std::conditional_t<PerParticle, BallCandidate, AlikeCandidate>>;
    template <class Group> using Scratch = TileScratch<Group, Candidate>;

    Tree tree;
    SortedParticles particles;
    Kernel kernel;
    float tau;           ///< over the common weight unless PerParticle
    const float* color;  ///< (n, 3), caller's order, or null
    float3 one_color;
    RaySource rays;
    Hits out;
    const float* wetness = nullptr;  ///< (n,) of wet tissue, caller's order, or null
    float3 film{};                   ///< its color

    template <class Group> std::size_t n_tiles() const { return typename TileRays<Group>::Layout{rays}.n_tiles(); }

    template <class Group> GB_FN void operator()(Group& g, Scratch<Group>& scratch, std::size_t number) const {
        Tile<Group> tile{{}, {rays}, number};
        if (rays.samples > 1 && !tile.layout.mark(g, number, scratch.marked)) return;
        const float typical = tree.header->typical_support;
        const Node box = tree.empty() ? Node{} : tree.node(0);
        tile.start(g, tile.layout, number, box.lo, box.hi, 1e-3f * typical, shadows ? kStart * typical : 0.0f, shadows);
        for (int v = 0; tree.empty() && v < Group::vectors; ++v) tile.pending[v] = g.none();
        Flock<Group> flock;
        while (flock.choose_leader(g, tile, box.lo, box.hi)) {
            flock.spread = kSpread * typical;
            trace(g, scratch, tile, flock, typical);
            for (int v = 0; v < Group::vectors; ++v) tile.pending[v] = tile.pending[v] & !flock.in[v];
        }
        for (int v = 0; v < Group::vectors; ++v)
            g.per_lane(tile.missed[v], [&](int lane) { write_miss(index(tile, v, lane)); });
    }

private:
    template <class Group> struct Tile : TileRays<Group> {
        typename TileRays<Group>::Layout layout;
        std::size_t number;
    };
    template <class Group> GB_FN std::size_t index(const Tile<Group>& tile, int v, int lane) const {
        return tile.layout.ray(tile.number, v * Group::width + lane);
    }

    /// Takes a flock slab by slab to where each of its rays has hit or been left, or nothing lies ahead.
    template <class Group>
    GB_FN void trace(Group& g, Scratch<Group>& scratch, Tile<Group>& tile, Flock<Group>& flock, float typical) const {
        Slab slab(flock.assemble(g, tile), typical, slab_depth);
        {
            Walk<Candidate, Group> walk(
                g, scratch, tree, particles, flock.bundle, slab.z, flock.bundle.axis_point(slab.z));
            tile.advance(flock.in, slab.z = seek(walk));
        }
        while (slab.z < infinity()) {
            const Gathered found = gather_slab(g, scratch, tree, particles, flock.bundle, slab, [&] {
                const bool narrower = flock.narrow(typical);
                if (narrower) slab.z = flock.assemble(g, tile);
                return narrower;
            });
            if (found.n == 0) {
                slab.skip_to(found.next);
                tile.advance(flock.in, slab.z);
                continue;
            }
            if (found.n > 0) tile.advance(flock.in, found.nearest);
            if (!pass(g, scratch, tile, flock, found, slab)) return;
            slab.step(typical / found.sharpest, 4 * found.n < scratch.capacity);
        }
    }

    /// The flock through one slab; false: all its rays are done.
    template <class Group>
    GB_FN bool pass(Group& g, Scratch<Group>& scratch, Tile<Group>& tile, Flock<Group>& flock, const Gathered& found,
        const Slab& slab) const {
        using F = typename Group::F;
        using B = typename Group::B;
        bool more = false;
        for (int v = 0; v < Group::vectors; ++v) {
            B& in = flock.in[v];
            if (!g.any(in)) continue;
            const B done =
                found.n > 0 ? march_lanes(g, scratch, tile, v, in, found, slab) : leave(g, tile, v, in, tile.t[v]);
            tile.pending[v] = tile.pending[v] & !done;
            tile.missed[v] = tile.missed[v] & !done;
            in = in & !done;
            tile.t[v] = select(in, max(tile.t[v], F(slab.end())), tile.t[v]);
            more = g.any(in) || more;
        }
        return more;
    }

    /// Marches the active lanes of one vector through the list's slab; returns those that are done.
    template <class Group>
    GB_FN typename Group::B march_lanes(Group& g, Scratch<Group>& scratch, Tile<Group>& tile, int v,
        const typename Group::B& active, const Gathered& found, const Slab& slab) const {
        using F = typename Group::F;
        using B = typename Group::B;
        const float typical = slab.typical, scale = 1.0f / typical;  // lengths are scaled by it
        const Vec3<F> p0 = entry(tile, v, slab, scale), d = tile.d[v];
        const ListSource<Candidate, Group, Kernel> source{g, scratch, found.n, kernel, p0, d};
        const float heaviest = PerParticle ? tree.header->most_weight : 1.0f;
        const float sharp = max(1.0f, found.sharpest);  // where float32's error is largest
        Limits<F> lim{F(tau), F(window / found.sharpest), F(5e-6f * (heaviest + tau) * sharp),
            F(2e-5f / found.sharpest), F(1.0f)};
        F t = max((tile.t[v] - F(slab.z)) * F(scale), F(0.0f));
        const B unknown = tile.fresh[v] & active;
        if (g.any(unknown)) {
            const Along<F> s = source.template at<false>(t, lim, unknown);
            tile.sign[v] = select(unknown & (s.f > F(tau)), F(-1.0f), tile.sign[v]);
            tile.fresh[v] = tile.fresh[v] & !active;
        }
        lim.sign = tile.sign[v];
        B hit = g.none(), doubtful = g.none();
        march<shadows>(source, lim, F(slab.dz * scale), active, t, hit, doubtful);
        leave(g, tile, v, doubtful, F(slab.z) + t * F(typical));
        if (g.any(hit)) write_hits(g, scratch, tile, v, hit, found.n, p0 + d * t, F(slab.z) + t * F(typical));
        return hit | doubtful;
    }

    /// One vector's rays where the slab begins, relative to its axis point, scaled: in float64, the one place where
    /// large numbers meet.
    template <class Group>
    GB_FN static Vec3<typename Group::F> entry(const Tile<Group>& tile, int v, const Slab& slab, float scale) {
        using F = typename Group::F;
        Vec3<F> p{F(0.0f), F(0.0f), F(0.0f)};
        const auto axis = [&](const F& o, const F& d, float at, int lane) {
            return float((double(Group::get(o, lane)) + double(slab.z) * Group::get(d, lane) - at) * scale);
        };
        Group::for_lanes([&](int lane) {
            Group::put(p.x, lane, axis(tile.o[v].x, tile.d[v].x, slab.at.x, lane));
            Group::put(p.y, lane, axis(tile.o[v].y, tile.d[v].y, slab.at.y, lane));
            Group::put(p.z, lane, axis(tile.o[v].z, tile.d[v].z, slab.at.z, lane));
        });
        return p;
    }

    /// Leaves rays to resolve.hpp from t on.
    template <class Group>
    GB_FN_APART typename Group::B leave(
        Group& g, const Tile<Group>& tile, int v, const typename Group::B& which, const typename Group::F& t) const {
        g.per_lane(which, [&](int lane) {
            const std::size_t i = index(tile, v, lane);
            out.t[i] = before(Group::get(t, lane));
            out.undecided.add(i);
            write_sign(tile, v, lane, i);
        });
        if (out.sign) g.per_lane(which & tile.fresh[v], [&](int lane) { out.sign[index(tile, v, lane)] = 0; });
        return which;
    }

    GB_FN void write_miss(std::size_t i) const {
        out.t[i] = infinity();
        if (!out.normal) return;
        write3(out.normal, i, {0, 0, 0});
        write3(out.albedo, i, {0, 0, 0});
    }

    /// Where rays hit, and what that looks like: gradient and blended color, from the same list.
    template <class Group>
    GB_FN_APART void write_hits(Group& g, const Scratch<Group>& scratch, const Tile<Group>& tile, int v,
        const typename Group::B& hit, int n, const Vec3<typename Group::F>& p, const typename Group::F& t) const {
        using F = typename Group::F;
        if (shadows || !out.normal) {
            g.per_lane(hit, [&](int lane) {
                out.t[index(tile, v, lane)] = Group::get(t, lane);
                write_sign(tile, v, lane, index(tile, v, lane));
            });
            return;
        }
        Vec3<F> gradient{F(0.0f), F(0.0f), F(0.0f)};
        BlendedColor<F> blended;
        F wet(0.0f);
        for (int j = 0; j < n; ++j) {
            const float3 q = scratch.list.point(j);
            const Influence<F> of = influence_of<F>(scratch, j, {p.x - F(q.x), p.y - F(q.y), p.z - F(q.z)});
            gradient = gradient + of.half_gradient;
            const F w = max(of.value, F(0.0f));
            if (color || wetness) blended.add(color, particles.index[scratch.list.number(j)], w);
            if (wetness) wet += w * F(wetness[particles.index[scratch.list.number(j)]]);
        }
        const Vec3<F> normal = normalize(gradient), mean = blended.mean();
        g.per_lane(hit, [&](int lane) {
            const std::size_t i = index(tile, v, lane);
            float3 seen = color ? float3{Group::get(mean.x, lane), Group::get(mean.y, lane), Group::get(mean.z, lane)}
                                : one_color;
            out.t[i] = Group::get(t, lane);
            write3(
                out.normal, i, {-Group::get(normal.x, lane), -Group::get(normal.y, lane), -Group::get(normal.z, lane)});
            if (wetness)
                out.wetness[i] =
                    under_film(Group::get(wet, lane) / max(Group::get(blended.total, lane), 1e-30f), film, seen);
            write3(out.albedo, i, seen);
            write_sign(tile, v, lane, i);
        });
    }
    template <class Group> GB_FN void write_sign(const Tile<Group>& tile, int v, int lane, std::size_t i) const {
        if (out.sign) out.sign[i] = Group::get(tile.sign[v], lane) < 0.0f ? std::int8_t(-1) : std::int8_t(1);
    }
    /// Of the list's j-th particle, r from its center.
    template <class F, class Scratch>
    GB_FN Influence<F> influence_of(const Scratch& scratch, int j, const Vec3<F>& r) const {
        if constexpr (Candidate::ellipsoid)
            return influence(kernel, Form<F>{scratch.shape[j].template form_as<F>()}, r, F(scratch.shape[j].weight));
        else return influence(kernel, Ball<F>{F(scratch.shape[j].inverse_a2)}, r, F(scratch.shape[j].weight));
    }
};

}  // namespace globule::core
