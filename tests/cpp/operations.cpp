// Rigid bodies, sinks and sources, checkpoints; tissue that is held, pushed and cut, alone and in a simulation.
#include <algorithm>
#include <array>
#include <cmath>

#include "helpers.hpp"

using namespace globule;

namespace {

constexpr double kSpacing = 0.1;
const SimulationSettings in_a_box{.spacing = kSpacing, .domain = {{0, 0, 0}, {2, 2, 2}}};

std::vector<float> block(int x, int y, int z, std::array<double, 3> low = {0.55, 0.55, 0.55}) {
    std::vector<float> p;
    for (int i = 0; i < x; ++i)
        for (int j = 0; j < y; ++j)
            for (int k = 0; k < z; ++k)
                for (const double c : {low[0] + kSpacing * i, low[1] + kSpacing * j, low[2] + kSpacing * k})
                    p.push_back(float(c));
    return p;
}

/// A lattice with bonds to its 6 nearest neighbors; the first layer along x is fixed.
struct Block {
    std::vector<float> positions, inverse_mass, length, stiffness, bound;
    std::vector<std::uint32_t> ids, other;
    std::vector<std::uint8_t> hold;
    std::vector<std::uint64_t> offsets{0};

    explicit Block(int x, int y = 4, int z = 4) : positions(block(x, y, z)) {
        const int step[3] = {y * z, z, 1}, side[3] = {x, y, z};
        for (int t = 0; t < x * y * z; ++t) {
            for (int a = 0; a < 3; ++a)
                for (const int s : {-1, 1})
                    if (const int at = t / step[a] % side[a] + s; at >= 0 && at < side[a])
                        other.push_back(std::uint32_t(t + s * step[a]));
            offsets.push_back(other.size());
            hold.push_back(t < y * z);
            inverse_mass.push_back(t < y * z ? 0.0f : 1.0f);
        }
        length.assign(other.size(), float(kSpacing));
        stiffness.assign(other.size(), 400.0f);
        bound.assign(hold.size(), 2.5f);
    }
    TissueBody body() const {
        TissueBody b{.positions = positions,
            .inverse_mass = inverse_mass,
            .hold = hold,
            .offsets = offsets,
            .other = other,
            .length = length,
            .stiffness = stiffness,
            .bound = bound,
            .contact = kSpacing};
        if (!ids.empty()) b.ids = ids;
        return b;
    }
};
Tissue alone(const Block& block) {
    Tissue t({.device = "cpu"});
    t.add(block.body());
    t.set_materials({{.damping = 20}});
    return t;
}
/// A square that stands at x, larger than the tissue.
std::vector<std::array<double, 3>> square(double x) { return {{x, 0, 0}, {x, 9, 0}, {x, 0, 9}, {x, 9, 9}}; }
const std::vector<std::uint32_t> kTwo{0, 1, 3, 0, 3, 2};

}  // namespace

TEST_CASE("phases have names and numbers, and may come later") {
    Simulation sim(in_a_box, {.phases = {}, .device = "cpu"});
    CHECK_SAYS(sim.add(block(1, 1, 1)), "phase: expected one of , got 0");
    sim.set_phase({.name = "water"});
    sim.set_phase({.name = "oil", .density = 900});
    sim.add(block(2, 2, 2));
    sim.add(block(2, 2, 2, {1.05, 1.05, 1.05}), 1);
    sim.add(block(1, 1, 1, {1.55, 1.05, 1.05}), "oil");
    const auto phase = sim.phase();
    CHECK(std::count(phase.begin(), phase.end(), 0) == 8);
    CHECK(std::count(phase.begin(), phase.end(), 1) == 9);
    CHECK(sim.totals().mass == doctest::Approx(8 + 9 * 0.9).epsilon(1e-4));
    CHECK_SAYS(sim.set_phase({.name = "oil", .kind = PhaseKind::boundary}), "phases[\"oil\"].kind: expected that");
    CHECK_SAYS(sim.set_phase({}), "phases: expected names, got an empty one");
    CHECK_SAYS(sim.add(block(1, 1, 1), 2), "phase: expected one of water, oil, got 2");
    CHECK_SAYS(
        sim.set_phase({.name = "honey", .viscosity = 1e9}), "phases[\"honey\"].viscosity: expected a value that");
    SimulationSettings patient = in_a_box;
    patient.least_dt = 0;
    sim.configure(patient);
    sim.set_phase({.name = "honey", .viscosity = 1e9});
    patient.fine_fluids = true;
    CHECK_SAYS(sim.configure(patient), "fine_fluids: expected that of the start");
    for (int i = 3; i < 32; ++i) sim.set_phase({.name = std::to_string(i)});
    CHECK_SAYS(sim.set_phase({.name = "another"}), "phases: expected at most 32");
}

