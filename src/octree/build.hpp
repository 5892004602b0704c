// positions -> bounds -> keys -> sort -> nodes (stages.hpp), all on the device, nothing read back.
#pragma once
#include <string>

#include "backends/status.hpp"
#include "exec/buffer.hpp"
#include "octree/stages.hpp"

namespace globule::core {

/// Owns the sorted particles and the tree of one scene on one backend.
template <class Exec> class Octree {
public:
    explicit Octree(Exec& exec)
        : exec_(exec),
          bounds_(exec),
          keys_(exec),
          positions_(exec),
          index_(exec),
          support_(exec),
          weight_(exec),
          stretch_(exec),
          counts_(exec),
          scratch_(exec),
          nodes_(exec),
          dense_(exec),
          header_(exec) {}

    void build(const ParticleInput& in, const TreeParams& params) {
        n_ = in.n;
        params_ = params;
        if (params.key_bits == 64) sort_and_build<std::uint64_t>(in);
        else sort_and_build<std::uint32_t>(in);
    }

    /// Other names and weights for the sorted particles, in memory that outlives their use.
    void relabel(const std::uint32_t* index, const Attribute& weight) {
        sorted_.index = index;
        sorted_.weight = weight;
    }

    /// Room for a support, a weight and a matrix of each sorted particle; what is written there holds from reshape()
    /// on.
    struct Shapes {
        float *support, *weight, *stretch, *shortest;  ///< (n,), (n,), (n, 6), (n,)
    };
    Shapes shapes() {
        const std::size_t padded = ceil_div<std::size_t>(n_, 64) * 64 + 64;
        float* stretch = stretch_.reserve_zero(7 * padded);
        return {support_.reserve_zero(padded), weight_.reserve_zero(padded), stretch, stretch + 6 * padded};
    }
    /// The boxes anew for these shapes.
    void reshape(const Shapes& shapes, float least_axis, float most_stretch, float most_weight) {
        sorted_.support = {shapes.support, 0.0f};
        sorted_.weight = {shapes.weight, 0.0f};
        sorted_.stretch = shapes.stretch;
        sorted_.most_stretch = most_stretch;
        sorted_.shortest = shapes.shortest;
        sorted_.least_axis = least_axis;
        TreeHeader* header = header_.data();
        const std::size_t n_nodes = Exec::on_device ? capacity_ : header->n_nodes;
        std::uint32_t* scratch = scratch_.data();
        exec_.for_each(1, build::ScaleMostWeight{header, most_weight});
        exec_.clear(scratch + 2 * capacity_, n_nodes * sizeof *scratch);
        exec_.for_each_tile(n_nodes, build::RefitLeaves{header, sorted_, node_arrays()});
        exec_.for_each(
            n_nodes, build::CarryBoxes{header, node_arrays(), scratch, scratch + capacity_, scratch + 2 * capacity_});
    }

    Tree view() {
        if (lacks_nodes_) build_nodes(reinterpret_cast<const std::uint32_t*>(keys_.data()), n_);
        return {header_.data(), node_arrays()};
    }
    DenseTree dense() const { return {header_.data(), dense_.data()}; }
    const SortedParticles& particles() const { return sorted_; }
    const TreeParams& params() const { return params_; }
    std::size_t size() const { return n_; }
    /// Waits for the device.
    TreeHeader header() const {
        TreeHeader h;
        exec_.download(&h, header_.data(), sizeof h);
        if (h.n_wanted > h.n_nodes) seen_ = 0;  // more room at the next build
        return h;
    }
    std::size_t n_dense_nodes() const { return params_.dense ? morton::dense_offset(params_.depth + 1) : 0; }
    /// Nodes that there may be: numbers from the header's n_nodes on are unused.
    std::size_t max_nodes() const { return capacity_; }
    const void* keys() const { return keys_.data(); }
    NodeArrays node_arrays() const {
        float* p = nodes_.data();
        const std::size_t c = capacity_;
        return {{p, p + c, p + 2 * c, p + 3 * c, p + 4 * c, p + 5 * c}, reinterpret_cast<std::uint32_t*>(p + 6 * c),
            reinterpret_cast<std::uint32_t*>(p + 7 * c)};
    }
    const DenseNode* dense_nodes() const { return dense_.data(); }
    /// Memory that n particles take at least, one support and weight for all: keys, positions, index, counts.
    static std::uint64_t least_bytes(std::size_t n, int key_bits, int depth) {
        return n * (key_bits / 8 + 3 * sizeof(float) + sizeof(std::uint32_t)) +
               (depth + 2) * ceil_div<std::uint64_t>(n, kChunk) * sizeof(std::uint32_t);
    }
    std::size_t bytes() const {
        return bounds_.bytes() + keys_.bytes() + positions_.bytes() + index_.bytes() + support_.bytes() +
               weight_.bytes() + stretch_.bytes() + counts_.bytes() + scratch_.bytes() + nodes_.bytes() +
               dense_.bytes();
    }

private:
    template <class Key> void sort_and_build(const ParticleInput& in) {
        using namespace build;
        const std::size_t n = in.n, padded = ceil_div<std::size_t>(n, 64) * 64 + 64;
        Bounds* bounds = bounds_.reserve(1);
        TreeHeader* header = header_.reserve(1);
        if (n == 0) exec_.clear(header, sizeof *header);
        Key* keys = reinterpret_cast<Key*>(keys_.reserve(padded * sizeof(Key)));
        float* x = positions_.reserve(3 * padded);
        std::uint32_t* index = index_.reserve(padded);

        exec_.reduce(n, PointBounds{in.positions, in.support, in.weight}, Unite{}, nothing(), bounds);
        const SpaceOf space{params_, bounds};
        exec_.for_each(n, MakeKeys<Key>{in.positions, space, keys, index, &header->n_outside, n});
        // The sorted positions are written after the sort, so their room serves as its spare.
        exec_.sort_pairs(n, keys, reinterpret_cast<Key*>(x), index, reinterpret_cast<std::uint32_t*>(x + 2 * padded),
            3 * morton::Traits<Key>::levels + 1);
        float* support = in.support.data ? support_.reserve(padded) : nullptr;
        float* weight = in.weight.data ? weight_.reserve(padded) : nullptr;
        float* stretch = in.stretch ? stretch_.reserve(6 * padded) : nullptr;
        exec_.for_each(n ? padded : 0,
            Gather<Key>{in, keys, &header->n_outside, index, x, x + padded, x + 2 * padded, support, weight, stretch});
        if constexpr (!Exec::on_device) {
            if (in.given_up) exec_.give_up(in.positions, 3 * n * sizeof(float));
        }
        sorted_ = {x, x + padded, x + 2 * padded, index, {support, in.support.uniform}, {weight, in.weight.uniform},
            stretch, in.most_stretch};
        if (params_.dense) build_dense(reinterpret_cast<const std::uint32_t*>(keys), n);
        else build_nodes(keys, n);
    }

    template <class Key> void build_nodes(const Key* keys, std::size_t n) {
        using namespace build;
        lacks_nodes_ = false;
        // A node that is no leaf holds more than kLeafSize particles, and each level has each particle at most once:
        // all nodes together are fewer than 2^32, so that their sums do not wrap.
        static_assert(
            (std::uint64_t(1) << 31) * (kLeafSize + 1 + kMaxLevels) / (kLeafSize + 1) < (std::uint64_t(1) << 32));
        const std::size_t n_chunks = max<std::size_t>(1, ceil_div<std::size_t>(n, kChunk));
        const int depth = params_.depth;
        const Starts<Key> starts{keys, n, depth};
        std::uint32_t* counts = counts_.reserve((depth + 2) * n_chunks);
        exec_.for_each(n_chunks, CountNodes<Key>{starts, n_chunks, counts});
        exec_.exclusive_scan((depth + 2) * n_chunks, counts);
        TreeHeader* header = header_.data();
        if (params_.dense) seen_ = 0;  // both have the same levels: no build stops short
        make_room(counts, n_chunks, n);
        const std::size_t capacity = capacity_;
        exec_.for_each(1, WriteHeader{{params_, bounds_.data()}, n_chunks, counts, depth, capacity, header});
        if (Exec::on_device) last_.ask(exec_, header);
        std::uint32_t* scratch = scratch_.reserve(3 * capacity);
        exec_.for_each(n_chunks, EmitNodes<Key>{starts, n_chunks, counts, header, node_arrays(), scratch,
                                     scratch + capacity, scratch + 2 * capacity});
        const std::size_t n_nodes = Exec::on_device ? capacity : header->n_nodes;
        exec_.for_each_tile(n_nodes, BoxLeaves<Key>{starts, header, sorted_, node_arrays()});
        exec_.for_each(n_nodes, CarryBoxes{header, node_arrays(), scratch, scratch + capacity, scratch + 2 * capacity});
    }

    /// Room for the nodes.  A device is asked, and waited for, only when the number of particles has left the range
    /// that was seen before, or when an earlier build is known not to have fitted its room; otherwise there is slack.
    void make_room(const std::uint32_t* counts, std::size_t n_chunks, std::size_t n) {
        if (Exec::on_device && n <= seen_ && n >= seen_ / 4 && fitted()) return;
        std::uint32_t wanted;
        exec_.download(&wanted, counts + (params_.depth + 1) * n_chunks, sizeof wanted);
        if (wanted > kMaxNodes)
            throw Refused("octree: expected at most 2^29 nodes, got " + std::to_string(wanted) + ": lower `depth`");
        if (capacity_ == 0 || wanted > capacity_ || wanted < capacity_ / 4) {
            const std::size_t room = ceil_div<std::size_t>(wanted + wanted / 4, 64) * 64 + 64;
            capacity_ = 0;
            nodes_.reserve_zero(8 * room + 64);  // siblings are loaded as vectors, past the last too
            capacity_ = room;
        }
        seen_ = n + n / 4;
    }
    /// Whether the last build, as far as it is known without waiting, neither stopped short nor left most of its room
    /// empty.
    bool fitted() {
        const TreeHeader* h = last_.look();
        return !h || (h->n_wanted <= h->n_nodes && h->n_nodes >= capacity_ / 8);
    }

    /// The sparse nodes are made when somebody asks for them: the thesis's tracing does not.
    void build_dense(const std::uint32_t* keys, std::size_t n) {
        using namespace build;
        lacks_nodes_ = true;
        std::uint32_t* none = counts_.reserve(params_.depth + 2);
        exec_.clear(none, (params_.depth + 2) * sizeof *none);
        exec_.for_each(1, WriteHeader{{params_, bounds_.data()}, 1, none, params_.depth, 0, header_.data()});
        DenseNode* nodes = dense_.reserve(n_dense_nodes());
        exec_.clear(nodes, n_dense_nodes() * sizeof(DenseNode));
        exec_.for_each(n, FillDense{keys, n, params_.depth, sorted_, nodes});
        for (int level = params_.depth; level >= 0; --level)
            exec_.for_each(std::size_t(1) << 3 * level, CarryDense{level, params_.depth, sorted_, nodes});
    }

    Exec& exec_;
    Buffer<build::Bounds, Exec> bounds_;
    Buffer<char, Exec> keys_;
    Buffer<float, Exec> positions_;
    Buffer<std::uint32_t, Exec> index_;
    Buffer<float, Exec> support_, weight_, stretch_;
    Buffer<std::uint32_t, Exec> counts_, scratch_;
    Buffer<float, Exec> nodes_;
    Buffer<DenseNode, Exec> dense_;
    Buffer<TreeHeader, Exec> header_;
    SortedParticles sorted_{};
    TreeParams params_;
    std::size_t n_ = 0, capacity_ = 0;
    bool lacks_nodes_ = false;
    mutable std::size_t seen_ = 0;
    typename Exec::template Answer<TreeHeader> last_;  ///< what the last build found out
};

}  // namespace globule::core
