// Surface tension, from the area of the fluid's free surface.
//
// The surface is where a ball as large as a spacing can roll over the particles (the boundary of their
// alpha shape; Edelsbrunner & Mücke 1994): a facet is three particles that such a ball touches with nobody in
// it.  Its vertices lie at the surface, outside of their particles.  Tension is what the facets' area
// costs: every vertex is pulled by -sigma dA/dx.  The three pulls of a facet add up to nothing, and so does their
// torque: momentum is kept.  Each particle finds the facets around it by itself, from its own neighbours;
// all three come to the same ones, for they ask the same questions with the same numbers.
// Facets reach to the particles of walls and tissue, which hold them: a surface ends there, it is not drawn away.
#pragma once
#include "globule/exec/bits.hpp"
#include "globule/sim/density.hpp"

namespace globule::sim {

inline constexpr int kMostFacets = 32;        ///< around a particle; about 6 in a surface, 12 in a sheet, 30 in spray
inline constexpr int kMostNear = 48;          ///< neighbours at the surface that are looked at
inline constexpr int kMostAround = 128;       ///< neighbours; about 30 are usual, who has more than this is at no surface
inline constexpr float kSurfaceGradient = 0.1f;  ///< of the density, per spacing: less is not at a surface (with 0.2, some that are)
/// Spacings from the outermost particles to the surface: with this one, facets enclose the fluid's volume (within 1 %
/// in drops of 5 to 10 spacings), for the density solve packs particles closer at the surface than inside.
inline constexpr float kSurfaceOffset = 0.69f;
inline constexpr float kJitter = 1e-3f;       ///< spacings: four of a lattice lie on one ball

/// Spacings from fluid to what is not: fluid that lies against a wall is nearer, and one that is not yet there is not drawn to it.
inline constexpr float kReach = 1.2f;

/// Directions all around, none farther than 16 degrees from one of them.
inline constexpr int kDirections = 96;
inline constexpr int kFiner = 7;  ///< around each: what is nearest to it is at most 8 degrees from one of these
struct Directions {
    float x[kDirections], y[kDirections], z[kDirections];
    float3 finer[kDirections][kFiner];
    Directions() {
        constexpr float turn = 1.0471976f, tilt = 0.2268928f;  // 60 and 13 degrees
        for (int k = 0; k < kDirections; ++k) {
            z[k] = 1.0f - float(2 * k + 1) / kDirections;
            const float r = std::sqrt(1.0f - z[k] * z[k]);
            x[k] = r * std::cos(2.399963f * k);
            y[k] = r * std::sin(2.399963f * k);
            const float3 d{x[k], y[k], z[k]}, e{y[k] / r, -x[k] / r, 0.0f}, f = cross(d, e);
            finer[k][0] = d;
            for (int c = 1; c < kFiner; ++c)
                finer[k][c] = d * std::cos(tilt) + (e * std::cos(turn * c) + f * std::sin(turn * c)) * std::sin(tilt);
        }
    }
};
/// Where a ball of one spacing's radius touches a particle in any direction, nobody is in one of this radius
/// that touches it in the nearest of the directions above, at one spacing's distance of their centres.
inline constexpr float kSurelyEmpty = 0.72f;
inline constexpr float kSurelyEmptyFiner = 0.86f;

/// Who may be at the surface of a fluid with tension.
struct Skin {
    Quad* place;        ///< per slot: position (jittered); w: tension, 0 where not at a surface, -1: not fluid
    Quad* normal;       ///< per slot: outwards, at most 1 long; w: tension
    std::uint32_t* facets;  ///< (kMostFacets, 2, padded rows): slots of the other two vertices
    std::uint32_t* count;   ///< per row
    std::uint32_t* open;    ///< (kDirections / 32, padded rows): bits of the directions that may have nobody
    std::uint32_t* rows;    ///< those with a gradient of the density, in any order; n_rows of them
    std::uint32_t* n_rows;
    std::size_t padded;
};

struct MarkSkin {
    State state;
    const Phase* phases;
    Skin skin;
    float spacing;
    GB_FN static float jitter(std::uint32_t id) {
        id ^= id >> 16;
        id *= 0x7feb352du;
        id ^= id >> 15;
        id *= 0x846ca68bu;
        id ^= id >> 16;
        return float(id >> 8) * (1.0f / 8388608.0f) - 1.0f;
    }
    GB_FN void operator()(std::size_t i) const {
        skin.normal[i] = {0.0f, 0.0f, 0.0f, 0.0f};
        if (i >= state.n) {
            skin.place[i] = {2e18f, 2e18f, 2e18f, 0.0f};
            return;
        }
        const Quad p = state.place[i];
        const std::uint32_t id = 3u * state.id[i];
        const float s = kJitter * spacing;
        skin.place[i] = {p.x + s * jitter(id), p.y + s * jitter(id + 1), p.z + s * jitter(id + 2), phases[state.phase[i]].kind == Kind::fluid ? 0.0f : -1.0f};
    }
};
/// Lists the rows of fluids with tension where the density has a gradient.
struct ListSteep {
    const std::uint32_t* slots;
    const std::uint32_t* neighbors;  ///< how many
    State state;
    const Phase* phases;
    Rows values;
    float least_gradient;  ///< |G| times the support
    Skin skin;
    GB_FN void operator()(std::size_t row) const {
        skin.count[row] = 0;
        const Phase& phase = phases[state.phase[slots[row]]];
        const float3 g{values.gx[row], values.gy[row], values.gz[row]};
        if (phase.kind != Kind::fluid || !(phase.tension > 0.0f) || !(dot(g, g) > least_gradient * least_gradient)) return;
        if (neighbors[row] <= std::uint32_t(kMostAround)) skin.rows[atomic_take(skin.n_rows, 1)] = std::uint32_t(row);
    }
};

/// Of these, the particles that a ball may touch.  A group's lanes are directions, then neighbours.
template <class Packet, bool periodic>
struct MarkTension {
    template <class Group>
    struct Scratch {
        static constexpr int room = kMostAround + Group::width;
        float x[room], y[room], z[room];  ///< of the neighbours, in spacings from the particle
        float reach[room];                ///< half of 1 + their squared distance
    };
    Lists<Packet> lists;
    State state;
    Period period;
    const Directions* directions;
    float per_spacing;
    const Phase* phases;
    Skin skin;
    template <class Group>
    GB_FN void operator()(Group& g, Scratch<Group>& near, std::size_t item) const {
        using F = typename Group::F;
        constexpr int parts = kDirections / Group::width;
        const std::size_t row = skin.rows[item];
        const std::uint32_t slot = lists.rows[row];
        const int n = int(lists.count[row]);
        const float3 at = state.place[slot].xyz();
        g.sync();
        g.share(n, [&](int k) {
            const float3 d = period.template shortest<periodic>(state.place[lists.index[lists.at(row, k)]].xyz() - at) * per_spacing;
            near.x[k] = d.x;
            near.y[k] = d.y;
            near.z[k] = d.z;
            near.reach[k] = 0.5f * (1.0f + dot(d, d));
        });
        constexpr float margin = 0.5f * kSurelyEmpty * kSurelyEmpty;
        F room[parts];  // below 0: somebody is in the ball in that direction
        for (int p = 0; p < parts; ++p) room[p] = F(1.0f);
        for (int k = 0; k < n; ++k)
            for (int p = 0; p < parts; ++p) {
                const int first = p * Group::width;
                const F along = F(near.x[k]) * g.load_run(directions->x + first) + F(near.y[k]) * g.load_run(directions->y + first) +
                                F(near.z[k]) * g.load_run(directions->z + first);
                room[p] = least(room[p], F(near.reach[k] - margin) - along);
            }
        std::uint32_t open[kDirections / 32] = {};
        for (int p = 0; p < parts; ++p) open[p * Group::width / 32] |= g.set_of(room[p] > F(0.0f)) << p * Group::width % 32;
        for (int w = 0; w < kDirections / 32; ++w)
            for (std::uint32_t set = open[w]; set; set &= set - 1)
                if (open_around(g, near, n, directions->finer[32 * w + trailing_zeros(set)])) {
                    if (!g.is_first()) return;
                    for (int v = 0; v < kDirections / 32; ++v) skin.open[v * skin.padded + row] = open[v];
                    skin.place[slot].w = phases[state.phase[slot]].tension;
                    return;
                }
    }

private:
    template <class Group>
    GB_FN static bool open_around(Group& g, const Scratch<Group>& near, int n, const float3 (&directions)[kFiner]) {
        using F = typename Group::F;
        constexpr float margin = 0.5f * kSurelyEmptyFiner * kSurelyEmptyFiner;
        for (int c = 0; c < kFiner; ++c) {
            bool open = true;
            for (int k = 0; k < n && open; k += Group::width) {
                const F along = F(directions[c].x) * g.load_run(near.x + k) + F(directions[c].y) * g.load_run(near.y + k) + F(directions[c].z) * g.load_run(near.z + k);
                open = !g.any(g.first_lanes(n - k) & (along + F(margin) >= g.load_run(near.reach + k)));
            }
            if (open) return true;
        }
        return false;
    }
};

/// The facets around every row's particle, and its normal.  A group's lanes are pairs of neighbours, and balls that touch them.
template <class Packet, bool periodic>
struct FindFacets {
    static constexpr int kBalls = 96;          ///< looked at together
    static constexpr float kSurely = 0.9999f;  ///< of the squared radius: nearer than that is within a ball, whatever the rounding
    static constexpr std::uint32_t kOther = 1u << 16;  ///< bit of a ball's number: below the facet; then its neighbours, a byte each
    template <class Group>
    struct Scratch {
        static constexpr int around = kMostAround + Group::width, near = kMostNear + Group::width, balls = kBalls + 2 * near;
        float x[around], y[around], z[around], w[around];  ///< the neighbours' places
        float dx[around], dy[around], dz[around];          ///< from the particle
        std::uint32_t slot[around];
        float near_x[near], near_y[near], near_z[near], near_w[near];  ///< of those that a facet may have
        std::uint32_t near_slot[near];
        float ball_x[balls], ball_y[balls], ball_z[balls];  ///< from the particle
        std::uint32_t ball[balls];
        std::uint32_t found[kMostFacets];
        Quad normal[kMostFacets];  ///< of a facet, and what it is taken by
        float angle[kMostFacets];
        GB_FN float3 place(int i) const { return {near_x[i], near_y[i], near_z[i]}; }
    };
    /// Circle through three particles, as seen from the first of them.
    template <class F>
    struct Circle {
        Vec3<F> first, middle, across;
        F n2, height2;  ///< of across; of the centers of balls over the middle
        GB_FN Vec3<F> up() const { return across * root(height2 / n2); }
    };
    Lists<Packet> lists;
    Skin skin;
    Period period;
    const Directions* directions;
    float radius;   ///< of the ball

