// Passes of the fluid's solver: kernels, lists of neighbors, densities, pressures, and what limits a step.
#include "particles.hpp"
#include "sim/approach.hpp"
#include "sim/split.hpp"

namespace {

namespace sim = core::sim;
using core::Quad;
using Packet = core::CpuPacket;

/// Particles of a solver, in the order of their octree: w of each below 0 for fluid, above 0 for walls.
struct Fluid {
    float spacing;
    sim::Spline spline = sim::Spline::of(2 * spacing);
    sim::LatticeSums sums{spline, spacing};
    float volume = float(1 / sums.all);
    sim::Period period;
    Built b;
    std::size_t n, n_rows = 0;
    std::vector<Quad> place, velocity;
    std::vector<float> size;
    std::vector<std::uint32_t> rows, count, index;
    std::vector<sim::Pairs<Packet>> pairs;
    std::vector<Packet::Bases> bases;
    sim::Lists<Packet> lists;
    std::vector<float> values[8];
    sim::Rows of_rows;
    std::vector<float> pressure, change;
    sim::Progress progress{};

    Fluid(float s, const std::vector<float3>& points, const std::vector<float>& w, const sim::Period& p = {},
        const std::vector<float>& sizes = {}, std::uint32_t places = 200)
        : spacing(s), period(p), b(points, {}, std::vector<float>(points.size(), 2 * s)), n(points.size()) {
        place.assign(n + 64, {2e18f, 2e18f, 2e18f, 0});
        velocity.assign(n + 64, {0, 0, 0, 0});
        size.assign(sizes.empty() ? 0 : n + 64, 1.0f);
        for (std::uint32_t i = 0; i < n; ++i) {
            const std::uint32_t from = b.sorted().index[i];
            place[i] = {points[from].x, points[from].y, points[from].z, w[from]};
            if (!sizes.empty()) size[i] = sizes[from];
            if (w[from] < 0) rows.push_back(i);
        }
        n_rows = rows.size();
        const std::size_t padded = (n_rows + 127) / 64 * 64;
        rows.resize(padded, std::uint32_t(n));
        count.resize(padded);
        index.resize(padded * places);
        pairs.resize(padded * places / Packet::width);
        bases.resize(padded);
        for (auto& v : values) v.resize(padded);
        of_rows = {values[0].data(), values[1].data(), values[2].data(), values[3].data(), values[4].data(),
            values[5].data(), values[6].data(), values[7].data()};
        lists = {n_rows, places, std::uint32_t(n), rows.data(), count.data(), index.data(), pairs.data(), bases.data()};
        pressure.resize(n + 64), change.resize(n + 64);
        if (sizes.empty()) find<false>();
        else find<true>();
    }
    sim::Sizes sizes() const { return {size.empty() ? nullptr : size.data()}; }
    template <bool mixed> void find() {
        std::uint32_t longest = 0;
        b.cpu.for_each_tile((n_rows + core::CpuGroup::width - 1) / core::CpuGroup::width,
            sim::FindLists<Packet, mixed>{
                b.tree(), {b.sorted(), spline.support, sizes()}, lists, place.data(), period, &longest});
        REQUIRE(longest <= lists.places);
        weigh<mixed>();
    }
    template <bool mixed> void weigh() {
        b.cpu.for_each_packet(n_rows, sim::Densities<Packet, true, mixed>{lists, place.data(), of_rows, spline, period,
                                          volume, float(sums.squares), nullptr, sizes()});
    }
    double apart(std::uint32_t i, std::uint32_t j) const {
        double v[3] = {
            double(place[i].x) - place[j].x, double(place[i].y) - place[j].y, double(place[i].z) - place[j].z};
        for (int k = 0; k < 3; ++k)
            if (const double l = (&period.length.x)[k]; l > 0) v[k] -= l * std::round(v[k] / l);
        return std::hypot(v[0], v[1], v[2]);
    }
    void push() {
        b.cpu.for_each_packet(
            n_rows, sim::Push<Packet>{lists, of_rows, change.data(), velocity.data(), &progress, spline.inverse});
    }
    /// The solve for velocities, from P = 0; the pressures that it leads to, by slot.
    std::vector<float> solve(float dt, double tolerance, int most, float flux) {
        std::vector<float> iterate(n_rows + 64), error(n_rows + 64), turn(n_rows + 64), pascal(n + 64);
        sim::Residuals found;
        const sim::Relax<Packet> relax{lists, of_rows, of_rows.alpha, velocity.data(), pressure.data(), change.data(),
            iterate.data(), error.data(), turn.data(), &progress, spline.inverse, 1 / dt, 0.0f, -core::infinity(),
            nullptr, 0.0f, 0.3f};
        const sim::Judge judge{&found, dt, double(n_rows), tolerance, 1e9, 1.0, 2, std::uint32_t(most), false, 1.0f,
            nullptr, 0.0, &progress};
        while (!progress.done) {
            push();
            b.cpu.for_each_packet(n_rows, relax);
            b.cpu.reduce_in_order(n_rows, sim::ResidualsOf{error.data(), turn.data(), 0, nullptr}, sim::AddResiduals{},
                sim::Residuals{}, &found, judge);
        }
        b.cpu.for_each(n_rows, sim::Applied{rows.data(), pressure.data(), change.data(), 1 / dt, flux, pascal.data()});
        return pascal;
    }
};
std::vector<float> fluid(std::size_t n, float rho = 1000) { return std::vector<float>(n, -1 / rho); }

}  // namespace

