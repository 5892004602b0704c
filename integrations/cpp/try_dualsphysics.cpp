// The adaptor for DualSPHysics on arrays as its solver has them: boundary first, then fluid, and a floating body in it.
#include <cmath>

#include "drop.hpp"
#include "dualsphysics.hpp"

namespace {

struct tfloat3 { float x, y, z; };
struct tdouble3 { double x, y, z; };
struct tfloat4 { float x, y, z, w; };

/// floating: every tenth particle of the fluid is a floating body's, and takes no part.
template <class Position, class Code> void draw_drop(const std::string& name, bool floating) {
    const Code fluid = sizeof(Code) == 2 ? 0x1800 : 0x00030000, body = sizeof(Code) == 2 ? 0x1000 : 0x00020000;
    std::vector<Position> pos;
    std::vector<tfloat4> velrhop;
    std::vector<std::uint32_t> idp;
    std::vector<Code> code;
    const auto add = [&](double x, double y, double z, Code what, float speed) {
        pos.push_back({decltype(Position::x)(x), decltype(Position::x)(y), decltype(Position::x)(z)});
        velrhop.push_back({speed, 0, 0, 1000});
        idp.push_back(std::uint32_t(idp.size()));
        code.push_back(what);
    };
    for (int i = 0; i < 100; ++i) add(0.05 * i - 2.5, -0.6, 0, 0, 0);
    const std::size_t npb = pos.size();
    const auto places = drop();
    std::size_t i = 0;
    for (const auto& p : places) {
        if (floating && i % 10 == 0) add(p[0], p[1] + 1, p[2], body, 0);
        add(p[0], p[1], p[2], fluid, float(i++) / float(places.size()));
    }
    add(0, 5, 0, Code(fluid | (sizeof(Code) == 2 ? 0x2000u : 0x20000000u)), 9);  // a periodic copy

    globule::adaptors::DualSPHysics<Position, tfloat4, Code> adaptor;
    globule::SceneOptions options = adaptor.options(kSpacing);
    options.device = "cpu";
    globule::Scene scene(options);
    scene.update(adaptor.fluid(pos.size(), npb, pos.data(), code.data()));
    const auto ids = adaptor.ids(idp.data());
    for (std::size_t k = 1; k < ids.size(); ++k)
        if (ids[k] <= ids[k - 1]) std::printf("ids out of order\n");
    draw(name, scene, adaptor.speeds(velrhop.data()), adaptor.in_place());
}

}  // namespace

int main() {
    try {
        draw_drop<tfloat3, std::uint16_t>("dualsphysics", false);
        draw_drop<tdouble3, std::uint32_t>("dualsphysics_floating", true);
    } catch (const globule::Error& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
}
