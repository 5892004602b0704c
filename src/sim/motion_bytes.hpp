// What moves boundaries and rigid bodies, as bytes of a checkpoint.
#pragma once
#include <cmath>
#include <cstring>
#include <map>
#include <stdexcept>
#include <vector>

#include "backends/status.hpp"
#include "sim/rigid_body.hpp"

namespace globule::core {

namespace motion_bytes {

template <class T>
void put(std::vector<char>& out, const T* items, std::size_t n) {
    static_assert(std::is_trivially_copyable_v<T>);
    const std::uint64_t count = n;
    const char* head = reinterpret_cast<const char*>(&count);
    out.insert(out.end(), head, head + sizeof count);
    const char* data = reinterpret_cast<const char*>(items);
    out.insert(out.end(), data, data + n * sizeof(T));
}
template <class T>
std::vector<T> take(const std::vector<char>& in, std::size_t& at, const T& blank) {
    std::uint64_t n = 0;
    const auto bytes = [&](void* to, std::size_t size) {
        if (in.size() - at < size) throw Refused("checkpoint: expected all of the bodies that move, got a part");
        if (size > 0) std::memcpy(to, in.data() + at, size);
        at += size;
    };
    bytes(&n, sizeof n);
    if (n > in.size() / sizeof(T)) throw Refused("checkpoint: expected all of the bodies that move, got a part");
    std::vector<T> items(n, blank);
    bytes(items.data(), n * sizeof(T));
    return items;
}
template <class T>
void put_map(std::vector<char>& out, const std::map<int, T>& map) {
    std::vector<int> keys;
    std::vector<T> values;
    for (const auto& [key, value] : map) {
        keys.push_back(key);
        values.push_back(value);
    }
    put(out, keys.data(), keys.size());
    put(out, values.data(), values.size());
}
template <class T>
void take_map(const std::vector<char>& in, std::size_t& at, std::map<int, T>& map, const T& blank) {
    const std::vector<int> keys = take<int>(in, at, 0);
    const std::vector<T> values = take<T>(in, at, blank);
    if (keys.size() != values.size()) throw Refused("checkpoint: expected as many bodies as names of them");
    map.clear();
    for (std::size_t k = 0; k < keys.size(); ++k) map.insert_or_assign(keys[k], values[k]);
}

/// Refuses a phase that there cannot be, and numbers that are not finite in what consists of them alone.
template <class Number, class T>
void check(int phase, const T& item) {
    static_assert(sizeof(T) % sizeof(Number) == 0 && std::is_trivially_copyable_v<T>);
    Number numbers[sizeof(T) / sizeof(Number)];
    std::memcpy(numbers, &item, sizeof item);
    bool good = phase >= 0 && phase < sim::kMaxPhases;
    for (Number x : numbers) good &= std::isfinite(x);
    if (!good) throw Refused("checkpoint: expected phases and finite numbers of the bodies that move, got others");
}

}  // namespace motion_bytes

inline std::vector<char> save_motion(const std::vector<Quad>& home, const std::map<int, sim::Pose>& poses, const std::map<int, RigidBody>& bodies) {
    std::vector<char> out;
    motion_bytes::put(out, home.data(), home.size());
    motion_bytes::put_map(out, poses);
    motion_bytes::put_map(out, bodies);
    return out;
}
inline void load_motion(const std::vector<char>& in, std::vector<Quad>& home, std::map<int, sim::Pose>& poses, std::map<int, RigidBody>& bodies) {
    std::size_t at = 0;
    home = motion_bytes::take<Quad>(in, at, {});
    motion_bytes::take_map(in, at, poses, {});
    motion_bytes::take_map(in, at, bodies, RigidBody(1.0, {}, {}));
    for (const auto& [phase, pose] : poses) motion_bytes::check<float>(phase, pose);
    for (const auto& [phase, body] : bodies) {
        motion_bytes::check<double>(phase, body);
        if (!(body.mass() > 0)) throw Refused("checkpoint: expected bodies of a mass above 0, got another");
    }
    if (at != in.size()) throw Refused("checkpoint: expected the end of the bodies that move, got more");
}

}  // namespace globule::core