TEST_CASE("the spline's integral is 1, and its slope its derivative") {
    for (const float h : {0.02f, 1.0f, 30.0f}) {
        const sim::Spline spline = sim::Spline::of(h);
        double sum = 0;
        const int n = 4000;
        for (int i = 0; i < n; ++i) {
            const double r = h * (i + 0.5) / n;
            sum += 4 * 3.14159265358979 * r * r * spline(r) * h / n;
            double w, slope;
            spline(r, w, slope);
            if (i % 400 == 7)
                CHECK(slope * r ==
                      doctest::Approx((spline(r + 1e-5 * h) - spline(r - 1e-5 * h)) / (2e-5 * h)).epsilon(1e-3));
            CHECK(w == doctest::Approx(spline(r)));
        }
        CHECK(sum == doctest::Approx(1).epsilon(1e-5));
        CHECK(spline(1.01 * h) == 0.0);
    }
}

TEST_CASE("the kernel of a pair is that of the mean of both supports, and pushes both alike") {
    const sim::Spline spline = sim::Spline::of(0.2f), mean = sim::Spline::of(0.15f);
    for (const double r : {0.01, 0.07, 0.12}) {
        const auto large = sim::Pair<double>::of(1.0, 0.5), small = sim::Pair<double>::of(0.5, 1.0);
        double w, slope, other;
        large.kernel(spline, r, w, slope);
        CHECK(w == doctest::Approx(mean(r)).epsilon(1e-5));
        mean(r, w, other);
        CHECK(slope == doctest::Approx(other).epsilon(1e-5));
        CHECK(1.0 * large.volume == 0.125 * small.volume * 1.0);
    }
}

TEST_CASE("lists hold who is nearer than the support, also across borders where a domain repeats") {
    for (const auto& [n, length] : {std::pair{1, float3{0, 0, 0}}, {7, {0, 0, 0}}, {64, {0, 0, 0}}, {1000, {0, 0, 0}},
             {500, {1, 0, 0}}, {500, {0, 1, 0}}, {500, {0, 0, 1}}, {500, {1, 1, 1}}}) {
        Fluid f(0.09f, cloud(n, n), fluid(n), {length});
        for (std::uint32_t row = 0; row < f.n; ++row) {
            std::vector<std::uint32_t> found, right;
            for (std::uint32_t k = 0; k < f.count[row]; ++k) found.push_back(f.index[f.lists.at(row, k)]);
            for (std::uint32_t j = 0; j < f.n; ++j)
                if (j != row && f.apart(row, j) < double(f.spline.support)) right.push_back(j);
            if (!f.period.any()) CHECK(std::is_sorted(found.begin(), found.end()));
            std::sort(found.begin(), found.end());
            CHECK(found == right);
        }
    }
}

TEST_CASE("of two sizes those are neighbors that are nearer than the mean of both supports") {
    std::vector<float> sizes(600);
    for (std::size_t i = 0; i < sizes.size(); ++i) sizes[i] = i % 3 ? 0.5f : 1.0f;
    Fluid f(0.1f, cloud(600, 4), fluid(600), {}, sizes);
    for (std::uint32_t row = 0; row < 600; ++row) {
        std::uint32_t n = 0;
        for (std::uint32_t j = 0; j < 600; ++j)
            n += j != row && f.apart(row, j) < double(f.spline.support) * 0.5 * (f.size[row] + f.size[j]);
        CHECK(f.count[row] == n);
    }
}