    template <class Group>
    GB_FN void operator()(Group& g, Scratch<Group>& s, std::size_t item) const {
        using F = typename Group::F;
        using B = typename Group::B;
        const std::size_t row = skin.rows[item];
        const std::uint32_t slot = lists.rows[row];
        const Quad mine = skin.place[slot];
        if (!(mine.w > 0.0f)) return;
        const int n = int(lists.count[row]);
        g.sync();
        g.share(n, [&](int k) {
            const std::uint32_t j = lists.index[lists.at(row, k)];
            const Quad p = skin.place[j];
            const float3 d = period.template shortest<periodic>(p.xyz() - mine.xyz());
            s.x[k] = p.x;
            s.y[k] = p.y;
            s.z[k] = p.z;
            s.w[k] = p.w;
            s.dx[k] = d.x;
            s.dy[k] = d.y;
            s.dz[k] = d.z;
            s.slot[k] = j;
        });
        const int n_near = collect(g, s, row, n);
        int n_balls = 0, n_found = 0;
        for (int i = 0; i < n_near; ++i) {
            for (int k = i + 1; k < n_near; k += Group::width) {
                const Vec3<F> other{g.load_run(s.near_x + k), g.load_run(s.near_y + k), g.load_run(s.near_z + k)};
                const Vec3<F> d = period.template shortest<periodic>(other - wide<F>(s.place(i)));
                const bool after = slot < s.near_slot[i];
                const std::uint32_t low = after ? slot : s.near_slot[i], high = after ? s.near_slot[i] : slot;
                const Circle<F> c = circle(wide<F>(after ? mine.xyz() : s.place(i)), wide<F>(after ? s.place(i) : mine.xyz()), other,
                                           g.before(s.near_slot + k, low), g.before(s.near_slot + k, high));
                const B held = (F(s.near_w[i]) * g.load_run(s.near_w + k) > F(0.0f)) | (dot(d, d) < F(kReach * kReach * radius * radius));
                const B may = g.first_lanes(n_near - k) & held & (c.height2 > F(0.0f));
                if (!g.any(may)) continue;
                const Vec3<F> up = c.up(), middle = c.middle + period.template shortest<periodic>(c.first - wide<F>(mine.xyz()));
                const std::uint32_t number = std::uint32_t(i << 8 | k);
                n_balls = add(g, s, n_balls, may, middle + up, number);
                n_balls = add(g, s, n_balls, may, middle - up, kOther + number);
            }
            if (n_balls < kBalls && i + 1 < n_near) continue;
            n_found = look(g, s, n, n_balls, mine.xyz(), slot, n_found);
            n_balls = 0;
        }
        if (n_found) finish(g, s, row, slot, mine, n_found);
    }

private:
    template <class F>
    GB_FN static Vec3<F> wide(const float3& p) { return {F(p.x), F(p.y), F(p.z)}; }
    template <class B, class F>
    GB_FN static Vec3<F> choose(const B& m, const Vec3<F>& p, const Vec3<F>& q) { return {select(m, p.x, q.x), select(m, p.y, q.y), select(m, p.z, q.z)}; }

