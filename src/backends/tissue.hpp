// What a compiled backend offers for tissue: bonds, the knife, pieces, vessels.  It runs by itself, or
// as a part of a simulation (sim/simulation.hpp).
#pragma once
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "backends/object.hpp"
#include "globule/values.hpp"
#include "sim/blade.hpp"
#include "sim/bonds.hpp"

namespace globule::core {

/// A body's arrays in host memory, in the tissue's own order: particles that are close stand close.
struct TissueArrays {
    std::uint32_t n = 0;
    const std::uint32_t* ids;      ///< (n,)
    const float* positions;        ///< (n, 3)
    const float* inverse_mass;     ///< (n,) 1/kg; 0 for what never moves by itself
    const float* bound;            ///< (n,) largest eigenvalue of Σ n nᵀ over its bonds, with a margin
    const std::uint8_t* hold;      ///< (n,) tissue::kFree ...
    const std::uint8_t* phase;     ///< (n,)
    const std::uint64_t* offsets;  ///< (n + 1,) bonds of each particle; every bond stands at both ends
    const std::uint32_t* other;
    const float* length;     ///< m
    const float* stiffness;  ///< N/m
    float contact;           ///< m, distance that cut faces keep: the spacing
    const float* lame =
        nullptr;  ///< (2, n) volume times μ and volume times λ, J, of a solid (sim/solid.hpp); null: bonds alone
    float frequency = 0.0f;             ///< 1/s, of the solid's stiffest motion
    const float* relaxation = nullptr;  ///< (n_terms, 2) share of μ that relaxes, and its rate, 1/s
    std::uint32_t n_terms = 0;          ///< up to tissue::kMostTerms
};

struct TissueStep {
    float dt;
    int substeps;  ///< 0: as many as the stiffest bond asks for
    int iterations = 1;
    float3 gravity;
};

/// A blade's triangles, world coordinates.
struct BladeSweep {
    const double* vertices;              ///< (n_vertices, 3)
    std::uint32_t n_vertices, n_moving;  ///< the first n_moving are seen from where bonds were at `follow`
    const std::uint32_t* triangles;      ///< (n_triangles, 3)
    std::uint32_t n_triangles;
};

struct Tissue : Object {
    /// One more body; bonds' numbers count from its own first particle.
    virtual void add(const TissueArrays& body) = 0;
    virtual void set_materials(const tissue::Materials& materials) = 0;
    virtual void set_instruments(const tissue::Motions& motions, const tissue::Shapes& shapes) = 0;
    virtual int advance(const TissueStep& step) = 0;         ///< substeps done
    virtual std::uint32_t tear(float dt) = 0;                ///< bonds torn
    virtual void follow() = 0;                               ///< remembers positions for the next relative sweep
    virtual std::uint32_t cut(const BladeSweep& sweep) = 0;  ///< bonds cut
    virtual std::uint32_t pieces() = 0;
    virtual void grasp(const float3& center, float radius, int number) = 0;
    virtual std::uint32_t remove(const tissue::Shape& region) = 0;
    /// Of the last step's mean: force (N) and moment (N m) on each grasp, about its center, then on each shape, about
    /// its point a: 6 each.
    virtual std::vector<double> felt() = 0;
    virtual std::uint32_t n() = 0;        ///< with the places that are nobody's
    virtual std::uint32_t n_bonds() = 0;  ///< whole ones
    virtual double elastic_energy() = 0;  ///< J, of whole bonds
    virtual int substeps(float dt) = 0;   ///< that keep the static stiffness exact
    virtual void get(float* positions, float* velocities, std::uint32_t* piece, std::uint8_t* hold,
        std::uint32_t* ids) = 0;  ///< any may be null
    virtual void set(const float* positions, const float* velocities) = 0;
    /// (n, 3) m/s², beside gravity, until others are set; null: none.
    virtual void accelerate(const float* accelerations) = 0;
    /// What bleeds.  number: from 1; vessels before it that were never set do not bleed.
    virtual void set_vessel(std::size_t number, const BloodVessel& vessel) = 0;
    virtual std::vector<BloodVessel> vessels() = 0;
    /// All that a checkpoint needs: arrays by name, with their bytes.
    virtual std::vector<std::pair<std::string, std::size_t>> arrays() = 0;
    virtual void read(const std::string& name, void* out) = 0;
    virtual void write(const std::string& name, const void* in, std::size_t bytes) = 0;
};

}  // namespace globule::core