TEST_CASE("a rigid body falls and turns as it was made to") {
    Simulation sim(in_a_box, {.phases = {{"stone", PhaseKind::rigid}, {"water"}}, .device = "cpu"});
    sim.add(block(2, 2, 2, {0.95, 0.95, 1.15}), "stone");
    const std::array<double, 9> inertia{0.04, 0, 0, 0, 0.04, 0, 0, 0, 0.04};
    CHECK_SAYS(sim.make_body("water", 1, inertia, {}), "phase: expected one of kind rigid, got \"water\"");
    CHECK_SAYS(sim.make_body("stone", 0, inertia, {}), "mass: expected a positive number");
    CHECK_SAYS(sim.make_body("stone", 1, {}, {}), "inertia: expected a positive determinant");
    CHECK_SAYS(sim.body("stone"), "phase: expected a body, got \"stone\"");
    sim.make_body("stone", 8, inertia, {.center = {1, 1, 1.2}, .velocity = {0.5, 0, 0}, .spin = {0, 0, 1}});
    for (int i = 0; i < 10; ++i) sim.step(0.01);
    const BodyMotion m = sim.body("stone");
    CHECK(m.center[0] == doctest::Approx(1.05).epsilon(1e-3));
    CHECK(m.velocity[2] == doctest::Approx(-0.981).epsilon(1e-3));
    CHECK(m.spin[2] == doctest::Approx(1).epsilon(1e-3));
    CHECK(std::atan2(m.rotation[3], m.rotation[0]) == doctest::Approx(0.1).epsilon(1e-3));
    CHECK(sim.positions()[2] < 1.15f);
    CHECK(sim.layers().size() == 1);
}

TEST_CASE("sinks take fluid out, emitted fluid comes in at the end of a step") {
    Simulation sim({.spacing = kSpacing, .domain = in_a_box.domain, .gravity = {0, 0, 0}}, {.device = "cpu"});
    sim.add(block(3, 3, 3));
    CHECK(sim.emit(block(1, 2, 2, {1.5, 1, 1}), 0, {1, 0, 0}) == 27);
    CHECK(sim.size() == 27);
    sim.set_inlets({{.center = {1.4, 1.05, 1.05}, .direction = {1, 0, 0}, .radius = 0.3, .length = 0.3}});
    CHECK(sim.step(0.001).n == 31);
    CHECK(sim.velocities()[3 * 27] == 1.0f);
    sim.step(0.001);
    CHECK(sim.velocities()[3 * 27] == 1.0f);  // it keeps it within the inlet
    sim.set_sinks({{.box = {{1.3, 0, 0}, {2, 2, 2}}}, {.center = {0.55, 0.55, 0.55}, .radius = 0.05}});
    CHECK(sim.step(0.001).n_removed == 5);
    CHECK(sim.size() == 26);
    CHECK(sim.next_id() == 31);
    CHECK_SAYS(sim.set_sinks({{.radius = -1}}), "radius: expected a number >= 0");
    CHECK_SAYS(sim.set_sinks(std::vector<Sink>(33)), "sinks: expected at most 32");
}