    /// The neighbours that a facet may have, in order.
    template <class Group>
    GB_FN int collect(Group& g, Scratch<Group>& s, std::size_t row, int n) const {
        using F = typename Group::F;
        using B = typename Group::B;
        constexpr float low = kSurelyEmpty * kSurelyEmpty, high = (2.0f - kSurelyEmpty) * (2.0f - kSurelyEmpty);
        const F per = F(1.0f / radius);
        int n_near = 0;
        for (int k = 0; k < n && n_near < kMostNear; k += Group::width) {
            const Vec3<F> d{g.load_run(s.dx + k), g.load_run(s.dy + k), g.load_run(s.dz + k)}, unit = d * per;
            const F w = g.load_run(s.w + k);
            const B reaches = (w > F(0.0f)) | ((w < F(0.0f)) & (dot(d, d) < F(kReach * kReach * radius * radius)));
            const B may = g.first_lanes(n - k) & reaches;
            // A ball that touches the particle in an open direction may touch the neighbour, too.
            B touched = g.none();
            for (int v = 0; v < kDirections / 32; ++v)
                for (std::uint32_t set = skin.open[v * skin.padded + row]; set; set &= set - 1) {
                    const int i = 32 * v + trailing_zeros(set);
                    const Vec3<F> to = unit - wide<F>({directions->x[i], directions->y[i], directions->z[i]});
                    const F r2 = dot(to, to);
                    touched = touched | ((r2 >= F(low)) & (r2 <= F(high)));
                }
            const B taken = may & touched;
            g.keep(taken, g.load_run(s.x + k), s.near_x + n_near);
            g.keep(taken, g.load_run(s.y + k), s.near_y + n_near);
            g.keep(taken, g.load_run(s.z + k), s.near_z + n_near);
            g.keep(taken, w, s.near_w + n_near);
            g.keep(taken, g.load_run(s.slot + k), s.near_slot + n_near);
            n_near += g.count(taken);
        }
        g.sync();
        return least(n_near, kMostNear);
    }

