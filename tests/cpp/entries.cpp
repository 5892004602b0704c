// No exception crosses the border of a backend library: each becomes a code and a message.
#include <doctest.h>

#include <string>

#include "backends/entry.hpp"

namespace core = globule::core;

namespace {

struct Thrower : core::Object {
    int begun = 0, invalidated = 0;
    void begin() override { ++begun; }
    void invalidate() noexcept override { ++invalidated; }
    int device() const noexcept override { return 3; }

    virtual int go(int what) {
        if (what == 1) throw core::Cancelled{};
        if (what == 2) throw core::Refused("two");
        if (what == 3) throw core::Stale("three");
        if (what == 4) throw std::bad_alloc();
        if (what == 5) throw std::runtime_error("five");
        if (what == 6) throw 6;
        if (what == 7) throw core::DeviceFailure("seven");
        return 10 * what;
    }
};

int device = 0;
struct Scope {
    explicit Scope(int d) : before(device) { device = d; }
    ~Scope() { device = before; }
    int before;
};

}  // namespace

TEST_CASE("what a method throws comes back as a code") {
    static_assert(noexcept(core::run<Scope>(std::declval<core::Object&>(), nullptr, nullptr)));
    const struct {
        int what;
        core::Code code;
        std::string message;
        bool invalidates;
    } cases[] = {{0, core::Code::ok, "", false}, {1, core::Code::cancelled, "interrupted", true},
        {2, core::Code::refused, "two", false}, {3, core::Code::stale, "three", false},
        {4, core::Code::memory, "out of memory", true}, {5, core::Code::failed, "five", true},
        {6, core::Code::failed, "", true}, {7, core::Code::device, "seven", true}};
    for (const auto& c : cases) {
        Thrower object;
        int result = -1;
        auto method = [&] { result = object.go(c.what); };
        const core::Status status =
            core::run<Scope>(object, [](void* context) { (*static_cast<decltype(method)*>(context))(); }, &method);
        CHECK(status.code == c.code);
        CHECK(status.message == c.message);
        CHECK(object.begun == 1);
        CHECK(object.invalidated == c.invalidates);
        CHECK(result == (c.what ? -1 : 0));
        CHECK(device == 0);
    }
}
