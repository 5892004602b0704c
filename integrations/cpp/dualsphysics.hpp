// Particles of DualSPHysics, from the arrays of its CPU solver: no file in between, and no copy where the fluid lies in
// one piece.
#pragma once
#include <globule/globule.hpp>

#include <cmath>
#include <cstdint>
#include <vector>

namespace globule::adaptors {

/// Which of the solver's particles are fluid, drawn from where they are.  Positions are tfloat3 or tdouble3, velrhop is
/// tfloat4 (velocity and density), idp unsigned, and code typecode, of 2 or 4 bytes.
template <class Position, class VelocityDensity, class Code> class DualSPHysics {
public:
    /// The scene's options for a distance dp between particles: one surface that encloses the fluid's volume.
    static SceneOptions options(double dp) { return {.surface = Surface::smooth, .spacing = dp}; }

    /// np particles, of which the first npb are boundary, as in JSphCpu.  The arrays must stay as Scene::update says.
    Particles fluid(std::size_t np, std::size_t npb, const Position* pos, const Code* code) {
        std::size_t begin = npb, end = np;
        while (begin < end && !is_fluid(code[begin])) ++begin;
        while (begin < end && !is_fluid(code[end - 1])) --end;
        begin_ = begin, count_ = end - begin, rows_.clear();
        for (std::size_t i = begin; i < end; ++i)
            if (!is_fluid(code[i])) {  // floating bodies, periodic copies or what has left: take the others out
                choose(code, begin, end);
                break;
            }
        if (rows_.empty()) return {.positions = flat(pos + begin_)};
        positions_.clear();
        for (const std::size_t i : rows_) positions_.push_back(pos[i]);
        return {.positions = flat(positions_.data())};
    }

    /// Of each particle that `fluid` gave last: its speed, and its idp.
    std::vector<float> speeds(const VelocityDensity* velrhop) const {
        return each<float>([&](std::size_t i) {
            const VelocityDensity& v = velrhop[i];
            return float(std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z));
        });
    }
    std::vector<std::uint32_t> ids(const std::uint32_t* idp) const {
        return each<std::uint32_t>([&](std::size_t i) { return idp[i]; });
    }

    /// Whether the last positions are the solver's own array.
    bool in_place() const { return rows_.empty(); }

    /// No copy of a periodic particle, and not excluded: the upper three bits are 0.
    static constexpr bool is_fluid(Code code) {
        static_assert(sizeof(Code) == 2 || sizeof(Code) == 4);
        constexpr std::uint32_t special = sizeof(Code) == 2 ? 0xe000u : 0xe0000000u;
        constexpr std::uint32_t type = sizeof(Code) == 2 ? 0x1800u : 0x00030000u;
        return (code & special) == 0 && (code & type) == type;
    }

private:
    static ArrayView flat(const Position* p, std::size_t n) { return {&p->x, Shape(n, 3)}; }
    ArrayView flat(const Position* p) const { return flat(p, rows_.empty() ? count_ : rows_.size()); }

    void choose(const Code* code, std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
            if (is_fluid(code[i])) rows_.push_back(i);
    }

    template <class T, class Get> std::vector<T> each(const Get& get) const {
        std::vector<T> found(rows_.empty() ? count_ : rows_.size());
        for (std::size_t k = 0; k < found.size(); ++k) found[k] = get(rows_.empty() ? begin_ + k : rows_[k]);
        return found;
    }

    std::size_t begin_ = 0, count_ = 0;
    std::vector<std::size_t> rows_{};  // empty: all from begin_ on
    std::vector<Position> positions_{};
};

}  // namespace globule::adaptors