    /// Of p, q and t; p's slot is lower than q's.  From the lowest slot, in the slots' order: the same numbers whoever asks.
    template <class F, class B>
    GB_FN Circle<F> circle(const Vec3<F>& p, const Vec3<F>& q, const Vec3<F>& t, const B& before_p, const B& before_q) const {
        Circle<F> c;
        c.first = choose(before_p, t, p);
        const Vec3<F> u = period.template shortest<periodic>(choose(before_p, p, choose(before_q, t, q)) - c.first);
        const Vec3<F> v = period.template shortest<periodic>(choose(before_q, q, t) - c.first);
        c.across = cross(u, v);
        const F u2 = dot(u, u), v2 = dot(v, v);
        c.n2 = dot(c.across, c.across);
        c.middle = cross(v * u2 - u * v2, c.across) * (F(0.5f) / c.n2);
        c.height2 = select(c.n2 > F(1e-6f) * u2 * v2, F(radius * radius) - dot(c.middle, c.middle), F(0.0f));
        return c;
    }
    template <class Group>
    GB_FN Circle<float> circle_of(const Scratch<Group>& s, std::uint32_t ball, const float3& at, std::uint32_t slot) const {
        const int i = int(ball >> 8 & 255u), k = int(ball & 255u);
        const bool after = slot < s.near_slot[i];
        const std::uint32_t low = after ? slot : s.near_slot[i], high = after ? s.near_slot[i] : slot;
        return circle(after ? at : s.place(i), after ? s.place(i) : at, s.place(k), s.near_slot[k] < low, s.near_slot[k] < high);
    }

