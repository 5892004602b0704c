#pragma once
#include <doctest.h>
#include <globule/globule.hpp>

#include <string>
#include <vector>

/// A cube of side^3 particles, flat (N, 3), 0.1 apart.
inline std::vector<float> cube(int side) {
    std::vector<float> p;
    for (int x = 0; x < side; ++x)
        for (int y = 0; y < side; ++y)
            for (int z = 0; z < side; ++z)
                for (const int c : {x, y, z}) p.push_back(0.1f * float(c));
    return p;
}
inline const globule::SceneOptions on_cpu{.device = "cpu"};

/// The error that a call throws, or none.
template <class Call> std::string error_of(const Call& call, globule::ErrorCode code = globule::ErrorCode::invalid) {
    try {
        call();
    } catch (const globule::Error& e) {
        CHECK(int(e.code()) == int(code));
        return e.what();
    }
    FAIL("expected an error");
    return "";
}
#define CHECK_SAYS(call, ...) CHECK(error_of([&] { (void)(call); }).starts_with(__VA_ARGS__))
