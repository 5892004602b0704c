// What the adaptor needs of AMReX, with the same names and the same layout in memory, for its test: a particle is a
// struct of positions, real numbers, an id whose first bit says that it is there, and whole numbers.
#pragma once
#include <cstdint>
#include <vector>

namespace amrex_like {

template <int NReal, int NInt> struct Particle {
    static constexpr bool is_soa_particle = false;
    double m_pos[3];
    double m_rdata[NReal];
    std::uint64_t m_idcpu;
    int m_idata[NInt];

    double pos(int k) const { return m_pos[k]; }
    std::int64_t id() const {
        const auto value = std::int64_t((m_idcpu >> 24) & 0x7FFFFFFFFFull);
        return m_idcpu >> 63 ? value : -value;
    }
    void set_id(std::int64_t id) {
        m_idcpu = (id > 0 ? std::uint64_t(1) << 63 : 0) | std::uint64_t(id > 0 ? id : -id) << 24;
    }
};

template <int NReal, int NInt> struct ArrayOfStructs : std::vector<Particle<NReal, NInt>> {
    const Particle<NReal, NInt>& operator[](int i) const { return this->begin()[i]; }
};

struct StructOfArrays {
    std::vector<std::vector<double>> real{};
    const std::vector<double>& GetRealData(int k) const { return real[std::size_t(k)]; }
};

template <int NReal, int NInt> struct ParticleTile {
    using ParticleType = Particle<NReal, NInt>;
    ArrayOfStructs<NReal, NInt> aos{};
    StructOfArrays soa{};
    int numParticles() const { return int(aos.size()); }
    const auto& GetArrayOfStructs() const { return aos; }
    const auto& GetStructOfArrays() const { return soa; }
};

}  // namespace amrex_like
