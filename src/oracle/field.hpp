// The reference: float64, brute force, slow and obvious.  Every fast path is tested against it.
#pragma once
#include "base/vec.hpp"
#include "field/kernels.hpp"

namespace globule::core::oracle {

/// The particles as float64 views.  Particle j adds weight b(|G (x - q)|); G is 0 where it reaches nothing.
struct Particles {
    std::size_t n;
    const float* positions;
    const double* matrices;  ///< (n, 6) xx yy zz xy xz yz; 1 / support on the diagonal: a ball
    const double* weight;
    AnyKernel kernel;
};

/// f and grad f at m points.
void field(const Particles& p, std::size_t m, const double* points, double* value, double* gradient);

/// Smallest t >= 0 with f(o + t d) = tau (directions need not have unit length; t counts them);
/// infinity where there is none.
void first_hit(const Particles& p, double tau, std::size_t m, const float* origins, const float* directions, double* t);

}  // namespace globule::core::oracle