TEST_CASE("a boundary goes where it is led") {
    Simulation sim(in_a_box, {.phases = {{"plate", PhaseKind::boundary}}, .device = "cpu"});
    sim.add(block(3, 3, 1));
    const auto at = [](double x) { return Matrix4{1, 0, 0, x, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}; };
    CHECK_SAYS(sim.move_to("plate", at(0)), "phase: expected one that capture() knows, got \"plate\"");
    sim.capture("plate", at(0));
    CHECK_SAYS(sim.move_to("plate", at(NAN)), "next: expected a finite number");
    sim.move_to("plate", at(0.02));
    sim.step(0.01);
    CHECK(sim.positions()[0] == doctest::Approx(0.57));
    CHECK(sim.velocities()[0] == doctest::Approx(2));
}

TEST_CASE("forces, lists and densities are in the solver's order") {
    Simulation sim({.spacing = kSpacing, .domain = in_a_box.domain, .gravity = {0, 0, 0}}, {.device = "cpu"});
    sim.add(block(4, 4, 4));
    std::vector<std::uint32_t> ids(64), rows;
    sim.read("id", ids);
    std::vector<float> forces(3 * 64), density(64), vorticity(3 * 64);
    Neighbors near;
    sim.neighbors(rows, near);
    CHECK(rows.size() == 64);
    CHECK(near.offsets.size() == 65);
    CHECK(near.indices.size() == near.offsets[64]);
    sim.flow(density, vorticity);
    CHECK(*std::max_element(density.begin(), density.end()) == doctest::Approx(1).epsilon(0.1));
    for (std::size_t i = 0; i < 64; ++i) forces[3 * i] = ids[i] == 63 ? 1 : 0;
    CHECK_SAYS(sim.set_forces(density), "forces: expected 192 numbers, got (64,)");
    sim.set_forces(forces);
    sim.step(0.001);
    const auto v = sim.velocities();
    CHECK(v[3 * 63] > 0.9f * 0.001f);
    CHECK_SAYS(sim.read("color", density), "name: expected that of an array of the state, got \"color\"");
    CHECK_SAYS(sim.read("id", density), "id: expected uint32 in host memory, got float32");
}

TEST_CASE("a run tells of its steps, and ends when asked to") {
    Simulation sim(in_a_box, {.walls = true, .device = "cpu"});
    sim.add(block(4, 4, 4));
    int n = 0;
    CHECK(sim.run(1,
                 [&](const StepReport& r) {
                     CHECK(r.step == std::uint64_t(++n));
                     return n < 3;
                 })
              ->step == 3);
    CHECK(sim.n_steps() == 3);
    error_of([&] { sim.run(1, [&](const StepReport&) { return sim.cancel(), true; }); }, ErrorCode::cancelled);
    CHECK(sim.n_steps() == 4);
}

TEST_CASE("a checkpoint goes on with the same bits") {
    const SimulationOptions options{.phases = {{"water"}, {"stone", PhaseKind::rigid}}, .walls = true, .device = "cpu"};
    Simulation a(in_a_box, options);
    a.add(block(5, 5, 5));
    a.add(block(2, 2, 2, {0.75, 0.75, 1.25}), "stone");
    a.make_body("stone", 4, {0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1}, {.center = {0.8, 0.8, 1.3}});
    a.run(0.05);
    Simulation b(in_a_box, options);
    b.resize(a.size(), a.next_id(), a.time(), a.n_steps());
    for (const char* name : {"place", "velocity", "pressure", "growth", "divergence_impulse"}) {
        std::vector<float> values(a.size() * (name == std::string("place") || name == std::string("velocity") ? 4 : 1));
        a.read(name, values);
        b.write(name, values);
    }
    std::vector<std::uint32_t> id(a.size());
    std::vector<std::uint8_t> phase(a.size());
    a.read("id", id), a.read("phase", phase);
    b.write("id", id), b.write("phase", phase);
    CHECK_SAYS(b.write("phase", std::vector<std::uint8_t>(a.size(), 3)), "phase: expected numbers below 3, got 3");
    CHECK_SAYS(b.write("id", std::vector<std::uint32_t>(a.size(), a.next_id())), "id: expected numbers below");
    b.settle();
    b.set_motion(a.motion());
    const double dt = a.next_dt();
    CHECK(b.next_dt() == dt);
    for (int i = 0; i < 3; ++i) a.step(dt), b.step(dt);
    CHECK(a.positions() == b.positions());
    CHECK(a.body("stone").center == b.body("stone").center);
    CHECK_SAYS(b.set_motion({1, 2, 3}), "checkpoint: expected");
}

