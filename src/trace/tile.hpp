// One tile of rays: bundle -> gather -> march -> what the hit looks like.  All in float32; a ray that
// float32 cannot decide is left to trace/resolve.hpp.
#pragma once
#include "trace/camera.hpp"
#include "trace/march.hpp"

namespace globule::core {

inline constexpr float kSlab = 1.5f;        ///< depth of a slab to begin with, in typical supports
inline constexpr float kMaxWindows = 32.0f; ///< a slab is at most so many of the list's smallest supports deep

/// A bundle around (o, d), a little wider than r0 + r1 t: by what rounding may move a point at t.
GB_FN Bundle bundle_of(const float3& o, const float3& d, float r0, float r1) {
    return {o, d, r0 + 1e-6f * (abs(o.x) + abs(o.y) + abs(o.z)), r1 + 2e-6f};
}
/// Slabs at distance z are at least so deep, or float32 would not move on.
GB_FN float least_advance(float z) { return 4e-7f * z; }

template <class Tree, class Kernel, bool PerParticle>
struct TraceTiles {
    template <class Group>
    using Scratch = TileScratch<Group, PerParticle>;

    Tree tree;
    SortedParticles particles;
    Kernel kernel;
    float tau;             ///< over the common weight unless PerParticle
    const float* color;    ///< (n, 3), caller's order, or null
    float3 one_color;
    RaySource rays;
    Hits out;

    static constexpr int kTileWidth = 8;

    template <class Group>
    static constexpr int tile_height() { return Group::width * Group::vectors / kTileWidth; }

    template <class Group>
    std::size_t n_tiles() const {
        if (rays.origins) return ceil_div<std::size_t>(rays.n, Group::width * Group::vectors);
        return std::size_t(ceil_div(rays.camera.width, kTileWidth)) *
               ceil_div(rays.rows(), tile_height<Group>());
    }

    /// The rays of one tile and how far each has come.
    template <class Group>
    struct Lanes {
        using F = typename Group::F;
        using B = typename Group::B;
        static constexpr int V = Group::vectors;
        Vec3<F> o[V], d[V];
        F t[V];          ///< no root before
        F sign[V];
        B pending[V];
        B fresh[V];      ///< not known yet whether it begins inside
        B missed[V];     ///< neither hit nor left undecided so far
    };

    template <class Group>
    GB_FN std::size_t ray_index(std::size_t tile, int l) const {
        if (rays.origins) return tile * (Group::width * Group::vectors) + l;
        const std::uint32_t across = ceil_div(rays.camera.width, kTileWidth), at = std::uint32_t(tile);
        const int x = int(at % across) * kTileWidth + l % kTileWidth;
        const int y = int(at / across) * tile_height<Group>() + l / kTileWidth;
        return x < rays.camera.width && y < rays.rows()
                   ? std::size_t(y) * rays.camera.width + x : rays.n;
    }

