// A simulation on several ranks that draws the exact surface of all its particles at every step, where they are:
//   mpiexec -n 4 insitu_mpi [steps [spacing [draw every so many steps [device]]]]
//
// Weakly compressible SPH (Monaghan 1994, Becker & Teschner 2007): a dam that breaks in a tank of 2 x 1 x 0.5 m.  The
// ranks are a grid in x and z; each has the particles in its column and, as ghost particles, those of the others within
// two supports. Nothing is copied for the image: the ghosts that the forces need are the halo that the image needs. The
// result has the same bits on any number of ranks: neighbors are summed in the order of their numbers.
#include <mpi.h>

#include <globule/globule.hpp>
#include <globule/mpi.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "files.hpp"

namespace {

constexpr float kTank[3] = {2.0f, 1.0f, 0.5f}, kDam[3] = {0.8f, 0.8f, 0.5f};
constexpr float kDensity = 1000, kGravity = 9.81f, kSound = 40, kViscosity = 0.1f;

struct Particle {
    int number;
    std::array<float, 3> x, v;
};

/// The ranks as a grid in x and z.
struct Ranks {
    MPI_Comm comm = MPI_COMM_NULL;
    int rank = 0, size = 1, grid[2] = {0, 0}, mine[2] = {0, 0};

    Ranks() {
        const int periodic[2] = {0, 0};
        MPI_Comm_size(MPI_COMM_WORLD, &size);
        MPI_Dims_create(size, 2, grid);
        MPI_Cart_create(MPI_COMM_WORLD, 2, grid, periodic, 0, &comm);
        MPI_Comm_rank(comm, &rank);
        MPI_Cart_coords(comm, rank, 2, mine);
    }
    /// The border before column k along x (axis 0) or z (axis 1); infinite outside of the tank.
    float border(int axis, int k) const {
        const float far = std::numeric_limits<float>::infinity();
        return k <= 0 ? -far : k >= grid[axis] ? far : kTank[2 * axis] * float(k) / float(grid[axis]);
    }
    /// Every rank whose column, widened by `wide`, holds x; without this one.
    template <class F> void each_other(const std::array<float, 3>& x, float wide, F&& fn) const {
        for (int k = 0; k < size; ++k) {
            int at[2];
            MPI_Cart_coords(comm, k, 2, at);
            bool inside = k != rank;
            for (int a = 0; a < 2; ++a)
                inside = inside && x[2 * a] >= border(a, at[a]) - wide && x[2 * a] < border(a, at[a] + 1) + wide;
            if (inside) fn(k);
        }
    }
    bool owns(const std::array<float, 3>& x) const {
        for (int a = 0; a < 2; ++a)
            if (!(x[2 * a] >= border(a, mine[a]) && x[2 * a] < border(a, mine[a] + 1))) return false;
        return true;
    }
    globule::Box box() const {
        const double far = std::numeric_limits<double>::infinity();
        return {{border(0, mine[0]), -far, border(1, mine[1])}, {border(0, mine[0] + 1), far, border(1, mine[1] + 1)}};
    }
    /// What the others have sent to this rank.
    std::vector<Particle> exchange(const std::vector<std::vector<Particle>>& to) const {
        std::vector<int> out(to.size()), in(to.size()), from(to.size()), at(to.size());
        std::vector<Particle> sent;
        for (std::size_t k = 0; k < to.size(); ++k) {
            from[k] = int(sent.size() * sizeof(Particle)), out[k] = int(to[k].size() * sizeof(Particle));
            sent.insert(sent.end(), to[k].begin(), to[k].end());
        }
        MPI_Alltoall(out.data(), 1, MPI_INT, in.data(), 1, MPI_INT, comm);
        std::exclusive_scan(in.begin(), in.end(), at.begin(), 0);
        std::vector<Particle> came(std::size_t(at.back() + in.back()) / sizeof(Particle));
        MPI_Alltoallv(
            sent.data(), out.data(), from.data(), MPI_BYTE, came.data(), in.data(), at.data(), MPI_BYTE, comm);
        return came;
    }
};

/// The water of one rank.
class Water {
public:
    const float spacing, support, step;
    std::vector<float> positions;  // (N, 3), flat: of own particles and ghosts, by number