TEST_CASE("the shorter way round, a step back into the domain, and its copies") {
    const sim::Period period{{4, 0, 0}};
    for (const float x : {-3.0f, -1.0f, 0.5f, 2.5f}) {
        const float3 v = period.shortest<true>(float3{x, x, x});
        CHECK(v.x == doctest::Approx(x - 4 * std::round(x / 4)));
        CHECK(v.y == x);
    }
    CHECK((sim::Period::wrap(5, 0, 4) == 1 && sim::Period::wrap(-1, 0, 4) == 3 && sim::Period::wrap(5, 0, 0) == 5));
    for (const auto& [length, n] : {std::pair{float3{0, 0, 0}, 1}, {{1, 0, 0}, 3}, {{1, 2, 0}, 9}, {{1, 2, 3}, 27}}) {
        int count = 0;
        sim::Period{length}.each_image([&](const float3&) { ++count; });
        CHECK(count == n);
    }
}

TEST_CASE("a lattice has the density of rest and no gradient inside, and a gradient outward at its faces") {
    Fluid f(0.1f, lattice(9, 0.1f), fluid(729));
    for (std::uint32_t row = 0; row < 729; ++row) {
        const float3 from_middle = f.place[row].xyz() - float3{0.4f, 0.4f, 0.4f},
                     g{f.of_rows.gx[row], f.of_rows.gy[row], f.of_rows.gz[row]};
        const float most = std::max({std::abs(from_middle.x), std::abs(from_middle.y), std::abs(from_middle.z)});
        if (most < 0.25f) {
            CHECK(f.of_rows.density[row] == doctest::Approx(1).epsilon(1e-4));
            CHECK(core::length(g) < 2e-2f);
            CHECK(f.of_rows.bulk[row] == 1.0f);
        }
        if (most > 0.35f) {
            CHECK(f.of_rows.density[row] < 0.95f);
            CHECK(core::dot(g, from_middle) < 0);
        }
    }
}

TEST_CASE("densities are sums over all particles, of walls by their own volumes") {
    const auto points = cloud(300, 6);
    std::vector<float> w = fluid(300);
    for (std::size_t i = 0; i < 300; i += 4) w[i] = 2e-3f;
    Fluid f(0.1f, points, w);
    for (std::size_t row = 0; row < f.n_rows; ++row) {
        double sum = 0, nearest = f.spline.support;
        for (std::uint32_t j = 0; j < 300; ++j) {
            const double r = f.apart(f.rows[row], j);
            sum += (f.place[j].w > 0 ? f.place[j].w : f.volume) * f.spline(r);
            if (f.place[j].w > 0) nearest = std::min(nearest, r);
        }
        CHECK(f.of_rows.density[row] == doctest::Approx(sum).epsilon(1e-5));
        CHECK(f.of_rows.boundary[row] == doctest::Approx(nearest).epsilon(1e-5));
    }
}

TEST_CASE("what pressures push keeps its momentum, of one size or of two") {
    for (const bool mixed : {false, true}) {
        std::vector<float> sizes;
        if (mixed)
            for (int i = 0; i < 500; ++i) sizes.push_back(i % 2 ? 0.5f : 1.0f);
        std::vector<float> w = fluid(500);
        for (std::size_t i = 0; i < 500; i += 3) w[i] = -1 / 700.0f;
        Fluid f(0.12f, cloud(500, 7), w, {}, sizes);
        Random random(8);
        for (std::uint32_t i = 0; i < 500; ++i) f.change[i] = float(random(0, 1));
        f.push();
        double sum[3] = {}, all = 0;
        for (std::uint32_t i = 0; i < 500; ++i) {
            const float mass = f.sizes().volume(i) / -f.place[i].w;
            const float3 p = f.velocity[i].xyz() * mass;
            sum[0] += p.x, sum[1] += p.y, sum[2] += p.z;
            all += core::length(p);
        }
        for (const double p : sum) CHECK(std::abs(p) < 2e-4 * all);  // gradients have 16 bits
    }
}

