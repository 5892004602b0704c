// A rigid body's velocity and spin as unknowns, and contacts of bodies with walls and with each other: impulses are
// equal and opposite.
#pragma once
#include <vector>

#include "sim/rigid_drag.hpp"

namespace globule::core::sim {

/// One body.  Masses, momenta and forces are over the volume of a particle of size 1.
struct Unknown {
    std::uint8_t phase = 0;
    float3 center{0, 0, 0};
    double mass = 0, inertia[9] = {}, inverse[9] = {};  ///< world
    Impulse free,
        motion;  ///< velocity and spin: by what fluid does, and by what bodies and walls that it touches allow
    Drag drag;
    Arm reach;  ///< sums of lengths
    // Conjugate gradients: the preconditioner's share of the mass in what a speed costs, velocities and spins, impulses
    // and their moments.
    double share = 1;
    Impulse change, direction;
    Impulse residual, product;

    GB_FN static void turn(const double m[9], const double v[3], double out[3]) {
        for (int r = 0; r < 3; ++r) out[r] = m[3 * r] * v[0] + m[3 * r + 1] * v[1] + m[3 * r + 2] * v[2];
    }
    /// What an impulse adds to velocity and spin.
    GB_FN Impulse moved_by(const Impulse& i) const {
        Impulse z;
        turn(inverse, i.l, z.l);
        for (int k = 0; k < 3; ++k) z.p[k] = i.p[k] / mass;
        return z;
    }
    GB_FN Impulse preconditioned() const {
        Impulse z = moved_by(residual);
        for (int k = 0; k < 3; ++k) {
            z.p[k] *= share;
            z.l[k] *= share;
        }
        return z;
    }
    GB_FN static double dot6(const Impulse& a, const Impulse& b) {
        double sum = 0.0;
        for (int k = 0; k < 3; ++k) sum += a.p[k] * b.p[k] + a.l[k] * b.l[k];
        return sum;
    }
    GB_FN static void add(Impulse& a, double s, const Impulse& b) {
        for (int k = 0; k < 3; ++k) {
            a.p[k] += s * b.p[k];
            a.l[k] += s * b.l[k];
        }
    }

    /// An impulse of 1 along n, at a point.
    GB_FN static Impulse impulse(const double arm[3], const double n[3]) {
        Impulse i;
        for (int k = 0; k < 3; ++k) {
            i.p[k] = n[k];
            i.l[k] = arm[(k + 1) % 3] * n[(k + 2) % 3] - arm[(k + 2) % 3] * n[(k + 1) % 3];
        }
        return i;
    }
};

/// A place where two bodies touch, or one and what key frames move.
struct Meeting {
    int body = 0, other = -1;
    Impulse one, given;  ///< an impulse of 1, and what it adds to the body's motion
    Impulse of_other, given_to_other;
    double gives = 0.0;    ///< speed between both, of an impulse of 1
    double wanted = 0.0;   ///< speed between both, m/s, at least
    double impulse = 0.0;  ///< so far

    static constexpr double kSlop = 0.05;   ///< spacings that it may be deep
    static constexpr double kLeaves = 0.1;  ///< of what is deeper, in a step

    /// False: nobody touches.
    bool prepare(const std::vector<Unknown>& all, int a, int b, const Touch& touch, const Period& period,
        double spacing, double dt) {
        double n[3], arm[3], size = 0.0;
        for (int k = 0; k < 3; ++k) size += touch.normal[k] * touch.normal[k];
        if (!(touch.weight > 0.0) || !(size > 0.0)) return false;
        const double deep = touch.depth - kSlop * spacing;
        body = a;
        other = b;
        wanted = deep > 0.0 ? kLeaves * deep / dt : 0.0;
        for (int k = 0; k < 3; ++k) {
            n[k] = touch.normal[k] / std::sqrt(size);
            arm[k] = touch.arm[k] / touch.weight;
            if (other < 0) wanted += touch.velocity[k] / touch.weight * n[k];
        }
        one = Unknown::impulse(arm, n);
        given = all[body].moved_by(one);
        gives = Unknown::dot6(one, given);
        if (other < 0) return true;
        const float3 apart = period.shortest<true>(all[body].center - all[other].center);
        for (int k = 0; k < 3; ++k) arm[k] += (&apart.x)[k];
        of_other = Unknown::impulse(arm, n);
        given_to_other = all[other].moved_by(of_other);
        gives += Unknown::dot6(of_other, given_to_other);
        return true;
    }
    GB_FN void push(Unknown* all, double j) const {
        Unknown::add(all[body].motion, j, given);
        if (other >= 0) Unknown::add(all[other].motion, -j, given_to_other);
    }
    /// No nearer to each other; deeper places are left slowly.  Impulses push only, in sum: what an earlier round gave
    /// too much, a later one takes. Returns the change of speed.
    GB_FN double operator()(Unknown* all) {
        double speed = Unknown::dot6(one, all[body].motion);
        if (other >= 0) speed -= Unknown::dot6(of_other, all[other].motion);
        const double sum = impulse + (wanted - speed) / gives, j = (sum > 0.0 ? sum : 0.0) - impulse;
        impulse += j;
        push(all, j);
        return j * gives;
    }
};
/// Of all bodies, the motion that is free, and then what meetings make of it: Gauss-Seidel until nobody's speed changes
/// by more than `small`.
struct Meetings {
    Meeting* meeting;
    int n, rounds;
    double small;
    GB_FN void operator()(Unknown* body, int n_bodies) const {
        for (int b = 0; b < n_bodies; ++b) body[b].motion = body[b].free;
        for (int m = 0; m < n; ++m)
            meeting[m].push(body, meeting[m].impulse);  // of the last time, which is near to this one's
        double most = 2.0 * small;
        for (int round = 0; round < rounds && n > 0 && most > small; ++round) {
            most = 0.0;
            for (int m = 0; m < n; ++m) {
                const double change = meeting[m](body);
                most = max(most, max(change, -change));
            }
        }
    }
};

}  // namespace globule::core::sim
