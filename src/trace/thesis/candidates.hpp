// The candidates of a leaf (§5.3): its own particles, and those of its ghost neighbors whose distance
// to the leaf is at most their support.
#pragma once
#include "trace/thesis/exterior.hpp"
#include "trace/thesis/ghosts.hpp"
#include "trace/thesis/request.hpp"

namespace globule::core::thesis {

struct GatherRules {
    bool ghosts, face_rule;
    bool by_ray;  ///< list only spheres that the ray meets, ordered by entry
};

/// The candidates of the leaf that a ray is in.  The list is a cache: where more come than it holds,
/// the runs of particles are walked instead, and nothing is left out.
class Candidates {
public:
    GB_FN Candidates(const DenseTree& tree, const SortedParticles& particles, const Grid& grid, const Ray& ray,
        const GatherRules& rules)
        : tree_(tree), particles_(particles), grid_(grid), ray_(ray), rules_(rules) {}

    GB_FN void gather(const Visit& leaf) {
        ++work_.leaves;
        const bool known = rules_.face_rule && complete_ && crossed_face(leaf);
        if (known) keep_layer(leaf);
        else n_ = 0;
        complete_ = true;
        collect(leaf, known);
        if (!complete_ && known) collect(leaf, false);  // the runs of all 27
        cell_ = leaf.cell;
    }

    /// visit(candidate) for all; in order of entry where the list holds them.
    template <class Fn> GB_FN void each(const Fn& visit) const {
        if (complete_) {
            for (int i = 0; i < n_; ++i) visit(list_[i]);
            return;
        }
        for (int r = 0; r < n_runs_; ++r)
            for (std::uint32_t slot = runs_[r].first; slot < runs_[r].last; ++slot) {
                Candidate c;
                if (meet(slot, c)) visit(c);
            }
    }
    /// Only where complete().
    GB_FN int size() const { return n_; }
    GB_FN const Candidate& operator[](int i) const { return list_[i]; }
    GB_FN bool complete() const { return complete_; }
    GB_FN const SortedParticles& particles() const { return particles_; }
    GB_FN const Ray& ray() const { return ray_; }
    GB_FN const ThesisWork& work() const { return work_; }
    GB_FN void count_sum() { ++work_.sums; }

private:
    struct Run { std::uint32_t first, last; };
    static constexpr int kListed = 64;
    static constexpr std::uint32_t kNowhere = ~0u;

    GB_FN bool meet(std::uint32_t slot, Candidate& c) const {
        if (rules_.by_ray) return meet_sphere(particles_, ray_, slot, c);
        c = {slot, -infinity(), infinity()};
        return true;
    }

    /// Was the leaf before this one its neighbor across the face through which the ray enters?
    GB_FN bool crossed_face(const Visit& leaf) const {
        if (cell_ == kNowhere) return false;
        Key behind;
        const Key key = morton::Traits<Key>::inside | leaf.cell << morton::shift_of<Key>(leaf.level);
        return morton::face_neighbor(key, leaf.level, leaf.axis, -direction(leaf.axis), behind) &&
               behind == (morton::Traits<Key>::inside | cell_ << morton::shift_of<Key>(leaf.level));
    }
    GB_FN int direction(int axis) const { return component(ray_.d, axis) < 0.0f ? -1 : 1; }
    GB_FN static float component(const float3& v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

    /// Octree coordinate of a particle along an axis, as its key has it.
    GB_FN std::uint32_t layer(std::uint32_t slot, int axis) const {
        const float extent = grid_.space.extent, lo = component(grid_.space.lo, axis);
        const float scale = extent > 0.0f ? float(1 << morton::Traits<Key>::levels) / extent : 0.0f;
        return morton::quantize<Key>(component(particles_.position(slot), axis), lo, scale) >>
               (morton::Traits<Key>::levels - grid_.depth);
    }
    /// Nine-node rule: what reaches this leaf from the nine cells across its entry face reached the leaf
    /// before, which is nearer to them, so it is in that leaf's list.
    GB_FN void keep_layer(const Visit& leaf) {
        const auto before = morton::decode(cell_);
        const std::uint32_t behind = leaf.axis == 0 ? before.x : leaf.axis == 1 ? before.y : before.z;
        int kept = 0;
        for (int i = 0; i < n_; ++i)
            if (list_[i].leave > leaf.enter && layer(list_[i].slot, leaf.axis) == behind) list_[kept++] = list_[i];
        n_ = kept;
    }

    GB_FN void collect(const Visit& leaf, bool known) {
        const int depth = leaf.level;
        const Key key = morton::Traits<Key>::inside | leaf.cell << morton::shift_of<Key>(depth);
        const CellBox box(grid_, key);
        const Neighborhood around(key, depth);
        n_runs_ = 0;
        for (int k = rules_.ghosts ? 0 : 13; k < (rules_.ghosts ? 27 : 14); ++k) {  // 13: the leaf itself
            const int step[3] = {k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1};
            if (known && step[leaf.axis] == -direction(leaf.axis)) continue;
            Key there;
            if (!around.get(step[0], step[1], step[2], there)) continue;
            const DenseNode node = tree_.nodes[morton::dense_index(there, depth)];
            if (node.last <= node.first) continue;
            runs_[n_runs_++] = {node.first, node.last};
            for (std::uint32_t slot = node.first; complete_ && slot < node.last; ++slot) {
                Candidate c;
                if ((k == 13 || box.within(particles_, slot)) && meet(slot, c) && c.leave > leaf.enter) insert(c);
            }
        }
    }
    /// Keeps the order of entry, equal ones by slot: sums do not depend on where candidates came from.
    GB_FN void insert(const Candidate& c) {
        if (n_ == kListed) {
            complete_ = false;
            return;
        }
        const auto later = [&](const Candidate& s) { return s.enter == c.enter ? s.slot > c.slot : s.enter > c.enter; };
        int i = n_++;
        for (; i > 0 && later(list_[i - 1]); --i) list_[i] = list_[i - 1];
        list_[i] = c;
    }

    DenseTree tree_;
    SortedParticles particles_;
    Grid grid_;
    Ray ray_;
    GatherRules rules_;
    Run runs_[27];
    Candidate list_[kListed];
    int n_runs_ = 0, n_ = 0;
    bool complete_ = true;
    std::uint32_t cell_ = kNowhere;  ///< the leaf before
    ThesisWork work_;
};

}  // namespace globule::core::thesis
