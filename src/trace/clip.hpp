// Cuts: shapes that take a part of space away from the medium.  A ray goes through the intervals that
// all of them keep; where one begins inside the medium the cut face shows.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

enum class ClipKind : int { plane, box, sphere };

struct Clip {
    ClipKind kind;
    bool keep;  ///< keeps what is inside the shape, instead of taking it away
    float3 a;   ///< plane: unit normal of the half space dot(a, x) > b.x; box: low corner; sphere: center
    float3 b;   ///< plane: offset; box: high corner; sphere: radius

    /// The ray's part inside the shape; in > out: none.
    GB_FN void inside(const float3& o, const float3& d, float& in, float& out) const {
        in = -infinity();
        out = infinity();
        if (kind == ClipKind::plane) {
            const float speed = dot(a, d), height = dot(a, o) - b.x;
            if (abs(speed) < 1e-12f) {
                if (height <= 0.0f) in = infinity(), out = -infinity();
            } else if (speed > 0.0f) {
                in = -height / speed;
            } else {
                out = -height / speed;
            }
        } else if (kind == ClipKind::box) {
            axis(o.x, d.x, a.x, b.x, in, out);
            axis(o.y, d.y, a.y, b.y, in, out);
            axis(o.z, d.z, a.z, b.z, in, out);
        } else {
            const float3 v = o - a;
            const float along = dot(v, d);
            const float3 foot = v - d * along;  // the ray's point nearest to the center
            const float square = b.x * b.x - dot(foot, foot);
            if (square <= 0.0f) {
                in = infinity();
                out = -infinity();
                return;
            }
            in = -along - sqrt(square);
            out = -along + sqrt(square);
        }
    }
    /// Outward normal of the kept part at a point of the shape's surface.
    GB_FN float3 normal(const float3& p) const {
        float3 n = a;
        if (kind == ClipKind::plane) n = a * -1.0f;
        if (kind == ClipKind::sphere) n = normalize(p - a);
        if (kind == ClipKind::box) {
            const float3 c = (a + b) * 0.5f, h = (b - a) * 0.5f;
            const float x = (p.x - c.x) / h.x, y = (p.y - c.y) / h.y, z = (p.z - c.z) / h.z;
            const float ax = abs(x), ay = abs(y), az = abs(z);
            n = ax >= ay && ax >= az ? float3{x > 0.0f ? 1.0f : -1.0f, 0, 0}
                : ay >= az           ? float3{0, y > 0.0f ? 1.0f : -1.0f, 0}
                                     : float3{0, 0, z > 0.0f ? 1.0f : -1.0f};
        }
        return keep ? n : n * -1.0f;
    }

private:
    GB_FN static void axis(float o, float d, float lo, float hi, float& in, float& out) {
        if (abs(d) < 1e-18f) {
            if (o < lo || o > hi) in = infinity(), out = -infinity();
            return;
        }
        const float p = (lo - o) / d, q = (hi - o) / d;
        in = max(in, min(p, q));
        out = min(out, max(p, q));
    }
};

struct Clips {
    const Clip* clips = nullptr;
    int n = 0;

    /// The first interval [begin, end] at or after t that all clips keep; false: none.  `at_begin`,
    /// `at_end`: the clips that bound it, -1 for none.
    GB_FN_APART bool next(
        const float3& o, const float3& d, float t, float& begin, float& end, int& at_begin, int& at_end) const {
        begin = t;
        at_begin = at_end = -1;
        for (bool moved = true; moved;) {
            moved = false;
            for (int k = 0; k < n; ++k) {
                float in, out;
                clips[k].inside(o, d, in, out);
                float to = begin;
                if (clips[k].keep) {
                    if (in > out || begin >= out) return false;
                    to = max(begin, in);
                } else if (in < out && begin >= in && begin < out) {
                    to = out;
                }
                if (to == infinity()) return false;
                if (to > begin) {
                    begin = to;
                    at_begin = k;
                    moved = true;
                }
            }
        }
        end = infinity();
        for (int k = 0; k < n; ++k) {
            float in, out;
            clips[k].inside(o, d, in, out);
            const float stop = clips[k].keep ? out : (in < out && in > begin ? in : infinity());
            if (stop < end) {
                end = stop;
                at_end = k;
            }
        }
        return true;
    }
};

}  // namespace globule::core
