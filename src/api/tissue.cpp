#include "globule/tissue.hpp"

#include <algorithm>
#include <numeric>

#include "api/impl.hpp"

namespace globule {
namespace {

core::tissue::Shape packed(const TissueShape& s) {
    if (int(s.kind) < 0 || s.kind > TissueShape::half_space)
        refuse("kind", "ball, capsule or half_space", std::to_string(int(s.kind)));
    return {core::tissue::Shape::Kind(s.kind), three("a", s.a), three("b", s.b), number("radius", s.radius),
        three("velocity", s.velocity), number("friction", s.friction, 0)};
}

std::uint64_t mixed(std::uint64_t k) {
    k = (k ^ k >> 31) * 0x9e3779b97f4a7c15ull;
    return (k ^ k >> 29) * 0xbf58476d1ce4e5b9ull;
}
/// Throws unless each bond stands at both of its ends: a cut looks for its twin there.
void check_bonds(std::uint32_t n, const std::uint64_t* offsets, const std::uint32_t* other) {
    std::uint64_t twins = 0;
    for (std::uint64_t i = 0; i < n; ++i)
        for (std::uint64_t e = offsets[i]; e < offsets[i + 1]; ++e) {
            if (other[e] >= n || other[e] == i)
                refuse("other", "another particle of " + std::to_string(n), std::to_string(other[e]));
            twins += mixed(i << 32 | other[e]) - mixed(std::uint64_t(other[e]) << 32 | i);
        }
    if (twins) throw Error(ErrorCode::invalid, "other: expected every bond at both of its ends, got one at one end");
}

template <class T> const T* needed(const char* name, const ArrayView& view, std::size_t n) {
    const T* data = on_host<T>(name, view, n);
    if (!data && n) refuse(name, std::to_string(n) + " numbers", "none");
    return data;
}
template <class T> const T* or_zeros(const char* name, const ArrayView& view, std::vector<T>& room, std::size_t n) {
    if (view.given()) return needed<T>(name, view, n);
    room.resize(n);
    return room.data();
}

}  // namespace

Tissue Inside::tissue(core::Handle<core::Tissue> core) {
    Tissue t;
    t.impl_ = std::make_shared<Tissue::Impl>(Tissue::Impl{std::move(core)});
    return t;
}

Tissue::Tissue(const TissueOptions& o) {
    const int threads = whole("threads", o.threads, 0, 4096);
    const Chosen chosen = choose(o.device);
    *this = Inside::tissue(core::make_tissue(*chosen.backend, chosen.index, threads, o.poll));
}

void Tissue::add(const TissueBody& b) {
    const Impl& s = Inside::of(*this, "tissue");
    const std::size_t n = rows_of("positions", b.positions, 3);
    if (n >= 0x7fffffff) refuse("positions", "fewer than 2^31 particles", std::to_string(n));
    std::vector<std::uint32_t> ids;
    std::vector<std::uint8_t> hold, phase;
    core::TissueArrays a{};
    a.n = std::uint32_t(n);
    a.ids = or_zeros("ids", b.ids, ids, n);
    std::iota(ids.begin(), ids.end(), 0u);
    a.positions = needed<float>("positions", b.positions, 3 * n);
    a.inverse_mass = needed<float>("inverse_mass", b.inverse_mass, n);
    a.bound = needed<float>("bound", b.bound, n);
    a.hold = or_zeros("hold", b.hold, hold, n);
    a.phase = or_zeros("phase", b.phase, phase, n);
    for (std::size_t i = 0; i < n; ++i)
        if (a.phase[i] >= core::tissue::kMaxPhases)
            refuse("phase", "numbers below " + std::to_string(core::tissue::kMaxPhases), std::to_string(a.phase[i]));
    check_range("positions", {a.positions}, n, 3, -kInfinity, kInfinity);
    check_range("inverse_mass", {a.inverse_mass}, n, 1, 0, kInfinity);
    a.offsets = needed<std::uint64_t>("offsets", b.offsets, n + 1);
    if (a.offsets[0] != 0 || !std::is_sorted(a.offsets, a.offsets + n + 1))
        throw Error(ErrorCode::invalid, "offsets: expected numbers that begin at 0 and never fall, got others");
    const std::size_t n_bonds = a.offsets[n];
    a.other = needed<std::uint32_t>("other", b.other, n_bonds);
    a.length = needed<float>("length", b.length, n_bonds);
    a.stiffness = needed<float>("stiffness", b.stiffness, n_bonds);
    check_bonds(a.n, a.offsets, a.other);
    a.contact = float(positive("contact", b.contact));
    if (b.lame.given()) {
        a.lame = needed<float>("lame", b.lame, 2 * n);
        a.frequency = number("frequency", b.frequency, 0);
        a.n_terms = std::uint32_t(b.relaxation.given() ? rows_of("relaxation", b.relaxation, 2) : 0);
        if (a.n_terms > 2) refuse("relaxation", "at most two terms", std::to_string(a.n_terms));
        a.relaxation = on_host<float>("relaxation", b.relaxation, 2 * a.n_terms);
    }
    s.core.call<&core::Tissue::add>(a);
}

void Tissue::set_materials(const std::vector<TissueMaterial>& by_phase) {
    const Impl& s = Inside::of(*this, "tissue");
    if (by_phase.size() > core::tissue::kMaxPhases)
        refuse("by_phase", "at most " + std::to_string(core::tissue::kMaxPhases), std::to_string(by_phase.size()));
    core::tissue::Materials m;
    for (std::size_t k = 0; k < by_phase.size(); ++k) {
        m.damping[k] = number("damping", by_phase[k].damping, 0);
        m.tear_strain[k] = number("tear", by_phase[k].tear, 0);
        m.yield_strain[k] = number("plastic", by_phase[k].plastic, 0);
        m.creep_rate[k] = number("creep", by_phase[k].creep, 0);
        m.friction[k] = number("friction", by_phase[k].friction, 0);
    }
    s.core.call<&core::Tissue::set_materials>(m);
}

void Tissue::set_instruments(const std::vector<GraspMotion>& grasps, const std::vector<TissueShape>& shapes) {
    const Impl& s = Inside::of(*this, "tissue");
    if (grasps.size() > core::tissue::kMaxGrasps) refuse("grasps", "at most 8", std::to_string(grasps.size()));
    if (shapes.size() > core::tissue::kMaxShapes) refuse("shapes", "at most 8", std::to_string(shapes.size()));
    core::tissue::Motions motions;
    for (std::size_t g = 0; g < grasps.size(); ++g) {
        motions.velocity[g] = three("velocity", grasps[g].velocity);
        motions.spin[g] = three("spin", grasps[g].spin);
        motions.center[g] = three("center", grasps[g].center);
    }
    core::tissue::Shapes all;
    for (const TissueShape& shape : shapes) all.shape[all.n++] = packed(shape);
    s.core.call<&core::Tissue::set_instruments>(motions, all);
}

int Tissue::advance(double dt, const Vec3& gravity, int substeps, int iterations) {
    const Impl& s = Inside::of(*this, "tissue");
    return s.core.call<&core::Tissue::advance>(
        core::TissueStep{float(positive("dt", dt)), whole("substeps", substeps, 0, 1'000'000),
            whole("iterations", iterations, 1, 1'000'000), three("gravity", gravity)});
}
std::uint32_t Tissue::tear(double dt) {
    return Inside::of(*this, "tissue").core.call<&core::Tissue::tear>(float(positive("dt", dt)));
}
void Tissue::follow() { Inside::of(*this, "tissue").core.call<&core::Tissue::follow>(); }
std::uint32_t Tissue::cut(const Blade& b) {
    const Impl& s = Inside::of(*this, "tissue");
    const std::size_t n = rows_of("vertices", b.vertices, 3), m = rows_of("triangles", b.triangles, 3);
    const double* vertices = needed<double>("vertices", b.vertices, 3 * n);
    const std::uint32_t* corners = needed<std::uint32_t>("triangles", b.triangles, 3 * m);
    if (n > 0x7fffffff || m > 0x7fffffff) refuse("triangles", "fewer than 2^31", std::to_string(m));
    if (m && *std::max_element(corners, corners + 3 * m) >= n)
        refuse("triangles", "vertices below " + std::to_string(n), "others");
    return s.core.call<&core::Tissue::cut>(core::BladeSweep{
        vertices, std::uint32_t(n), std::min(b.n_moving, std::uint32_t(n)), corners, std::uint32_t(m)});
}
void Tissue::grasp(const Vec3& center, double radius, int which) {
    Inside::of(*this, "tissue")
        .core.call<&core::Tissue::grasp>(three("center", center), number("radius", radius), which);
}
std::uint32_t Tissue::remove(const TissueShape& region) {
    return Inside::of(*this, "tissue").core.call<&core::Tissue::remove>(packed(region));
}

std::size_t Tissue::size() const { return Inside::of(*this, "tissue").core.call<&core::Tissue::n>(); }
std::uint32_t Tissue::n_bonds() const { return Inside::of(*this, "tissue").core.call<&core::Tissue::n_bonds>(); }
std::uint32_t Tissue::n_pieces() const { return Inside::of(*this, "tissue").core.call<&core::Tissue::pieces>(); }
double Tissue::elastic_energy() const { return Inside::of(*this, "tissue").core.call<&core::Tissue::elastic_energy>(); }
int Tissue::substeps(double dt) const {
    return Inside::of(*this, "tissue").core.call<&core::Tissue::substeps>(float(dt));
}
std::vector<double> Tissue::felt() const { return Inside::of(*this, "tissue").core.call<&core::Tissue::felt>(); }
std::vector<float> Tissue::positions() const {
    std::vector<float> out(3 * size());
    get(out);
    return out;
}
void Tissue::get(const MutableArrayView& positions, const MutableArrayView& velocities, const MutableArrayView& piece,
    const MutableArrayView& hold, const MutableArrayView& ids) const {
    const Impl& s = Inside::of(*this, "tissue");
    const core::Gates inside({s.core.gate().get()});
    const std::size_t n = s.core.call_inside<&core::Tissue::n>(inside);
    s.core.call_inside<&core::Tissue::get>(inside, out_on_host<float>("positions", positions, 3 * n),
        out_on_host<float>("velocities", velocities, 3 * n), out_on_host<std::uint32_t>("piece", piece, n),
        out_on_host<std::uint8_t>("hold", hold, n), out_on_host<std::uint32_t>("ids", ids, n));
}
void Tissue::set(const ArrayView& positions, const ArrayView& velocities) {
    const Impl& s = Inside::of(*this, "tissue");
    const core::Gates inside({s.core.gate().get()});
    const std::size_t n = s.core.call_inside<&core::Tissue::n>(inside);
    s.core.call_inside<&core::Tissue::set>(
        inside, on_host<float>("positions", positions, 3 * n), on_host<float>("velocities", velocities, 3 * n));
}
void Tissue::accelerate(const ArrayView& accelerations) {
    const Impl& s = Inside::of(*this, "tissue");
    const core::Gates inside({s.core.gate().get()});
    const std::size_t n = s.core.call_inside<&core::Tissue::n>(inside);
    s.core.call_inside<&core::Tissue::accelerate>(inside, on_host<float>("accelerations", accelerations, 3 * n));
}

void Tissue::set_vessel(std::size_t number, const BloodVessel& vessel) {
    Inside::of(*this, "tissue").core.call<&core::Tissue::set_vessel>(number, vessel);
}
std::vector<BloodVessel> Tissue::vessels() const {
    return Inside::of(*this, "tissue").core.call<&core::Tissue::vessels>();
}

std::vector<std::pair<std::string, std::size_t>> Tissue::arrays() const {
    return Inside::of(*this, "tissue").core.call<&core::Tissue::arrays>();
}
std::vector<std::uint8_t> Tissue::read(const std::string& name) const {
    const Impl& s = Inside::of(*this, "tissue");
    const core::Gates inside({s.core.gate().get()});
    std::vector<std::uint8_t> out;
    for (const auto& [its, bytes] : s.core.call_inside<&core::Tissue::arrays>(inside))
        if (its == name) out.resize(bytes);
    s.core.call_inside<&core::Tissue::read>(inside, name, static_cast<void*>(out.data()));
    return out;
}
void Tissue::write(const std::string& name, const ArrayView& bytes) {
    const std::size_t n = bytes.shape().size();
    Inside::of(*this, "tissue")
        .core.call<&core::Tissue::write>(
            name, static_cast<const void*>(needed<std::uint8_t>(name.c_str(), bytes, n)), n);
}

}  // namespace globule
