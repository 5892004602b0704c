// One rigid body on the host: mass, pose, momenta.  float64; a handful of numbers a step.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>

#include "sim/rigid.hpp"

namespace globule::core {

class RigidBody {
public:
    using V = std::array<double, 3>;
    using M = std::array<double, 9>;

    /// center: of mass, world; inertia: about it, in the axes of the world now.
    RigidBody(double mass, const V& center, const M& inertia) : mass_(mass), center_(center), inertia_(inertia) {}

    V velocity{}, spin{};  ///< world

    double mass() const { return mass_; }
    const V& center() const { return center_; }
    float3 center_float() const { return {float(center_[0]), float(center_[1]), float(center_[2])}; }
    sim::Pose pose() const { return pose(center_, rotation_); }

    /// About the center, in the axes of the world.
    M inertia_now() const { return turned(inertia_); }
    /// 0 of what has none.
    M inverse_inertia_now() const {
        const M& m = inertia_;
        const double det = m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
                           m[2] * (m[3] * m[7] - m[4] * m[6]);
        if (!(det > 0)) return M{};
        return turned({(m[4] * m[8] - m[5] * m[7]) / det, (m[2] * m[7] - m[1] * m[8]) / det,
            (m[1] * m[5] - m[2] * m[4]) / det, (m[5] * m[6] - m[3] * m[8]) / det, (m[0] * m[8] - m[2] * m[6]) / det,
            (m[2] * m[3] - m[0] * m[5]) / det, (m[3] * m[7] - m[4] * m[6]) / det, (m[1] * m[6] - m[0] * m[7]) / det,
            (m[0] * m[4] - m[1] * m[3]) / det});
    }

    void push(const double p[3], const double l[3]) {
        const V dw = turn({l[0], l[1], l[2]});
        for (int k = 0; k < 3; ++k) {
            velocity[k] += p[k] / mass_;
            spin[k] += dw[k];
        }
    }
    /// Angular momentum stays: the spin that turns a body is that of halfway (midpoint rule), in parts of a step small
    /// enough for who tumbles: with turns of 0.1 rad at once, flips about the middle axis come 7 % late.
    void advance(double dt) {
        for (int k = 0; k < 3; ++k) center_[k] += dt * velocity[k];
        const V momentum = times(inertia_now(), spin);
        const double angle = std::hypot(spin[0], spin[1], spin[2]) * dt;
        const int n = int(std::clamp(std::ceil(angle / kTurn), 1.0, kMostParts));
        for (int part = 0; part < n; ++part) {
            const M before = rotation_;
            rotate(spin, 0.5 * dt / n);
            const V halfway = spin_of(momentum);
            rotation_ = before;
            rotate(halfway, dt / n);
            spin = spin_of(momentum);
        }
    }
    /// A center beyond a domain that repeats comes in again on the other side.
    void wrap(const float3& lo, const float3& period) {
        for (int k = 0; k < 3; ++k)
            if (const double length = (&period.x)[k]; length > 0)
                center_[k] -= length * std::floor((center_[k] - (&lo.x)[k]) / length);
    }

    /// All that it is, for a checkpoint.
    static constexpr std::size_t n_numbers = 28;
    std::array<double, n_numbers> numbers() const {
        std::array<double, n_numbers> out;
        auto at = std::copy(velocity.begin(), velocity.end(), out.begin());
        at = std::copy(spin.begin(), spin.end(), at);
        *at++ = mass_;
        at = std::copy(center_.begin(), center_.end(), at);
        at = std::copy(inertia_.begin(), inertia_.end(), at);
        std::copy(rotation_.begin(), rotation_.end(), at);
        return out;
    }
    explicit RigidBody(const std::array<double, n_numbers>& numbers) {
        auto from = numbers.begin();
        const auto take = [&](auto& to) {
            for (double& x : to) x = *from++;
        };
        take(velocity);
        take(spin);
        mass_ = *from++;
        take(center_);
        take(inertia_);
        take(rotation_);
    }

private:
    static constexpr double kTurn = 0.01, kMostParts = 1000;  ///< rad
    static V times(const M& m, const V& v) {
        V out{};
        for (int k = 0; k < 3; ++k) out[k] = m[3 * k] * v[0] + m[3 * k + 1] * v[1] + m[3 * k + 2] * v[2];
        return out;
    }
    /// As it is turned now; what has no inertia keeps its spin.
    V spin_of(const V& momentum) const {
        const V out = times(inverse_inertia_now(), momentum);
        return out == V{} ? spin : out;
    }
    /// By the spin's angle about its axis (Rodrigues), then the axes made orthonormal again.
    void rotate(const V& by, double dt) {
        const double w = std::sqrt(by[0] * by[0] + by[1] * by[1] + by[2] * by[2]);
        if (!(w * dt > 0)) return;
        const V axis{by[0] / w, by[1] / w, by[2] / w};
        const double c = std::cos(w * dt), s = std::sin(w * dt);
        for (int column = 0; column < 3; ++column) {
            const V v{rotation_[column], rotation_[3 + column], rotation_[6 + column]};
            const V x = cross3(axis, v);
            const double d = (axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2]) * (1 - c);
            for (int k = 0; k < 3; ++k) rotation_[3 * k + column] = c * v[k] + s * x[k] + d * axis[k];
        }
        orthonormalize();
    }
    static V cross3(const V& a, const V& b) {
        return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    }
    static sim::Pose pose(const V& c, const M& r) {
        return {{float(r[0]), float(r[3]), float(r[6])}, {float(r[1]), float(r[4]), float(r[7])},
            {float(r[2]), float(r[5]), float(r[8])}, {float(c[0]), float(c[1]), float(c[2])}};
    }
    /// What a moment adds to the spin.
    V turn(const V& l) const { return times(inverse_inertia_now(), l); }
    /// In the axes of the world, of what is told in those of the body.
    M turned(const M& m) const {
        M out{};
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c)
                for (int i = 0; i < 3; ++i)
                    for (int k = 0; k < 3; ++k)
                        out[3 * r + c] += rotation_[3 * r + i] * m[3 * i + k] * rotation_[3 * c + k];
        return out;
    }
    void orthonormalize() {
        V x{rotation_[0], rotation_[3], rotation_[6]}, y{rotation_[1], rotation_[4], rotation_[7]};
        const auto unit = [](V v) {
            const double n = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
            return V{v[0] / n, v[1] / n, v[2] / n};
        };
        x = unit(x);
        const double along = x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
        y = unit({y[0] - along * x[0], y[1] - along * x[1], y[2] - along * x[2]});
        const V z = cross3(x, y);
        for (int k = 0; k < 3; ++k) {
            rotation_[3 * k] = x[k];
            rotation_[3 * k + 1] = y[k];
            rotation_[3 * k + 2] = z[k];
        }
    }

    double mass_;
    V center_;
    M inertia_;
    M rotation_{1, 0, 0, 0, 1, 0, 0, 0, 1};
};

}  // namespace globule::core