    template <class Group>
    GB_FN void start(Group& g, Lanes<Group>& lanes, std::size_t tile, const Node& box) const {
        const float typical = tree.header->typical_support;
        using F = typename Group::F;
        using B = typename Group::B;
        const B all = g.first_lanes(Group::width);
        for (int v = 0; v < Group::vectors; ++v) {
            F column(0.0f), row(0.0f), ox(0.0f), oy(0.0f), oz(0.0f), dx(0.0f), dy(0.0f), dz(1.0f);
            B valid = g.none();
            g.per_lane(all, [&](int lane) {
                const std::size_t i = ray_index<Group>(tile, v * Group::width + lane);
                Group::put(valid, lane, i < rays.n);
                if (i >= rays.n) return;
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
            lanes.o[v] = {ox, oy, oz};
            lanes.d[v] = {dx, dy, dz};
            if (!rays.origins) rays.camera(column, row, lanes.o[v], lanes.d[v]);
            // Slab test against the root; per axis, a direction of zero never divides.
            F enter(0.0f), leave(infinity());
            auto axis = [&](const F& o, const F& d, float lo, float hi) {
                const F safe = select(abs(d) > F(1e-18f), d, F(1e-18f));
                const F a = (F(lo) - o) / safe, b = (F(hi) - o) / safe;
                enter = max(enter, min(a, b));
                leave = min(leave, max(a, b));
            };
            axis(lanes.o[v].x, lanes.d[v].x, box.lo.x, box.hi.x);
            axis(lanes.o[v].y, lanes.d[v].y, box.lo.y, box.hi.y);
            axis(lanes.o[v].z, lanes.d[v].z, box.lo.z, box.hi.z);
            lanes.pending[v] = tree.empty() ? g.none() : valid & (enter <= leave * F(1.00001f));
            lanes.t[v] = max(enter * F(0.99999f) - F(1e-3f * typical), F(0.0f));
            lanes.fresh[v] = !(lanes.t[v] > F(0.0f));
            lanes.sign[v] = F(1.0f);
            lanes.missed[v] = valid;
        }
    }

    template <class Group>
    GB_FN void operator()(Group& g, Scratch<Group>& scratch, std::size_t tile) const {
        using F = typename Group::F;
        using B = typename Group::B;
        constexpr int V = Group::vectors;
        Lanes<Group> lanes;
        const Node box = tree.empty() ? Node{} : tree.node(0);
        start(g, lanes, tile, box);
        const float typical = tree.header->typical_support;  // lengths are scaled by it
        const float scale = 1.0f / typical;
        for (;;) {
            // The bundle: rays that stay close to a leader from the tile's middle.
            int leader = -1;
            float3 lo{0, 0, 0}, ld{0, 0, 1};
            for (int k = 0; k < V; ++k) {
                const int v = (k + V / 2) % V;
                const int lane = leader < 0 ? g.first_from(lanes.pending[v], V == 1 ? Group::width / 2 + 4 : 4) : -1;
                if (lane < 0) continue;
                leader = v * Group::width + lane;
                lo = {g.pick(lanes.o[v].x, lane), g.pick(lanes.o[v].y, lane), g.pick(lanes.o[v].z, lane)};
                ld = {g.pick(lanes.d[v].x, lane), g.pick(lanes.d[v].y, lane), g.pick(lanes.d[v].z, lane)};
            }
            if (leader < 0) break;
            const float far = length(float3{max(abs(box.lo.x - lo.x), abs(box.hi.x - lo.x)),
                                            max(abs(box.lo.y - lo.y), abs(box.hi.y - lo.y)),
                                            max(abs(box.lo.z - lo.z), abs(box.hi.z - lo.z))});
            float spread = 8.0f * typical;
            B group[V];
            Bundle bundle;
            float loose = 0.0f;  // 0: one ray, or several that coincide
            float z = 0.0f;
            auto select_group = [&] {
                float r0 = 0.0f, r1 = 0.0f;
                z = infinity();
                for (int v = 0; v < V; ++v) {
                    const F away = length(lanes.o[v] - Vec3<F>{F(lo.x), F(lo.y), F(lo.z)});
                    const F apart = length(lanes.d[v] - Vec3<F>{F(ld.x), F(ld.y), F(ld.z)});
                    const B leads = leader / Group::width == v ? g.only(leader % Group::width) : g.none();
                    group[v] = lanes.pending[v] &
                               (leads | ((away + apart * F(far) <= F(spread)) & (apart < F(0.045f))));
                    r0 = max(r0, g.largest(select(group[v], away, F(0.0f))));
                    r1 = max(r1, g.largest(select(group[v], apart, F(0.0f))));
                    z = min(z, g.smallest(select(group[v], lanes.t[v], F(infinity()))));
                }
                bundle = bundle_of(lo, ld, r0, r1);
                loose = r0 + r1 * far;
            };
            select_group();

            const auto axis_point = [&] { return float3{lo.x + z * ld.x, lo.y + z * ld.y, lo.z + z * ld.z}; };
            {
                Walk<PerParticle, Group, Tree> walk(g, scratch, tree, particles, bundle, z, axis_point());
                advance(lanes, group, z = seek(walk));
            }
            float dz = kSlab * typical;
            while (z < infinity()) {
                dz = max(dz, least_advance(z));
                const float3 at = axis_point();
                Walk<PerParticle, Group, Tree> walk(g, scratch, tree, particles, bundle, z, at);
                const Gathered found = gather(walk, dz, scale);
                if (found.n < 0 && loose > 0.0f) {
                    spread *= spread > 0.05f * typical ? 0.5f : 0.0f;  // too many: fewer rays,
                    select_group();
                    continue;
                }
                if (found.n < 0 && dz > max(typical * (1.0f / 64.0f), 2.0f * least_advance(z))) {  // then a thinner slab,
                    dz *= 0.5f;
                    continue;
                }
                if (found.n == 0) {
                    advance(lanes, group, z = found.next);
                    dz = kSlab * typical;
                    continue;
                }
                const float smallest = typical / found.sharpest;  // support in the list
                if (found.n > 0 && dz > max(kMaxWindows * smallest, least_advance(z))) {
                    dz = 0.5f * kMaxWindows * smallest;
                    continue;
                }
                if (found.n > 0) advance(lanes, group, found.nearest);
                bool more = false;
                for (int v = 0; v < V; ++v) {
                    if (!g.any(group[v])) continue;
                    const B done = found.n > 0 ? march_lanes(g, scratch, lanes, v, group[v], found, at, z, dz, tile)
                                               : leave(g, lanes, v, group[v], lanes.t[v], tile);
                    lanes.pending[v] = lanes.pending[v] & !done;
                    lanes.missed[v] = lanes.missed[v] & !done;
                    group[v] = group[v] & !done;
                    lanes.t[v] = select(group[v], max(lanes.t[v], F(z + dz)), lanes.t[v]);
                    more = g.any(group[v]) || more;
                }
                if (!more) break;
                z += dz;
                if (4 * found.n < Group::list_capacity) dz = min(kSlab * max(typical, smallest), 2.0f * dz);
            }
            for (int v = 0; v < V; ++v) lanes.pending[v] = lanes.pending[v] & !group[v];
        }
        for (int v = 0; v < V; ++v) g.per_lane(lanes.missed[v], [&](int lane) { miss(ray_index<Group>(tile, v * Group::width + lane)); });
    }

private:
    GB_FN void miss(std::size_t i) const {
        out.t[i] = infinity();
        if (!out.normal) return;
        write3(out.normal, i, {0, 0, 0});
        write3(out.albedo, i, {0, 0, 0});
    }

    /// Nothing reaches these lanes before z: they are outside there, and no root lies before.
    template <class Group>
    GB_FN static void advance(Lanes<Group>& lanes, const typename Group::B* group, float z) {
        using F = typename Group::F;
        for (int v = 0; v < Group::vectors; ++v) {
            const auto moved = group[v] & (F(z) > lanes.t[v]);
            lanes.t[v] = select(moved, F(z), lanes.t[v]);
            lanes.fresh[v] = lanes.fresh[v] & !moved;
        }
    }

    /// Leaves rays to resolve.hpp from t on.
    template <class Group>
    GB_FN typename Group::B leave(Group& g, Lanes<Group>&, int v, const typename Group::B& which,
                                  const typename Group::F& t, std::size_t tile) const {
        g.per_lane(which, [&](int lane) {
            const std::size_t i = ray_index<Group>(tile, v * Group::width + lane);
            out.t[i] = undecided(Group::get(t, lane));
            out.undecided.add(i);
        });
        return which;
    }

    /// Marches the active lanes of one vector through the list's slab; returns those that are done.
    template <class Group>
    GB_FN typename Group::B march_lanes(Group& g, Scratch<Group>& scratch, Lanes<Group>& lanes, int v,
                                 const typename Group::B& active, const Gathered& found, const float3& at, float z,
                                 float dz, std::size_t tile) const {
        using F = typename Group::F;
        using B = typename Group::B;
        const float typical = tree.header->typical_support, scale = 1.0f / typical;
        const Vec3<F> d = lanes.d[v];
        Vec3<F> p0{F(0.0f), F(0.0f), F(0.0f)};
        Group::for_lanes([&](int lane) {  // in float64: the one place where large numbers meet
            Group::put(p0.x, lane, float((double(Group::get(lanes.o[v].x, lane)) + double(z) * Group::get(d.x, lane) - at.x) * scale));
            Group::put(p0.y, lane, float((double(Group::get(lanes.o[v].y, lane)) + double(z) * Group::get(d.y, lane) - at.y) * scale));
            Group::put(p0.z, lane, float((double(Group::get(lanes.o[v].z, lane)) + double(z) * Group::get(d.z, lane) - at.z) * scale));
        });
        const float heaviest = PerParticle ? tree.header->most_weight : 1.0f;
        const float sharp = max(1.0f, found.sharpest);  // where float32's error is largest
        const ListSource<PerParticle, Group, Kernel> source{g, scratch, found.n, kernel, p0, d};
        Limits<F> lim{F(tau), F(kWindow / found.sharpest), F(5e-6f * (heaviest + tau) * sharp), F(2e-5f / found.sharpest), F(1.0f)};
        F t = max((lanes.t[v] - F(z)) * F(scale), F(0.0f));
        if (g.any(lanes.fresh[v] & active)) {
            const Along<F> s = source.template at<false>(t, lim, lanes.fresh[v] & active);
            lanes.sign[v] = select(lanes.fresh[v] & active & (s.f > F(tau)), F(-1.0f), lanes.sign[v]);
            lanes.fresh[v] = lanes.fresh[v] & !active;
        }
        lim.sign = lanes.sign[v];
        B hit = g.none(), doubtful = g.none();
        march(source, lim, F(dz * scale), active, t, hit, doubtful);
        leave(g, lanes, v, doubtful, F(z) + t * F(typical), tile);
        if (g.any(hit)) look(g, scratch, found.n, p0 + d * t, F(z) + t * F(typical), hit, v, tile);
        return hit | doubtful;
    }

    /// What the hits look like: gradient and blended colour, from the same list.
    template <class Group>
    GB_FN void look(Group& g, Scratch<Group>& scratch, int n, const Vec3<typename Group::F>& p,
                    const typename Group::F& t, const typename Group::B& hit, int v, std::size_t tile) const {
        using F = typename Group::F;
        if (!out.normal) {
            g.per_lane(hit, [&](int lane) { out.t[ray_index<Group>(tile, v * Group::width + lane)] = Group::get(t, lane); });
            return;
        }
        Vec3<F> grad{F(0.0f), F(0.0f), F(0.0f)}, rgb = grad;
        F total(0.0f);
        for (int j = 0; j < n; ++j) {
            const float3 q = scratch.list.point(j);
            const Vec3<F> r{p.x - F(q.x), p.y - F(q.y), p.z - F(q.z)};
            const float i2 = PerParticle ? scratch.shape[j].inverse_a2 : 1.0f;
            const float c = PerParticle ? scratch.shape[j].weight : 1.0f;
            F b, slope;
            if constexpr (Kernel::stretched) {
                const Sym3<F> m = kernel.template matrix<F>(scratch.list.number(j));
                const Vec3<F> w = m * r;
                kernel(min(dot(w, w), F(1.0f)), b, slope);
                grad = grad + (m * w) * (slope * F(c));
            } else {
                kernel(min(dot(r, r) * F(i2), F(1.0f)), b, slope);
                grad = grad + r * (slope * F(c * i2));
            }
            if (color) {
                const float* own = color + std::size_t(3) * particles.index[scratch.list.number(j)];
                const F w = max(b * F(c), F(0.0f));
                total += w;
                rgb = rgb + Vec3<F>{w * F(own[0]), w * F(own[1]), w * F(own[2])};
            }
        }
        const Vec3<F> normal = normalize(grad);
        g.per_lane(hit, [&](int lane) {
            const std::size_t i = ray_index<Group>(tile, v * Group::width + lane);
            out.t[i] = Group::get(t, lane);
            write3(out.normal, i, {-Group::get(normal.x, lane), -Group::get(normal.y, lane), -Group::get(normal.z, lane)});
            const float w = color ? 1.0f / max(Group::get(total, lane), 1e-30f) : 0.0f;
            write3(out.albedo, i, color ? float3{Group::get(rgb.x, lane) * w, Group::get(rgb.y, lane) * w,
                                                 Group::get(rgb.z, lane) * w}
                                        : one_color);
        });
    }
};

}  // namespace globule::core
