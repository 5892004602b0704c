// A rigid body's velocity and spin as unknowns, and contacts of bodies with walls and with each other: impulses are equal and opposite.
#pragma once
#include "sim/rigid_drag.hpp"

namespace globule::core::sim {

/// One body.  Masses, momenta and forces are over the volume of a particle of size 1.
struct Unknown {
    std::uint8_t phase = 0;
    float3 center{0, 0, 0};
    double mass = 0, inertia[9] = {}, inverse[9] = {};  ///< world
    Impulse free, motion;        ///< velocity and spin: by what fluid does, and by what bodies and walls that it touches allow
    Drag drag;
    Arm reach;                   ///< sums of lengths
    // Conjugate gradients: the preconditioner's share of the mass in what a speed costs, velocities and spins, impulses and their moments.
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

    GB_FN void arm_of(const double at[3], const Period& period, double arm[3]) const {
        const float3 a = period.shortest<true>(float3{float(at[0] - center.x), float(at[1] - center.y), float(at[2] - center.z)});
        arm[0] = a.x, arm[1] = a.y, arm[2] = a.z;
    }
    GB_FN static void cross3(const double a[3], const double b[3], double out[3]) {
        for (int k = 0; k < 3; ++k) out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
    }
    /// Speed along n of a point.
    GB_FN double speed(const double arm[3], const double n[3]) const {
        double turned[3], sum = 0.0;
        cross3(motion.l, arm, turned);
        for (int k = 0; k < 3; ++k) sum += (motion.p[k] + turned[k]) * n[k];
        return sum;
    }
    GB_FN static Impulse impulse(const double arm[3], const double n[3]) {
        Impulse i;
        for (int k = 0; k < 3; ++k) i.p[k] = n[k];
        cross3(arm, n, i.l);
        return i;
    }
};

/// A place where two bodies touch, or one and what key frames move.
struct Meeting {
    int body = 0, other = -1;
    Touch touch;
    double slop = 0.0;     ///< how deep it may rest
    double impulse = 0.0;  ///< so far

    /// No nearer to each other; deeper places are left slowly.  Impulses push only, in sum: what an earlier round gave too much, a later one takes.
    GB_FN void operator()(Unknown* all, const Period& period, double dt, bool again) {
        double n[3], at[3], size = 0.0;
        for (int k = 0; k < 3; ++k) size += touch.normal[k] * touch.normal[k];
        if (!(touch.weight > 0.0) || !(size > 0.0)) return;
        double moves = 0.0;
        for (int k = 0; k < 3; ++k) {
            n[k] = touch.normal[k] / sqrt(size);
            at[k] = touch.point[k] / touch.weight;
            moves += touch.velocity[k] / touch.weight * n[k];
        }
        Unknown& mine = all[body];
        double arm[3], arm_of_other[3];
        mine.arm_of(at, period, arm);
        const Impulse one = Unknown::impulse(arm, n), given = mine.moved_by(one);
        double gives = Unknown::dot6(one, given);
        Impulse given_to_other;
        if (other >= 0) {
            all[other].arm_of(at, period, arm_of_other);
            const Impulse i = Unknown::impulse(arm_of_other, n);
            given_to_other = all[other].moved_by(i);
            gives += Unknown::dot6(i, given_to_other);
        }
        double j = impulse;  // of the last time, which is near to this one's
        if (!again) {
            if (other >= 0) moves = all[other].speed(arm_of_other, n);
            const double deep = touch.depth - slop, wanted = deep > 0.0 ? kLeaves * deep / dt : 0.0;
            const double sum = impulse + (wanted - (mine.speed(arm, n) - moves)) / gives;
            j = (sum > 0.0 ? sum : 0.0) - impulse;
            impulse += j;
        }
        Unknown::add(mine.motion, j, given);
        if (other >= 0) Unknown::add(all[other].motion, -j, given_to_other);
    }
    static constexpr double kLeaves = 0.1;  ///< of the depth, in a step
};
/// Of all bodies, the motion that is free, and then what meetings make of it.
struct Meetings {
    static constexpr int kRounds = 8;
    Meeting* meeting;
    int n;
    Period period;
    double dt;
    GB_FN void operator()(Unknown* body, int n_bodies) const {
        for (int b = 0; b < n_bodies; ++b) body[b].motion = body[b].free;
        for (int m = 0; m < n; ++m) meeting[m](body, period, dt, true);
        for (int round = 0; round < kRounds; ++round)
            for (int m = 0; m < n; ++m) meeting[m](body, period, dt, false);
    }
};

}  // namespace globule::core::sim
