// Walks on the CPU.  Items of a wave that stand at the same place go through it side by side in the SIMD
// lanes: a chunk of them goes on to where each next has work, then place by place.
#pragma once
#include <memory>

#include "globule/exec/cpu_packet.hpp"

namespace globule {

template <class Walk>
class CpuWalks {
public:
    static constexpr std::uint32_t chunk = 4096;  ///< items; their states and the places they meet stay in the cache

    void operator()(const Walk& walk, std::size_t first, std::size_t last) {
        std::uint32_t n_on = 0;
        for (std::size_t i = first; i < last; ++i) {
            states_[n_on] = {};
            if (walk.begin(i, states_[n_on])) on_[n_on] = n_on, ++n_on;
        }
        while (n_on) {
            std::uint32_t kept = 0;
            n_places_ = 0;
            for (std::uint32_t k = 0; k < n_on; ++k) {
                const std::uint32_t r = on_[k];
                std::uint32_t place;
                if (!walk.to_place(states_[r], place, at_[r], along_[r])) {
                    walk.end(states_[r]);
                    continue;
                }
                on_[kept++] = r;
                join(r, place);
            }
            n_on = kept;
            for (std::uint32_t p = 0; p < n_places_; ++p) {
                slots_[places_[p].slot] = 0;
                for (std::uint32_t r = places_[p].last; r != none;) {
                    std::uint32_t which[CpuPacket::width];
                    int n = 0;
                    for (; n < CpuPacket::width && r != none; r = before_[r]) which[n++] = r;
                    for (int k = n; k < CpuPacket::width; ++k) which[k] = which[n - 1];
                    walk.template pass<CpuPacket>(states_.get(), at_, along_, which, n);
                }
            }
        }
    }

private:
    static constexpr std::uint32_t n_slots = 2 * chunk, none = ~0u;
    struct Place {
        std::uint32_t number, slot, last;  ///< its slot in the table, the item that came last
    };
    void join(std::uint32_t r, std::uint32_t number) {
        std::uint32_t slot = number * 2654435761u >> 8;
        for (;; ++slot) {
            slot %= n_slots;
            if (slots_[slot] == 0) {
                places_[n_places_] = {number, slot, none};
                slots_[slot] = ++n_places_;
            }
            Place& place = places_[slots_[slot] - 1];
            if (place.number != number) continue;
            before_[r] = place.last;
            place.last = r;
            return;
        }
    }

    std::unique_ptr<typename Walk::State[]> states_ = std::make_unique<typename Walk::State[]>(chunk);
    Quad at_[chunk], along_[chunk];
    std::uint32_t on_[chunk], before_[chunk];  ///< the item before at the same place
    std::uint32_t n_places_ = 0;
    Place places_[chunk];
    std::uint32_t slots_[n_slots] = {};        ///< number of a place, from 1 on
};

}  // namespace globule
