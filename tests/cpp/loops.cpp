// A lack of memory inside a loop of threads is thrown by the loop; it does not end the process.
#include <doctest.h>

#include <new>

#include "exec/cpu.hpp"

namespace core = globule::core;

namespace {

struct RunsOut {
    void operator()(std::size_t i) const {
        if (i == 700) throw std::bad_alloc();
    }
};
struct TileRunsOut {
    template <class Group>
    struct Scratch {};
    template <class Group>
    void operator()(Group&, Scratch<Group>&, std::size_t i) const {
        RunsOut{}(i);
    }
};
struct ScratchRunsOut : TileRunsOut {
    template <class Group>
    struct Scratch : TileRunsOut::Scratch<Group> {
        Scratch() { throw std::bad_alloc(); }
    };
};

}  // namespace

TEST_CASE("loops throw what their items throw") {
    core::Cpu cpu(core::kHost, 0, nullptr);
    CHECK_THROWS_AS(cpu.for_each_uneven(1000, RunsOut{}), std::bad_alloc);
    CHECK_THROWS_AS(cpu.for_each_task(1000, RunsOut{}), std::bad_alloc);
    CHECK_THROWS_AS(cpu.for_each_tile(1000, TileRunsOut{}), std::bad_alloc);
    CHECK_THROWS_AS(cpu.for_each_tile(1, ScratchRunsOut{}), std::bad_alloc);
    CHECK_NOTHROW(cpu.for_each_task(700, RunsOut{}));
}