TEST_CASE("the pressure of a column, rho g times the depth, holds its weight") {
    const float s = 0.1f, g = 9.81f, dt = 1e-3f, flux = 1.020f;  // of a cubic lattice
    Fluid f(s, lattice(12, s), fluid(12 * 12 * 12));
    std::vector<float> impulse(f.n + 64), pascal(f.n + 64);
    for (std::uint32_t i = 0; i < f.n; ++i) impulse[i] = 1000 * g * (1.2f - f.place[i].z) * dt / flux;
    f.change = impulse;
    f.push();
    const std::vector<float> none(f.n + 64);
    f.b.cpu.for_each(f.n, sim::Applied{f.rows.data(), impulse.data(), none.data(), 1 / dt, flux, pascal.data()});
    for (std::uint32_t i = 0; i < f.n; ++i) {
        CHECK(pascal[i] == doctest::Approx(1000 * g * (1.2f - f.place[i].z)));
        const float3 p = f.place[i].xyz();
        if (std::min({p.x, p.y, p.z}) < 0.15f || std::max({p.x, p.y, p.z}) > 0.95f) continue;
        CHECK(f.velocity[i].z == doctest::Approx(g * dt).epsilon(3e-3));
        CHECK(std::abs(f.velocity[i].x) < 0.1f * g * dt);
    }
}

TEST_CASE("a solve leaves velocities that compress nothing, and pressures only where they have to be") {
    Random random(10);
    std::vector<float3> points = lattice(7, 0.1f);
    for (float3& p : points) p = p + random.point(-0.02, 0.02);
    Fluid f(0.1f, points, fluid(points.size()));
    for (std::uint32_t i = 0; i < f.n; ++i) {
        const float3 in = (float3{0.3f, 0.3f, 0.3f} - f.place[i].xyz()) * 0.1f;  // all towards the middle
        f.velocity[i] = {in.x, in.y, in.z, 0};
        f.of_rows.density[i] = 1.0f;  // no gaps, which might close
    }
    const auto rate = [&](std::uint32_t i) {  // of change of the density, from all pairs
        double sum = 0;
        for (std::uint32_t j = 0; j < f.n; ++j) {
            if (i == j) continue;
            double w, slope;
            f.spline(f.apart(i, j), w, slope);
            const float3 r = f.place[i].xyz() - f.place[j].xyz(), v = f.velocity[i].xyz() - f.velocity[j].xyz();
            sum += f.volume * slope * core::dot(r, v);
        }
        return sum;
    };
    const double before = rate(0);
    const auto pressure = f.solve(1e-3f, 1e-8, 3000, 1.0f);
    int pressed = 0;
    for (std::uint32_t i = 0; i < f.n; ++i) {
        CHECK(rate(i) < 1e-3 * 0.3);  // it was 0.3 everywhere inside
        if (pressure[i] > 1.0f) CHECK(std::abs(rate(i)) < 1e-3 * 0.3);
        CHECK(pressure[i] > -1.0f);
        pressed += pressure[i] > 1.0f;
    }
    CHECK(before > 0.05);
    CHECK(pressed > 100);
}

TEST_CASE("a solve of velocities takes energy and gives none") {
    Fluid f(0.1f, lattice(8, 0.1f), fluid(512));
    Random random(9);
    for (std::uint32_t i = 0; i < 512; ++i)
        f.velocity[i] = {float(random(-1, 1)), float(random(-1, 1)), float(random(-1, 1)), 0};
    const std::vector<Quad> before = f.velocity;
    f.solve(1e-3f, 1e-6, 300, 1.0f);
    sim::Kinetic sum;
    for (std::size_t row = 0; row < f.n_rows; ++row)
        sum = sim::AddKinetic{}(sum, sim::KineticOf{f.of_rows.inverse_rho, before.data(), f.velocity.data()}(row));
    CHECK(sum.after < sum.before);
    CHECK(sum.after > 0.2 * sum.before);
    CHECK(sum.mass == doctest::Approx(512 * 1000.0));
}

TEST_CASE("a solve starts from a share of the last pressure, at a surface not from suction") {
    const std::uint32_t rows[3] = {2, 0, 1};
    const float alpha[3] = {1, 1, 0}, bulk[3] = {1, 0, 1};
    float pressure[3] = {-50, 80, -100}, change[3], iterate[3];
    for (const std::size_t row : {0, 1, 2})
        sim::WarmStart{rows, alpha, pressure, change, iterate, bulk, 0.5f, -20}(row);
    CHECK((pressure[2] == -20 && pressure[0] == 0 && pressure[1] == 0));
    CHECK((change[2] == -20 && iterate[0] == -20));
}

