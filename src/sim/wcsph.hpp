// Weakly compressible SPH as a cross-check: pressure from the density by Tait's equation (Becker & Teschner 2007).
#pragma once
#include "sim/pressure.hpp"

namespace globule::core::sim {

struct TaitPressure {
    const std::uint32_t* rows;
    Rows values;
    float sound_speed, dt;
    float* pressure;
    float* change;  ///< impulse per slot, as pressure.hpp's push takes it
    GB_FN void operator()(std::size_t row) const {
        const float inverse_rho = values.inverse_rho[row];
        float p = 0.0f;
        if (inverse_rho > 0.0f) {
            const float d = max(values.density[row], 1.0f), d3 = d * d * d;
            p = sound_speed * sound_speed / (7.0f * inverse_rho) * (d3 * d3 * d - 1.0f);
        }
        pressure[rows[row]] = p * kFlux;
        change[rows[row]] = p * dt;
    }
};

}  // namespace globule::core::sim