    template <class Group>
    GB_FN static int add(Group& g, Scratch<Group>& s, int n, const typename Group::B& which, const Vec3<typename Group::F>& center, std::uint32_t number) {
        g.keep(which, center.x, s.ball_x + n);
        g.keep(which, center.y, s.ball_y + n);
        g.keep(which, center.z, s.ball_z + n);
        g.keep(which, g.numbers(number), s.ball + n);
        return n + g.count(which);
    }

    /// Finds those of the balls that hold nobody.
    template <class Group>
    GB_FN int look(Group& g, Scratch<Group>& s, int n, int n_balls, const float3& at, std::uint32_t slot, int n_found) const {
        using F = typename Group::F;
        const F sure = F(kSurely * radius * radius);
        g.sync();
        for (int first = 0; first < n_balls; first += Group::width) {
            const Vec3<F> center{g.load_run(s.ball_x + first), g.load_run(s.ball_y + first), g.load_run(s.ball_z + first)};
            typename Group::B may = g.first_lanes(n_balls - first);
            for (int m = 0; m < n && g.any(may); ++m) {
                const Vec3<F> d = wide<F>({s.dx[m], s.dy[m], s.dz[m]}) - center;
                may = may & (dot(d, d) >= sure);
            }
            g.each(may, [&](int lane) {
                const std::uint32_t ball = s.ball[first + lane];
                if (n_found == kMostFacets || !empty(g, s, n, ball, at, slot)) return;
                if (g.is_first()) s.found[n_found] = ball;
                ++n_found;
            });
        }
        g.sync();
        return n_found;
    }
    /// Nobody is in the ball but the three it touches.
    template <class Group>
    GB_FN bool empty(Group& g, const Scratch<Group>& s, int n, std::uint32_t ball, const float3& at, std::uint32_t slot) const {
        using F = typename Group::F;
        const Circle<float> c = circle_of(s, ball, at, slot);
        const float3 center = ball & kOther ? c.middle - c.up() : c.middle + c.up();
        const std::uint32_t j = s.near_slot[ball >> 8 & 255u], k = s.near_slot[ball & 255u];
        for (int m = 0; m < n; m += Group::width) {
            const Vec3<F> place{g.load_run(s.x + m), g.load_run(s.y + m), g.load_run(s.z + m)};
            const Vec3<F> d = period.template shortest<periodic>(place - wide<F>(c.first)) - wide<F>(center);
            if (g.any(g.first_lanes(n - m) & (dot(d, d) < F(radius * radius)) & g.differ(s.slot + m, j) & g.differ(s.slot + m, k))) return false;
        }
        return true;
    }