    Water(const Ranks& ranks, float spacing_)
        : spacing(spacing_), support(2 * spacing_), step(0.25f * spacing_ / kSound), ranks_(ranks) {
        const int n[3] = {int(kDam[0] / spacing), int(kDam[1] / spacing), int(kDam[2] / spacing)};
        for (int i = 0; i < n[0] * n[1] * n[2]; ++i) {
            const int at[3] = {i % n[0], i / n[0] % n[1], i / n[0] / n[1]};
            Particle p{i, {}, {}};
            for (int c = 0; c < 3; ++c) {  // not quite a lattice, which would fall in sheets
                const float noise = float((unsigned(3 * i + c) + 1) * 2654435761u >> 8) / float(1 << 24) - 0.5f;
                p.x[c] = (float(at[c]) + 0.5f + 0.2f * noise) * spacing;
            }
            if (ranks_.owns(p.x)) own_.push_back(p);
        }
        refresh();
    }
    std::size_t size() const { return own_.size(); }

    void advance() {
        const std::size_t n = all_.size();
        std::vector<float> pressure(n), density(n);
        const float mass = kDensity * spacing * spacing * spacing,
                    normal = 21 / (2 * 3.14159265f * support * support * support);
        for (std::size_t i = 0; i < n; ++i) {  // that of the outer ghosts is too small, but no own particle sees them
            float sum = 0;
            each_near(i, [&](std::size_t, float q, const float*) { sum += kernel(q); });
            density[i] = std::max(mass * normal * sum, kDensity);  // no suction
            pressure[i] = kSound * kSound * (density[i] - kDensity);
        }
        std::size_t next = 0;
        for (std::size_t i = 0; i < n; ++i) {
            if (ghost_[i]) continue;
            Particle& p = own_[next++];
            float force[3] = {0, -kGravity, 0};
            each_near(i, [&](std::size_t j, float q, const float* away) {
                if (q <= 0) return;
                const float r = q * support;
                const Particle &a = all_[i], &b = all_[j];
                float closing = 0;
                for (int c = 0; c < 3; ++c) closing += (a.v[c] - b.v[c]) * away[c];
                const float viscous = closing < 0
                                          ? -kViscosity * support * kSound * closing /
                                                ((r * r + 0.01f * support * support) * 0.5f * (density[i] + density[j]))
                                          : 0;
                const float push =
                    pressure[i] / (density[i] * density[i]) + pressure[j] / (density[j] * density[j]) + viscous;
                for (int c = 0; c < 3; ++c) force[c] -= mass * push * normal * slope(q) / support * away[c] / r;
            });
            for (int c = 0; c < 3; ++c) p.v[c] += step * force[c];
        }
        const float half = 0.5f * spacing;
        for (Particle& p : own_)
            for (int c = 0; c < 3; ++c) {
                p.x[c] += step * p.v[c];
                const float inside = std::clamp(p.x[c], half, kTank[c] - half);
                if (inside != p.x[c]) p.v[c] = 0;
                p.x[c] = inside;
            }
        refresh();
    }

private:
    const Ranks& ranks_;
    std::vector<Particle> own_, all_;  // by number
    std::vector<char> ghost_;
    std::vector<int> first_, sorted_;  // particles of each cell, by number
    int cells_[3] = {0, 0, 0};

    static float kernel(float q) {  // Wendland C2
        const float a = 1 - q;
        return a * a * a * a * (1 + 4 * q);
    }
    static float slope(float q) {
        const float a = 1 - q;
        return -20 * q * a * a * a;
    }
    int cell(const std::array<float, 3>& x, int c) const { return std::clamp(int(x[c] / support), 0, cells_[c] - 1); }
    static void sort(std::vector<Particle>& some) {
        std::sort(some.begin(), some.end(), [](const Particle& a, const Particle& b) { return a.number < b.number; });
    }

    /// Own particles to the ranks that own them now, then the ghosts, then the cells.
    void refresh() {
        std::vector<std::vector<Particle>> to(std::size_t(ranks_.size));
        std::vector<Particle> stay;
        for (const Particle& p : own_)
            if (ranks_.owns(p.x)) stay.push_back(p);
            else ranks_.each_other(p.x, 0, [&](int k) { to[std::size_t(k)].push_back(p); });
        own_ = ranks_.exchange(to);
        own_.insert(own_.end(), stay.begin(), stay.end());
        sort(own_);
        for (auto& some : to) some.clear();
        for (const Particle& p : own_)
            ranks_.each_other(p.x, 2.1f * support, [&](int k) { to[std::size_t(k)].push_back(p); });
        all_ = ranks_.exchange(to);
        all_.insert(all_.end(), own_.begin(), own_.end());
        sort(all_);
        const std::size_t n = all_.size();
        ghost_.resize(n), positions.resize(3 * n), sorted_.resize(n);
        for (int c = 0; c < 3; ++c) cells_[c] = int(kTank[c] / support) + 1;
        first_.assign(std::size_t(cells_[0] * cells_[1] * cells_[2]) + 1, 0);
        std::vector<int> place(n);
        for (std::size_t i = 0; i < n; ++i) {
            const auto& x = all_[i].x;
            ghost_[i] = !ranks_.owns(x);
            std::copy_n(x.data(), 3, &positions[3 * i]);
            place[i] = (cell(x, 2) * cells_[1] + cell(x, 1)) * cells_[0] + cell(x, 0);
            ++first_[std::size_t(place[i]) + 1];
        }
        std::partial_sum(first_.begin(), first_.end(), first_.begin());
        std::vector<int> next(first_.begin(), first_.end() - 1);
        for (std::size_t i = 0; i < n; ++i) sorted_[std::size_t(next[std::size_t(place[i])]++)] = int(i);
    }