TEST_CASE("tissue hangs from what is fixed, and falls where it is cut") {
    const Block block(8);
    Tissue t = alone(block);
    CHECK(t.size() == 128);
    CHECK(t.n_bonds() == block.other.size() / 2);
    CHECK(t.n_pieces() == 1);
    CHECK(t.substeps(0.01) >= 1);
    for (int i = 0; i < 20; ++i) CHECK(t.advance(0.01, {0, 0, -1}) == t.substeps(0.01));
    CHECK(t.elastic_energy() > 0);
    const std::vector<std::array<double, 3>> blade = square(0.9);
    CHECK(t.cut({blade, kTwo}) == 16);
    CHECK(t.cut({blade, kTwo}) == 0);
    CHECK(t.n_pieces() == 2);
    std::vector<std::uint32_t> piece(128), ids(128);
    std::vector<std::uint8_t> hold(128);
    t.get({}, {}, piece, hold, ids);
    CHECK(piece[0] == 0);
    CHECK(piece[127] == 64);
    CHECK(hold[15] == 1);
    CHECK(hold[16] == 0);
    CHECK(ids[127] == 127);
    const float before = t.positions()[3 * 127 + 2];
    for (int i = 0; i < 20; ++i) t.advance(0.01, {0, 0, -1});
    CHECK(t.positions()[3 * 127 + 2] < before - 0.005f);
    CHECK(t.remove({.a = {1.05, 0.6, 0.6}, .radius = 9}) == 112);  // fixed particles stay
    CHECK(t.n_bonds() == 24);
}

TEST_CASE("a grasp feels what it holds, a shape what it pushes") {
    Tissue t = alone(Block(6));
    t.grasp({1.05, 0.7, 0.7}, 0.05 + 0.25);
    t.set_instruments({{.velocity = {0.1, 0, 0}}});
    for (int i = 0; i < 10; ++i) t.advance(0.01);
    t.set_instruments({}, {{.kind = TissueShape::half_space, .a = {0, 0, 0.6}, .b = {0, 0, 1}}});
    t.advance(0.01);
    const auto felt = t.felt();
    CHECK(felt.size() == 9 * 6);
    CHECK(felt[0] < -1);         // it pulls, and is pulled back
    CHECK(felt[8 * 6 + 2] < 0);  // what it lifts weighs on it
    t.grasp({0, 0, 0}, 0);       // lets go
    std::vector<std::uint8_t> hold(t.size());
    t.get({}, {}, {}, hold);
    CHECK(*std::max_element(hold.begin(), hold.end()) == 1);
    CHECK_SAYS(t.grasp({0, 0, 0}, 1, 8), "number: expected 0 to 7, got 8");
    CHECK_SAYS(t.set_instruments({}, std::vector<TissueShape>(9)), "shapes: expected at most 8, got 9");
}

TEST_CASE("accelerations, velocities and positions can be given") {
    Tissue t = alone(Block(3));
    std::vector<float> each(3 * 48, 0.0f), velocities(3 * 48);
    t.accelerate(each);
    each[3 * 47] = 1;
    t.set({}, each);
    t.get({}, velocities);
    CHECK(velocities == each);
    CHECK_SAYS(t.set(std::vector<float>(3)), "positions: expected 144 numbers, got (3,)");
    CHECK_SAYS(t.advance(0), "dt: expected a positive number");
}