TEST_CASE("a solve is over when mean, largest and share are small enough, or after as many iterations as may be") {
    const auto done = [](const sim::Residuals& found, std::uint32_t before) {
        sim::Progress p{0, 0, 0, before, 0, 0, 0};
        sim::Judge{&found, 0.5, 10, 1.0, 3.0, 0.2, 2, 50, false, 1.0f, nullptr, 0, &p}(0);
        return bool(p.done);
    };
    CHECK(done({19, 5, 2, 0}, 5));
    CHECK(!done({21, 5, 2, 0}, 5));
    CHECK(!done({19, 7, 2, 0}, 5));
    CHECK(!done({19, 5, 3, 0}, 5));
    CHECK(!done({19, 5, 2, 0}, 0));
    CHECK(done({1e9, 1e9, 10, 0}, 49));
}

TEST_CASE("layers are counted by the spread of heights, shares of what is compressed between powers") {
    for (const auto& [layers, share] : {std::pair{10, 1.0}, {45, 4.0 / 9.0}, {60, 0.25}, {100, 0.25}, {300, 0.04}}) {
        sim::Compression c{}, one{};
        one.n = 1;
        for (int z = 0; z < layers; ++z) {
            one.height = z + 0.5, one.height2 = one.height * one.height;
            c = sim::AddCompression{}(c, one);
        }
        CHECK(c.layers() == doctest::Approx(layers).epsilon(0.01));
        CHECK(c.share_of_layers() == doctest::Approx(share).epsilon(0.02));
    }
    sim::Compression c{};
    c.most = 1e-3, c.n = 90, c.all = 100;
    c.over[0] = 80, c.over[1] = 40, c.over[2] = 10;
    CHECK(c.exceeded_by(0.4) == doctest::Approx(2e-5));
    CHECK(c.exceeded_by(0.2) == doctest::Approx(2e-5 * std::sqrt(2.0)));
    CHECK(c.exceeded_by(0.9) == doctest::Approx(1e-5));
}

TEST_CASE("nobody is moved apart farther than allowed, fine particles half as far") {
    const std::uint32_t rows[2] = {0, 1};
    const Quad kept[2] = {{1, 0, 0, 0}, {1, 0, 0, 0}};
    const float size[2] = {1, 0.5f};
    Quad velocity[2] = {{1, 3, 4, 7}, {1, 3, 4, 7}};
    for (const std::size_t row : {0, 1}) sim::LimitPush{rows, kept, 2.0f, {size}, velocity}(row);
    CHECK(core::length(velocity[0].xyz() - float3{1, 1.2f, 1.6f}) < 1e-6f);
    CHECK(core::length(velocity[1].xyz() - float3{1, 0.6f, 0.8f}) < 1e-6f);
    CHECK(velocity[0].w == 7);
}

TEST_CASE("a drop limits the next step by what it flies towards, not by its speed") {
    const sim::Phase phases[1];
    for (const auto& [x, v, u, limit] : {std::tuple{10.0f, 5.0f, 0.0f, 1.0f}, {0.25f, 5.0f, 0.0f, 5.0f * 0.1f / 0.15f},
             {0.25f, 5.0f, 5.0f, 1.0f}, {0.15f, 5.0f, 0.0f, 2.5f}, {0.15f, 0.5f, 0.0f, 0.5f}}) {
        Fluid f(0.1f, {{0, 0, 0}, {x, 0, 0}}, fluid(2));
        const std::uint32_t drop = f.place[0].x == 0 ? 0 : 1;
        f.velocity[drop].x = v, f.velocity[1 - drop].x = u;
        std::uint8_t phase[2] = {0, 0};
        std::uint32_t id[2] = {0, 1}, n_fast = 0, fast[2];
        float growth[2] = {}, speed2[2];
        const sim::State state{2, f.place.data(), f.velocity.data(), id, phase, nullptr, growth, nullptr};
        const sim::Ahead ahead{0.1f, 0.1f};  // 1 m/s
        for (const std::size_t i : {0, 1}) sim::OwnSpeed{state, phases, {}, ahead, speed2, &n_fast, fast}(i);
        f.b.cpu.for_each_tile(n_fast, sim::Approach{f.b.tree(), state, {}, ahead, 0.1f, fast, speed2});
        CAPTURE(x);
        CHECK(std::sqrt(speed2[drop]) == doctest::Approx(limit).epsilon(1e-3));
    }
}