    /// Writes the facets and the normal, in the order of the neighbours.
    template <class Group>
    GB_FN void finish(Group& g, Scratch<Group>& s, std::size_t row, std::uint32_t slot, const Quad& mine, int n_found) const {
        const auto key = [&](int f) { return (s.found[f] << 1 | s.found[f] >> 16) & 0x1ffffu; };
        g.share(n_found, [&](int f) {
            int place = 0;
            for (int i = 0; i < n_found; ++i) place += key(i) < key(f);
            const std::uint32_t ball = s.found[f], j = ball >> 8 & 255u, k = ball & 255u;
            const std::size_t at = std::size_t(place) * 2 * skin.padded + row;
            skin.facets[at] = s.near_slot[j];
            skin.facets[at + skin.padded] = s.near_slot[k];
            const Circle<float> c = circle_of(s, ball, mine.xyz(), slot);
            const float3 e = period.template shortest<periodic>(s.place(int(j)) - mine.xyz()), o = period.template shortest<periodic>(s.place(int(k)) - mine.xyz());
            const float angle = atan2f(length(cross(e, o)), dot(e, o));
            s.normal[place] = {c.across.x, c.across.y, c.across.z, (ball & kOther ? -angle : angle) / root(c.n2)};
            s.angle[place] = angle;
        });
        g.sync();
        if (!g.is_first()) return;
        float3 normal{0, 0, 0};
        float angles = 0.0f;
        for (int f = 0; f < n_found; ++f) {
            normal = normal + s.normal[f].xyz() * s.normal[f].w;
            angles += s.angle[f];
        }
        skin.count[row] = std::uint32_t(n_found);
        const float scale = 1.0f / most(length(normal), 0.5f * angles);
        skin.normal[slot] = {scale * normal.x, scale * normal.y, scale * normal.z, mine.w};
    }
};

/// What the facets' tension adds to the accelerations.  The flow inside of a drop grows with the distance from its middle:
/// what a vertex does is more than what its particle does, as the roots of the facet's areas are.
template <class Packet, bool periodic>
struct PullSurface {
    Lists<Packet> lists;
    const Quad* place;
    Skin skin;
    const float* inverse_rho;
    Period period;
    float offset;  ///< of the surface from its particles
    float per_volume;
    Quad* acceleration;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = lists.rows[row];
        const Quad mine = skin.normal[slot];
        float3 pull{0, 0, 0};
        for (std::uint32_t f = 0; f < skin.count[row]; ++f) {
            const std::size_t at = std::size_t(f) * 2 * skin.padded + row;
            const std::uint32_t j = skin.facets[at], k = skin.facets[at + skin.padded];
            const Quad nj = skin.normal[j], nk = skin.normal[k];
            const float3 u = period.template shortest<periodic>(place[j].xyz() - place[slot].xyz());
            const float3 v = period.template shortest<periodic>(place[k].xyz() - place[slot].xyz());
            const float3 p = u + (nj.xyz() - mine.xyz()) * offset, q = v + (nk.xyz() - mine.xyz()) * offset;
            const float3 across = cross(p, q);
            const float outer = length(across), inner = length(cross(u, v));
            if (!(outer > 0.0f)) continue;
            const float share = root(least(most(outer / most(inner, 1e-20f), 0.25f), 4.0f));
            const float sigma = (mine.w + nj.w + nk.w) / (1.0f + (nj.w > 0.0f) + (nk.w > 0.0f));
            pull = pull - cross(across, q - p) * (0.5f * sigma * share / outer);
        }
        const float s = per_volume * inverse_rho[row];
        Quad& a = acceleration[row];
        a = {a.x + s * pull.x, a.y + s * pull.y, a.z + s * pull.z, 0.0f};
    }
};

}  // namespace globule::sim