TEST_CASE("bonds that are none are refused") {
    Block block(2);
    Tissue t({.device = "cpu"});
    const auto with = [&](auto& values, auto value) {
        const auto old = std::exchange(values[3], value);
        const std::string said = error_of([&] { t.add(block.body()); });
        values[3] = old;
        return said;
    };
    CHECK(with(block.other, 32u) == "other: expected another particle of 32, got 32");
    CHECK(with(block.other, 0u).starts_with("other: expected "));
    CHECK(with(block.other, 20u) == "other: expected every bond at both of its ends, got one at one end");
    CHECK(with(block.offsets, std::uint64_t(1) << 40).starts_with("offsets: expected numbers that begin at 0"));
    CHECK(with(block.positions, NAN).starts_with("positions: expected a finite number"));
    TissueBody body = block.body();
    body.bound = {};
    CHECK_SAYS(t.add(body), "bound: expected 32 numbers, got none");
    CHECK_SAYS(t.cut({square(1), std::vector<std::uint32_t>{0, 1, 4}}), "triangles: expected vertices below 4");
    CHECK(t.size() == 0);
}

TEST_CASE("arrays of a tissue's state go into another") {
    Tissue a = alone(Block(4));
    a.cut({square(0.7), kTwo});
    for (int i = 0; i < 5; ++i) a.advance(0.01, {0, 0, -1});
    a.set_vessel(2, {.speed = 0.1f, .pool = 1e-3, .phase = 0});
    CHECK(a.vessels().size() == 2);
    CHECK(a.vessels()[1].pool == 1e-3);
    Tissue b({.device = "cpu"});
    for (const auto& [name, bytes] : a.arrays()) {
        const auto values = a.read(name);
        CHECK(values.size() == bytes);
        b.write(name, values);
    }
    b.set_materials({{.damping = 20}});
    CHECK(b.n_bonds() == a.n_bonds());
    a.advance(0.01, {0, 0, -1}), b.advance(0.01, {0, 0, -1});
    CHECK(a.positions() == b.positions());
    CHECK_SAYS(a.read("shoe"), "tissue: expected the name of one of its arrays, got shoe");
}

TEST_CASE("tissue in a simulation has its gate, its particles and layers of its own") {
    Simulation sim(in_a_box,
        {.phases = {{"liver", PhaseKind::tissue}, {"water"}, {"plate", PhaseKind::boundary}}, .device = "cpu"});
    Block block(6);
    for (std::uint32_t i = 0; i < 96; ++i) block.ids.push_back(i);
    sim.add(block.positions, "liver");
    sim.add(::block(3, 3, 3, {0.65, 0.55, 1.05}), "water");
    Tissue t = sim.tissue();
    CHECK(t.size() == 0);
    t.add(block.body());
    for (int i = 0; i < 5; ++i) sim.step(0.002);
    CHECK(t.elastic_energy() > 0);
    CHECK(t.cut({square(0.9), kTwo}) > 0);
    CHECK(t.n_pieces() == 2);
    const std::vector<Layer> layers = sim.layers();
    CHECK(layers.size() == 2);  // the plate is not shown
    const Camera camera{.eye = {0.8, -3, 0.9}, .look_at = {0.8, 0.7, 0.9}, .up = {0, 0, 1}};
    const auto seen = render(layers, camera, 64, 48).layer();
    CHECK(std::count(seen.begin(), seen.end(), 0) > 50);
    CHECK(std::count(seen.begin(), seen.end(), 1) > 10);
    const auto image = [&](const std::vector<Layer>& of) { return render(of, camera, 64, 48).distance(); };
    const auto before = image(layers);
    const std::vector<Layer> still = sim.snapshot();
    for (int i = 0; i < 3; ++i) sim.step(0.002);
    CHECK(image(still) == before);
    CHECK(image(layers) != before);
    CHECK(image(sim.snapshot({}, still)) == image(layers));
    CHECK_THROWS_AS(sim.snapshot({}, layers), Error);
    CHECK_THROWS_AS(sim.snapshot("nowhere"), Error);
    Scene shown = still[0].scene;
    CHECK_THROWS_AS(shown.update({.positions = block.positions}), Error);
    sim.draw(Drawn::balls);
    CHECK(layers[0].scene.render(camera, 64, 48).mask().size() == 64 * 48);
    sim = {};
    CHECK(t.n_pieces() == 2);  // it keeps its simulation
}
