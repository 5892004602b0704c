// What moves boundaries and rigid bodies, as bytes of a checkpoint.
#pragma once
#include <array>
#include <cmath>
#include <cstring>
#include <map>
#include <vector>

#include "backends/status.hpp"
#include "sim/rigid_body.hpp"

namespace globule::core {

/// Counts and numbers one after the other, in the machine's order.
class MotionWriter {
public:
    std::vector<char> bytes;
    void count(std::uint64_t n) { put(n); }
    template <class Numbers> void numbers(const Numbers& all) {
        for (const auto x : all) put(x);
    }

private:
    template <class T> void put(T x) {
        const char* from = reinterpret_cast<const char*>(&x);
        bytes.insert(bytes.end(), from, from + sizeof x);
    }
};
class MotionReader {
public:
    explicit MotionReader(const std::vector<char>& bytes) : bytes_(bytes) {}
    /// How many items follow, each of at least so many bytes.
    std::size_t count(std::size_t item) {
        const auto n = take<std::uint64_t>();
        if (n > (bytes_.size() - at_) / item)
            throw Refused("checkpoint: expected all of the bodies that move, got a part");
        return n;
    }
    template <class T, std::size_t n> std::array<T, n> numbers(bool finite = true) {
        std::array<T, n> out;
        for (T& x : out) {
            x = take<T>();
            if (finite && !std::isfinite(x)) refuse();
        }
        return out;
    }
    /// A body's number.
    int phase() {
        const std::uint64_t k = take<std::uint64_t>();
        if (k >= sim::kMaxPhases) refuse();
        return int(k);
    }
    void end() const {
        if (at_ != bytes_.size()) throw Refused("checkpoint: expected the end of the bodies that move, got more");
    }

private:
    [[noreturn]] static void refuse() {
        throw Refused("checkpoint: expected phases and finite numbers of the bodies that move, got others");
    }
    template <class T> T take() {
        T x;
        if (bytes_.size() - at_ < sizeof x)
            throw Refused("checkpoint: expected all of the bodies that move, got a part");
        std::memcpy(&x, bytes_.data() + at_, sizeof x);
        at_ += sizeof x;
        return x;
    }
    const std::vector<char>& bytes_;
    std::size_t at_ = 0;
};

inline std::vector<char> save_motion(
    const std::vector<Quad>& home, const std::map<int, sim::Pose>& poses, const std::map<int, RigidBody>& bodies) {
    MotionWriter out;
    out.count(home.size());
    for (const Quad& q : home) out.numbers(std::array{q.x, q.y, q.z, q.w});
    out.count(poses.size());
    for (const auto& [phase, pose] : poses) {
        out.count(std::uint64_t(phase));
        for (const float3& v : {pose.x, pose.y, pose.z, pose.origin}) out.numbers(std::array{v.x, v.y, v.z});
    }
    out.count(bodies.size());
    for (const auto& [phase, body] : bodies) {
        out.count(std::uint64_t(phase));
        out.numbers(body.numbers());
    }
    return out.bytes;
}
inline void load_motion(const std::vector<char>& bytes, std::vector<Quad>& home, std::map<int, sim::Pose>& poses,
    std::map<int, RigidBody>& bodies) {
    MotionReader in(bytes);
    home.clear();
    for (std::size_t n = in.count(4 * sizeof(float)); n > 0; --n) {
        const auto q = in.numbers<float, 4>(false);  // of particles that are in no body, too
        home.push_back({q[0], q[1], q[2], q[3]});
    }
    poses.clear();
    for (std::size_t n = in.count(8 + 12 * sizeof(float)); n > 0; --n) {
        const int phase = in.phase();
        const auto p = in.numbers<float, 12>();
        const auto axis = [&](std::size_t k) { return float3{p[k], p[k + 1], p[k + 2]}; };
        poses.insert_or_assign(phase, sim::Pose{axis(0), axis(3), axis(6), axis(9)});
    }
    bodies.clear();
    for (std::size_t n = in.count(8 + RigidBody::n_numbers * sizeof(double)); n > 0; --n) {
        const int phase = in.phase();
        const RigidBody body(in.numbers<double, RigidBody::n_numbers>());
        if (!(body.mass() > 0)) throw Refused("checkpoint: expected bodies of a mass above 0, got another");
        bodies.insert_or_assign(phase, body);
    }
    in.end();
}

}  // namespace globule::core
