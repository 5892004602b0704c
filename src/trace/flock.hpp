// Which rays of a tile are traced together: those that stay close to a leader, so that one bundle, one walk of the
// octree and one list serve them all.  Of a camera's tile that is mostly every ray.
#pragma once
#include "trace/bundle.hpp"
#include "trace/tile_rays.hpp"

namespace globule::core {

template <class Group> struct Flock {
    using F = typename Group::F;
    using B = typename Group::B;
    static constexpr int V = Group::vectors;

    int leader;    ///< its number among the tile's rays
    float3 o, d;   ///< its ray
    float far;     ///< from o to the farthest corner of the octree's box
    float spread;  ///< rays stay so close to the leader's, all the way to there
    B in[V];
    Bundle bundle;  ///< around them all
    float loose;    ///< how far apart they come; 0: one ray, or several that coincide

    /// A pending ray from the tile's middle, if there is one, else any; false: none is left.
    GB_FN bool choose_leader(Group& g, const TileRays<Group>& rays, const float3& lo, const float3& hi) {
        leader = -1;
        for (int k = 0; k < V; ++k) {
            const int v = (k + V / 2) % V;
            const int lane = leader < 0 ? g.first_from(rays.pending[v], V == 1 ? Group::width / 2 + 4 : 4) : -1;
            if (lane < 0) continue;
            leader = v * Group::width + lane;
            o = {g.pick(rays.o[v].x, lane), g.pick(rays.o[v].y, lane), g.pick(rays.o[v].z, lane)};
            d = {g.pick(rays.d[v].x, lane), g.pick(rays.d[v].y, lane), g.pick(rays.d[v].z, lane)};
        }
        if (leader < 0) return false;
        far = length(float3{max(abs(lo.x - o.x), abs(hi.x - o.x)), max(abs(lo.y - o.y), abs(hi.y - o.y)),
            max(abs(lo.z - o.z), abs(hi.z - o.z))});
        return true;
    }
    /// The pending rays within `spread`; returns the least distance that one of them has come.
    GB_FN float assemble(Group& g, const TileRays<Group>& rays) {
        float r0 = 0.0f, r1 = 0.0f, z = infinity();
        for (int v = 0; v < V; ++v) {
            const F away = length(rays.o[v] - Vec3<F>{F(o.x), F(o.y), F(o.z)});
            const F apart = length(rays.d[v] - Vec3<F>{F(d.x), F(d.y), F(d.z)});
            const B leads = leader / Group::width == v ? g.only(leader % Group::width) : g.none();
            in[v] = rays.pending[v] & (leads | ((away + apart * F(far) <= F(spread)) & (apart < F(0.045f))));
            r0 = max(r0, g.largest(select(in[v], away, F(0.0f))));
            r1 = max(r1, g.largest(select(in[v], apart, F(0.0f))));
            z = min(z, g.smallest(select(in[v], rays.t[v], F(infinity()))));
        }
        bundle = bundle_around(o, d, r0, r1);
        loose = r0 + r1 * far;
        return z;
    }
    /// To fewer rays, where there are several; assemble() them again then.
    GB_FN bool narrow(float typical_support) {
        if (!(loose > 0.0f)) return false;
        spread *= spread > 0.05f * typical_support ? 0.5f : 0.0f;
        return true;
    }
};

}  // namespace globule::core