    /// fn(j, distance / support, x_i - x_j) for all particles j within the support of i.
    template <class F> void each_near(std::size_t i, F&& fn) const {
        const auto& x = all_[i].x;
        int low[3], high[3];
        for (int c = 0; c < 3; ++c)
            low[c] = std::max(cell(x, c) - 1, 0), high[c] = std::min(cell(x, c) + 1, cells_[c] - 1);
        for (int z = low[2]; z <= high[2]; ++z)
            for (int y = low[1]; y <= high[1]; ++y) {
                const int row = (z * cells_[1] + y) * cells_[0];
                for (int at = first_[std::size_t(row + low[0])]; at < first_[std::size_t(row + high[0] + 1)]; ++at) {
                    const std::size_t j = std::size_t(sorted_[std::size_t(at)]);
                    float away[3], square = 0;
                    for (int c = 0; c < 3; ++c) away[c] = x[c] - all_[j].x[c], square += away[c] * away[c];
                    if (square < support * support) fn(j, std::sqrt(square) / support, away);
                }
            }
    }
};

}  // namespace

int main(int n_arguments, char** arguments) {
    MPI_Init(&n_arguments, &arguments);
    const int steps = n_arguments > 1 ? std::atoi(arguments[1]) : 400,
              every = n_arguments > 3 ? std::max(1, std::atoi(arguments[3])) : 1;
    const float spacing = n_arguments > 2 ? float(std::atof(arguments[2])) : 0.03f;
    const int width = 640, height = 400;
    int failed = 0;
    {
        const Ranks ranks;
        try {
            Water water(ranks, spacing);
            // The tank is the octree's space on every rank: rays are then traced alike, to the bit.
            const globule::Box tank{{0, 0, 0}, {kTank[0], kTank[1], kTank[2]}};
            const globule::SceneOptions options{
                .device = n_arguments > 4 ? arguments[4] : "cpu", .threads = 1, .bounds = tank};
            globule::Scene scene = globule::mpi::together(ranks.comm, [&] { return globule::Scene(options); });
            const globule::Camera camera{.eye = {1.3, 1.0, 2.6}, .look_at = {0.95, 0.3, 0.25}};
            globule::mpi::Image image;
            double simulated = 0, drawn = 0;
            for (int s = 1; s <= steps; ++s) {
                const double start = MPI_Wtime();
                water.advance();
                const double between = MPI_Wtime();
                if (s % every == 0) {
                    globule::mpi::together(ranks.comm, [&] {
                        scene.update(
                            {.positions = water.positions, .support = water.support, .color = {0.1, 0.35, 0.8}});
                        return true;
                    });
                    image = globule::mpi::render(
                        ranks.comm, scene, ranks.box(), 1e-3 * water.support, camera, width, height);
                }
                simulated += between - start, drawn += MPI_Wtime() - between;
            }
            unsigned long own = water.size(), all = 0;
            MPI_Reduce(&own, &all, 1, MPI_UNSIGNED_LONG, MPI_SUM, 0, ranks.comm);
            if (ranks.rank == 0) {
                if (!image.rgb.empty()) write_ppm("insitu_mpi.ppm", image.rgb, width, height);
                std::printf(
                    "insitu_mpi.ppm: %lu particles on %d ranks, %d steps; simulating %.2f ms a step, drawing %.2f ms: "
                    "%.0f %% of the time\n",
                    all, ranks.size, steps, 1e3 * simulated / std::max(steps, 1), 1e3 * drawn / std::max(steps, 1),
                    100 * drawn / std::max(simulated + drawn, 1e-9));
            }
        } catch (const std::exception& e) {
            if (ranks.rank == 0) std::fprintf(stderr, "%s\n", e.what());
            failed = 1;
        }
    }
    MPI_Finalize();
    return failed;
}
