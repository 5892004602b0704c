// Tissue over any Exec: where its arrays lie, and the order of its stages.
#pragma once
#include <functional>
#include <cmath>
#include <cstring>
#include <map>

#include "exec/buffer.hpp"
#include "sim/ablate.hpp"
#include "sim/bleed.hpp"
#include "sim/pieces.hpp"
#include "sim/pressure.hpp"
#include "sim/bond_blocks.hpp"
#include "sim/felt.hpp"
#include "sim/friction.hpp"
#include "sim/solid.hpp"

namespace globule::core {

template <class Exec>
class TissueImpl : public Tissue {
public:
    explicit TissueImpl(Exec& exec)
        : exec_(exec), at_(exec), next_(exec), velocity_(exec), acceleration_(exec), pull_(exec), before_(exec), rest_(exec), id_(exec),
          slot_(exec), hold_(exec), phase_(exec), scarred_(exec), touched_(exec), first_(exec), other_(exec), length_(exec), stiffness_(exec), vessel_(exec),
          volume_(exec), wetness_(exec), lambda_(exec), label_(exec), least_id_(exec), piece_(exec), count_(exec), of_id_(exec),
          vertices_(exec), triangles_(exec), asking_(exec), found_(exec), spent_(exec), energy_(exec), strained_(exec), rest_at_(exec), rows_(exec),
          lame_(exec), terms_(exec), stays_(exec), correction_(exec), frequency_(exec), body_(exec), within_(exec), felt_(exec), felt_sum_(exec), pressed_(exec), plane_(exec), plane_speed_(exec), beside_(exec), quiet_(exec), plane_rub_(exec), rub_(exec), loads_(exec), change_(exec), rigid_loads_(exec) {}

    int device() const noexcept override { return exec_.device(); }
    Interrupt* whole() noexcept override { return &exec_.interrupt(); }
    void begin() override {
        if (broken_) throw Stale("tissue: an earlier call failed half way: make it anew");
        if (before_use_) before_use_();
    }
    void invalidate() noexcept override { broken_ = true; }
    /// Called before each use from outside; a simulation has its particles gathered there.
    void before_use(std::function<void()> call) { before_use_ = std::move(call); }

    void add(const TissueArrays& in) override {
        if (in.n == 0) return;
        if (n_ > 0 && is_solid_ != (in.lame != nullptr))
            throw Refused("tissue: expected bodies of one model, got solids beside bonds");
        disturbed();
        is_solid_ = in.lame != nullptr;
        contact_ = in.contact;
        const std::uint32_t before = ceil_div<std::uint32_t>(n_, tissue::kBlock) * tissue::kBlock, old = n_;
        const BondBlocks blocks(in, before, n_entries_);
        std::vector<Quad> at(in.n), velocity(in.n);
        for (std::uint32_t t = 0; t < in.n; ++t) {
            const float* p = in.positions + 3 * std::size_t(t);
            at[t] = {p[0], p[1], p[2], in.inverse_mass[t] * in.bound[t]};
            velocity[t] = {0, 0, 0, in.inverse_mass[t]};
        }
        extend(at_, old, before, at.data(), in.n, Quad{0, 0, 0, 0});
        extend(velocity_, old, before, velocity.data(), in.n, Quad{0, 0, 0, 0});
        if (is_solid_) add_solid(in, old, before, at);
        extend(id_, old, before, in.ids, in.n, tissue::kNobody);
        extend(hold_, old, before, in.hold, in.n, tissue::kGone);
        extend(phase_, old, before, in.phase, in.n, std::uint8_t(0));
        const std::vector<float> none(in.n, 0.0f);
        extend(volume_, old, before, none.data(), in.n, 0.0f);
        extend(wetness_, old, before, none.data(), in.n, 0.0f);
        const std::vector<std::uint8_t> whole(in.n, 0);
        extend(scarred_, old, before, whole.data(), in.n, std::uint8_t(0));
        const std::uint32_t n_blocks = before / tissue::kBlock;
        extend(first_, n_blocks, n_blocks, blocks.first.data(), blocks.first.size(), 0u);
        extend(other_, n_entries_, n_entries_, blocks.other.data(), blocks.other.size(), 0u);
        extend(length_, n_entries_, n_entries_, blocks.length.data(), blocks.length.size(), 0.0f);
        extend(stiffness_, n_entries_, n_entries_, blocks.stiffness.data(), blocks.stiffness.size(), 0.0f);
        extend(vessel_, n_entries_, n_entries_, blocks.vessel.data(), blocks.vessel.size(), std::uint8_t(0));
        n_ = before + in.n;
        n_entries_ += std::uint32_t(blocks.other.size());
        make_room();
        find_bodies();
        follow();
    }

    void set_materials(const tissue::Materials& materials) override {
        materials_ = materials;
        tears_ = yields_ = rubs_ = false;
        for (int k = 0; k < tissue::kMaxPhases; ++k) {
            tears_ |= materials.tear_strain[k] > 0.0f || materials.yield_strain[k] > 0.0f;
            yields_ |= materials.yield_strain[k] > 0.0f;
            rubs_ |= materials.friction[k] > 0.0f;
        }
    }
    void set_instruments(const tissue::Motions& motions, const tissue::Shapes& shapes) override {
        motions_ = motions;
        shapes_ = shapes;
    }
    int substeps(float dt) override { return std::max(1, int(std::ceil(double(dt) * fastest_))); }

    /// Moves the tissue by its own forces alone.
    int advance(const TissueStep& step) override {
        if (n_ == 0) return 0;
        if (is_solid_ && step.iterations != 1) throw Refused("iterations: expected 1 for a solid, got " + std::to_string(step.iterations));
        exec_.for_each(n_, tissue::Accelerate{acceleration_.data(), pulled_ ? pull_.data() : nullptr, step.gravity});
        return take_substeps(step.dt, step.substeps, step.iterations, step.gravity);
    }

    std::uint32_t tear(float dt) override {
        tissue::Materials materials = materials_;
        if (is_solid_) std::fill_n(materials.yield_strain, tissue::kMaxPhases, 0.0f);  // solids yield in their substeps
        return counted([&](std::uint32_t* n_torn) {
            exec_.for_each(n_, tissue::TearAndCreep{bonds(), at_.data(), phase_.data(), materials, dt, n_torn});
        });
    }

    void follow() override {
        exec_.for_each(n_, tissue::Remember{at_.data(), before_.data()});
    }

    std::uint32_t cut(const BladeSweep& blade) override {
        if (n_ == 0 || blade.n_triangles == 0) return 0;
        const tissue::SweptSurface sweep = on_grid(blade);
        const float3* before = blade.n_moving ? before_.data() : nullptr;
        return counted([&](std::uint32_t* n_cut) { exec_.for_each(n_, tissue::Cut{bonds(), at_.data(), before, sweep, n_cut}); });
    }

    /// Their number; the labels are then in piece_.
    std::uint32_t pieces() override {
        if (pieces_known_) return n_pieces_;
        std::uint32_t* label = label_.reserve(n_);
        find_labels(label);
        std::uint32_t* least_id = least_id_.reserve(n_);
        exec_.for_each(n_, sim::Fill{least_id, ~0u});
        n_pieces_ = count([&](std::uint32_t* n) {
            exec_.for_each(n_, tissue::LeastId{label, id_.data(), hold_.data(), least_id, n});
        });
        exec_.for_each(n_, tissue::TakeLeastId{label, least_id, piece_.reserve(n_)});
        pieces_known_ = true;
        return n_pieces_;
    }

    void grasp(const float3& center, float radius, int number) override {
        if (number < 0 || number >= tissue::kMaxGrasps)
            throw Refused("number: expected 0 to " + std::to_string(tissue::kMaxGrasps - 1) + ", got " + std::to_string(number));
        disturbed();
        const std::uint32_t bit = 1u << number;
        grasped_ = radius > 0.0f ? grasped_ | bit : grasped_ & ~bit;
        exec_.for_each(n_, tissue::Grasp<Quad>{at_.data(), hold_.data(), center, radius, std::uint8_t(number)});
    }

    /// Takes the particles inside the shape away, with all their bonds.
    std::uint32_t remove(const tissue::Shape& region) override {
        disturbed();
        const std::uint32_t n_removed = counted([&](std::uint32_t* n) {
            exec_.for_each(n_, tissue::TakeAway{at_.data(), hold_.data(), region, n});
        });
        if (n_removed) exec_.for_each(n_, tissue::DropBonds{bonds(), hold_.data()});
        return n_removed;
    }

    std::vector<double> felt() override {
        std::vector<double> out(6 * std::size_t(tissue::kMaxGrasps + felt_shapes_), 0.0);
        if (!feels_ || !(felt_dt_ > 0.0f)) return out;
        for (int i = 0; i < tissue::kMaxGrasps + felt_shapes_; ++i) {
            const bool holds = i < tissue::kMaxGrasps;
            if (holds && !(grasped_ >> i & 1u)) continue;
            sim::Impulse all[3], *sum = felt_sum_.reserve(1);
            const std::size_t first = holds ? 0 : 2 * std::size_t(1 + i - tissue::kMaxGrasps) * n_;
            exec_.reduce_in_order(n_, tissue::FeltOf{felt_.data() + first, holds ? hold_.data() : nullptr, std::uint8_t(tissue::kGrasped + i), n_},
                                  sim::AddImpulse{}, sim::Impulse{}, sum);
            exec_.download(&all[0], sum, sizeof *sum);
            if (holds) exec_.download(&all[1], pressed_.data() + 2 * i, 2 * sizeof *sum);
            for (int k = 0; k < 3; ++k) {
                out[6 * i + k] = (all[0].p[k] + all[1].p[k] + all[2].p[k]) / felt_dt_;
                out[6 * i + 3 + k] = (all[0].l[k] + all[1].l[k] + all[2].l[k]) / felt_dt_;
            }
        }
        return out;
    }

    std::uint32_t n() override { return n_; }
    std::uint32_t n_bonds() override {
        return count([&](std::uint32_t* n) { exec_.for_each(n_, tissue::CountBonds{bonds(), n}); });
    }

    double elastic_energy() override {
        if (n_ == 0) return 0.0;
        double sum, *out = energy_.reserve(1);
        if (is_solid_) {
            correct();
            exec_.reduce_in_order(n_, tissue::SolidEnergy{bonds(), solid(), at_.data(), terms_.data(), yielded_ ? stays_.data() : nullptr, n_terms_}, sim::AddDouble{}, 0.0, out);
        } else {
            exec_.reduce_in_order(n_, tissue::EnergyOf{bonds(), at_.data()}, sim::AddDouble{}, 0.0, out);
        }
        exec_.download(&sum, out, sizeof sum);
        return sum;
    }

    void get(float* positions, float* velocities, std::uint32_t* piece, std::uint8_t* hold, std::uint32_t* ids) override {
        take_out(at_, positions);
        take_out(velocity_, velocities);
        if (piece) {
            pieces();
            exec_.download(piece, piece_.data(), n_ * sizeof *piece);
        }
        if (hold) exec_.download(hold, hold_.data(), n_);
        if (ids) exec_.download(ids, id_.data(), n_ * sizeof *ids);
    }
    void set(const float* positions, const float* velocities) override {
        disturbed();
        put_in(at_, positions);
        put_in(velocity_, velocities);
    }
    void accelerate(const float* accelerations) override {
        pulled_ = accelerations != nullptr;
        if (pulled_) put(pull_, reinterpret_cast<const float3*>(accelerations), n_);
        exec_.synchronize();
    }
    void set_vessel(std::size_t number, const BloodVessel& vessel) override {
        if (number < 1 || number > std::size_t(tissue::kMaxVessels))
            throw Refused("vessel: expected a number from 1 to " + std::to_string(tissue::kMaxVessels) + ", got " + std::to_string(number));
        if (number > vessels_.size()) vessels_.resize(number);
        vessels_[number - 1] = vessel;
    }
    std::vector<BloodVessel> vessels() override { return vessels_; }
    bool has_vessels() const { return !vessels_.empty(); }

    std::vector<std::pair<std::string, std::size_t>> arrays() override {
        std::vector<std::pair<std::string, std::size_t>> out;
        each_array([&](const char* name, auto& buffer, std::size_t n) { out.push_back({name, n * sizeof *buffer.data()}); });
        return out;
    }
    void read(const std::string& name, void* out) override {
        each_array([&](const char* its, auto& buffer, std::size_t n) {
            if (name == its) exec_.download(out, buffer.data(), n * sizeof *buffer.data());
        });
    }
    /// `hold` first, then `other`: from their lengths follow the others'.
    void write(const std::string& name, const void* in, std::size_t bytes) override {
        disturbed();
        if (name == "hold") n_ = std::uint32_t(bytes);
        if (name == "hold" || name == "id") is_written_ = name == "hold";
        if (name == "other") n_entries_ = std::uint32_t(bytes / 4);
        if (name == "hold") is_solid_ = yielded_ = false, n_terms_ = 0;
        if (name == "rest") is_solid_ = bytes > 0;
        if (name == "terms" && n_) n_terms_ = std::uint32_t(std::min<std::size_t>(bytes / (sizeof(float) * tissue::kTermRows * stride()), tissue::kMostTerms));
        if (name == "stays") yielded_ = bytes > 0;
        if (name == "hold" || name == "body") bodies_known_ = name == "body" && bytes > 0;
        if (name == "hold") {
            grasped_ = 0;
            for (std::size_t t = 0; t < bytes; ++t)
                if (const int g = static_cast<const std::uint8_t*>(in)[t] - tissue::kGrasped; g >= 0 && g < tissue::kMaxGrasps) grasped_ |= 1u << g;
        }
        each_array([&](const char* its, auto& buffer, std::size_t n) {
            if (name != its) return;
            const std::size_t wanted = n * sizeof *buffer.data();
            if (bytes != wanted)
                throw Refused("tissue_" + name + ": expected " + std::to_string(wanted) + " bytes, got " + std::to_string(bytes));
            exec_.upload(buffer.reserve(n), in, wanted);
        });
        exec_.synchronize();
        if (name == "id") {
            make_room();
            if (!bodies_known_) exec_.clear(body_.reserve(n_), n_ * sizeof *body_.data());  // earlier versions saved those of solids alone
            n_scars_ = 1;  // as if there were some
        }
    }
    void set_spacing(float spacing, float size_of_fluid) {
        contact_ = spacing;
        size_of_fluid_ = size_of_fluid;
    }

    // In a simulation, in this order.

    /// A step moved the particles: the next gather looks at them anew.
    void moved() { gathered_ = false; }
    /// Something else did: some may be gone, or be held otherwise.
    void disturbed() { gathered_ = settled_ = false; }
    /// Where the particles are now; whether other particles are held than before, which takes waiting for the device.
    bool gather(const sim::State& state, const sim::Phase* phases, const std::uint32_t* slot_of, float volume) {
        if (n_ == 0 || gathered_ || is_written_) return false;
        gathered_ = true;
        std::uint32_t n[2], *counters = count_.reserve(2);
        if (!settled_) exec_.clear(counters, sizeof n);
        exec_.for_each(n_, tissue::Gather{state, phases, id_.data(), slot_of, slot_.data(), at_.data(), velocity_.data(), hold_.data(), volume,
                                          counters, counters + 1});
        if (settled_) return false;
        settled_ = true;
        exec_.download(n, counters, sizeof n);
        scar(n[0]);
        if (n[0]) exec_.for_each(n_, tissue::DropBonds{bonds(), hold_.data()});
        return n[1] > 0;
    }
    /// No density across cuts, nor within solids; the density of the rows that is there without their lists, or null.
    template <class Packet>
    const float* veto(const sim::Lists<Packet>& lists, const sim::State& state, const sim::Spline& spline, float volume) {
        if (n_ == 0) return nullptr;
        if (n_scars_ > 0) exec_.for_each(lists.n_rows, tissue::Veto<Packet>{lists, state, members(), bonds(), slot_.data()});
        if (!is_solid_) return nullptr;
        float* within = within_.reserve(lists.n_rows + 64);
        exec_.clear(within, (lists.n_rows + 64) * sizeof *within);
        const float reach = kWithin * contact_;
        exec_.for_each(lists.n_rows, tissue::LeaveOut<Packet>{lists, state, members(), rest_at_.data(), body_.data(), spline, volume, reach * reach, within});
        return within;
    }
    /// What the pressure that led to these velocities does to what is held; after push.
    template <class Packet>
    void feel_pressure(const sim::Lists<Packet>& lists, const sim::State& state, const float* nearest, const sim::Period& period, const sim::Sizes& sizes, float volume, float support,
                       float dt, float flux) {
        for (int g = 0; g < tissue::kMaxGrasps && n_ > 0 && feels_; ++g) {
            if (!(grasped_ >> g & 1u)) continue;
            const tissue::Held held{members(), state.id, hold_.data(), std::uint8_t(tissue::kGrasped + g)};
            const sim::PressureImpulse<Packet, tissue::Held> pressure{lists, state, nearest, held, period, sizes, volume, support, dt, flux, motions_.center[g]};
            exec_.reduce_in_order(lists.n_rows, pressure, sim::AddImpulse{}, sim::Impulse{}, pressed_.data() + 2 * g);
        }
    }
    /// Friction between what the pressure that led to these velocities presses together; after feel_pressure.  on_rigid(phase, impulse): rigid
    /// bodies feel it, too.
    template <class Packet, class OnRigid>
    void rub(const sim::Lists<Packet>& lists, const sim::State& state, const sim::Phase* phases, const std::map<int, tissue::RigidMass>& rigids, const sim::Period& period, float volume,
             float support, float dt, float flux, const OnRigid& on_rigid) {
        if (n_ == 0) return;
        tissue::PressedPairs<Packet> pairs{lists, state, phases, members(), is_solid_ ? nullptr : body_.data(), period, volume, volume * dt / (flux * support),
                                           {loads_.reserve(state.n), rigid_loads_.reserve(sim::kMaxPhases)}};
        exec_.for_each(lists.n_rows, tissue::FindLoads<Packet>{pairs});
        for (const auto& [phase, rigid] : rigids) {
            pairs.loads.mass[phase] = rigid.mass;
            exec_.reduce_in_order(lists.n_rows, tissue::LoadOf<Packet>{pairs, std::uint8_t(phase)}, sim::AddDouble{}, 0.0, rigid_loads_.data() + phase);
        }
        Quad* change = change_.reserve(lists.n_rows);
        exec_.for_each(lists.n_rows, tissue::RubPressed<Packet>{pairs, change});
        for (const auto& [phase, rigid] : rigids) {
            sim::Impulse impulse, *sum = felt_sum_.reserve(1);
            exec_.reduce_in_order(lists.n_rows, tissue::RubImpulse<Packet, sim::OfPhase>{pairs, {state.phase, std::uint8_t(phase)}, rigid.center}, sim::AddImpulse{}, sim::Impulse{}, sum);
            exec_.download(&impulse, sum, sizeof impulse);
            on_rigid(phase, impulse);
        }
        for (int g = 0; g < tissue::kMaxGrasps && feels_; ++g) {
            if (!(grasped_ >> g & 1u)) continue;
            const tissue::Held held{members(), state.id, hold_.data(), std::uint8_t(tissue::kGrasped + g)};
            exec_.reduce_in_order(lists.n_rows, tissue::RubImpulse<Packet, tissue::Held>{pairs, held, motions_.center[g]}, sim::AddImpulse{}, sim::Impulse{},
                                  pressed_.data() + 2 * g + 1);
        }
        exec_.for_each(lists.n_rows, tissue::TakeChange{lists.rows, change, state.velocity});
    }
    /// What happens to tissue once a step, while its particles stand: it tears, and gets wet.
    template <class Packet>
    void change(const sim::Lists<Packet>& lists, const sim::State& state, float dt) {
        if (n_ == 0) return;
        if (tears_) tear(dt);
        follow();
        std::uint32_t stains = 0;
        for (const BloodVessel& v : vessels_) stains |= 1u << v.phase;
        if (!stains) return;
        std::uint8_t* touched = touched_.reserve(n_);
        exec_.clear(touched, n_);
        exec_.for_each(lists.n_rows, tissue::Touch<Packet>{lists, state, members(), stains, 1.3f * contact_ * (0.5f + 0.5f * size_of_fluid_), touched});
        exec_.for_each(n_, tissue::Wet{touched, dt, wetness_.data()});
    }
    /// What tissue meets: walls, which the substeps keep it out of, and others.
    template <class Packet>
    void find_contacts(const sim::Lists<Packet>& lists, const sim::State& state, const sim::Phase* phases, const sim::Period& period, const sim::Spline& spline, bool rubs) {
        if (n_ == 0) return;
        Quad* plane = plane_.reserve(n_);
        float* speed = plane_speed_.reserve(n_);
        std::uint8_t* beside = beside_.reserve(n_);
        exec_.clear(plane, n_ * sizeof *plane);
        exec_.clear(speed, n_ * sizeof *speed);
        exec_.clear(beside, n_);
        Quad* rub = rubs ? plane_rub_.reserve(n_) : nullptr;
        if (rub) exec_.clear(rub, n_ * sizeof *rub);
        exec_.for_each(lists.n_rows, tissue::FindContacts<Packet>{lists, state, phases, members(), body_.data(), period, spline, contact_, plane, speed, rub, beside});
        walls_ = {plane, speed, rub};
    }
    /// After a step whose next one is chosen by speeds alone: `far` is how far a particle may move in it.
    void count_as(const sim::State& state, float far) {
        const float substep = far * float(fastest_);
        exec_.for_each(n_, tissue::CountAs{state, slot_.data(), beside_.data(), {0.0f, substep / kSubstepsByFluid, substep / kSubstepsByOthers}});
    }
    /// Before the forces.
    void take_velocities(const sim::State& state) {
        exec_.for_each(n_, tissue::TakeVelocity{state, slot_.data(), hold_.data(), velocity_.data()});
    }
    /// After the forces: the bonds' substeps, into the state's velocities.
    void push(const sim::State& state, float dt, const float3& gravity) {
        if (n_ == 0) return;
        exec_.for_each(n_, tissue::TakeAcceleration{state, slot_.data(), velocity_.data(), 1.0f / dt, acceleration_.data()});
        take_substeps(dt, 0, 1, gravity);
        exec_.for_each(n_, tissue::GiveVelocity{state, slot_.data(), at_.data(), velocity_.data(), 1.0f / dt, rest_.data()});
    }
    /// After the density solve, before particles move.
    void hold_on(const sim::State& state, float dt) {
        exec_.for_each(n_, tissue::HoldOn{state, slot_.data(), at_.data(), hold_.data(), 1.0f / dt});
    }
    /// After they moved.
    void add_rest(const sim::State& state) { exec_.for_each(n_, tissue::AddRest{state, slot_.data(), rest_.data()}); }

    /// Blood that comes out of cut ends: the device looks for room, while the tree is that of the positions.  After gather.
    template <class Tree>
    void bleed(const Tree& tree, const SortedParticles& particles, const sim::Sizes& sizes, float dt) {
        tissue::Vessels flowing;
        bleeds_ = false;
        for (std::size_t v = 0; v < vessels_.size(); ++v)
            if (vessels_[v].pool >= drop_volume()) bleeds_ = true, flowing.speed[v + 1] = vessels_[v].speed;
        bleeds_ &= n_scars_ > 0;
        if (!bleeds_) return;
        tissue::Drop *asking = asking_.reserve(n_), *found = found_.reserve(n_ + 1);
        exec_.clear(found, sizeof *found);
        exec_.for_each(n_, tissue::Bleed{bonds(), at_.data(), hold_.data(), flowing, contact_, size_of_fluid_ * size_of_fluid_ * size_of_fluid_, dt, volume_.data(), &found->vessel, asking});
        exec_.for_each_tile_of(&found->vessel, tissue::FindRoom<Tree>{tree, particles, asking, velocity_.data(), flowing, sizes, contact_, size_of_fluid_, &found->t, found + 1});
    }
    /// The drops that it found, in the order of the tissue, not too close to each other, as long as the pools last.
    std::vector<tissue::Drop> drops() {
        std::vector<tissue::Drop> out;
        if (!bleeds_) return out;
        std::vector<tissue::Drop> found(std::min<std::size_t>(kDropsToBegin, n_ + 1));  // first of all, how many there are
        exec_.download(found.data(), found_.data(), found.size() * sizeof found[0]);
        const std::size_t read = found.size(), n_found = found[0].t;
        found.resize(n_found + 1);
        if (n_found + 1 > read) exec_.download(&found[read], found_.data() + read, (n_found + 1 - read) * sizeof found[0]);
        found.erase(found.begin());
        std::sort(found.begin(), found.end(), [](const tissue::Drop& a, const tissue::Drop& b) { return a.t < b.t; });
        if (n_found > kDropsAtOnce) found.resize(kDropsAtOnce);
        std::vector<std::uint32_t> who;
        const float d = contact_ * size_of_fluid_, apart = 0.81f * d * d;
        for (const tissue::Drop& d : found) {
            BloodVessel& v = vessels_[d.vessel - 1];
            const auto near = [&](const tissue::Drop& o) { return dot(o.at - d.at, o.at - d.at) < apart; };
            if (v.pool < drop_volume() || std::any_of(out.begin(), out.end(), near)) continue;
            v.pool -= drop_volume();
            out.push_back(d);
            who.push_back(d.t);
        }
        put(spent_, who.data(), who.size());
        exec_.for_each(who.size(), tissue::Spend{spent_.data(), volume_.data(), float(drop_volume())});
        return out;
    }
    int phase_of_blood(std::uint32_t vessel) const { return vessels_[vessel - 1].phase; }

    /// Blood shows on what it wetted; colours and wetness by rank of the ids.
    void stain(const std::uint32_t* rank, const std::uint32_t* slot_of, const float* blood, float* color, float* wetness) {
        exec_.for_each(n_, tissue::Stain{id_.data(), slot_of, rank, wetness_.data(), {blood[0], blood[1], blood[2]}, color, wetness});
    }

private:
    static constexpr float kWithin = 2.6f;             ///< spacings at rest: a solid's pairs that are closer are its stress's, not the density solve's
    static constexpr double kBorne = 1.5, kMostStiffening = 64.0;
    static constexpr double kStrainOfPart = 2.0, kMostByStrain = 2.0;
    static constexpr float kSubstepsByFluid = 4.0f, kSubstepsByOthers = 2.0f;  ///< of a step, where tissue is beside these
    static constexpr float kJumpOfPart = 0.5f, kReachOfGrasp = 8.0f, kMostJumps = 4096.0f;  ///< spacings that a grasp moves; that what it holds is from its center
    static constexpr int kSubstepsOfPart = 16;         ///< after as many the strain is looked at again
    static constexpr std::size_t kDropsAtOnce = 2048;  ///< compared pairwise
    static constexpr std::size_t kDropsToBegin = 64;   ///< that come together with their number

    tissue::Bonds bonds() {
        return {n_, first_.data(), other_.data(), length_.data(), stiffness_.data(), vessel_.data(), scarred_.data()};
    }
    tissue::Members members() { return {of_id_.data(), n_ids_}; }
    double drop_volume() const { return std::pow(double(contact_) * size_of_fluid_, 3); }

    tissue::Solid solid() { return {rest_at_.data(), lame_.data(), correction_.data(), rows_.data(), stride(), contact_}; }
    std::uint32_t stride() const { return ceil_div<std::uint32_t>(n_, tissue::kBlock) * tissue::kBlock; }
    /// Positions at rest, and what particles are made of, beside those of other bodies.
    void add_solid(const TissueArrays& in, std::uint32_t old, std::uint32_t before, const std::vector<Quad>& at) {
        extend(rest_at_, old, before, at.data(), in.n, Quad{0, 0, 0, 0});
        const std::uint32_t all = before + ceil_div<std::uint32_t>(in.n, tissue::kBlock) * tissue::kBlock, was = stride();
        std::vector<float> lame = widened(lame_, 2, was, 2, all);
        for (int k = 0; k < 2; ++k) std::copy_n(in.lame + k * std::size_t(in.n), in.n, lame.data() + k * std::size_t(all) + before);
        put(lame_, lame.data(), lame.size());
        const std::uint32_t n_terms = std::max(n_terms_, in.n_terms);
        std::vector<float> terms = widened(terms_, tissue::kTermRows * n_terms_, was, tissue::kTermRows * n_terms, all);
        for (std::uint32_t k = 0; k < in.n_terms; ++k)
            for (int a = 0; a < 2; ++a)
                std::fill_n(terms.data() + (tissue::kTermRows * k + a) * std::size_t(all) + before, in.n, in.relaxation[2 * k + a]);
        put(terms_, terms.data(), terms.size());
        n_terms_ = n_terms;
        const std::vector<float> stays = yielded_ ? widened(stays_, 6, was, 6, all) : std::vector<float>();
        put(stays_, stays.data(), stays.size());
        float most = in.frequency, other = 0.0f;
        if (was) exec_.download(&other, frequency_.data(), sizeof other);
        most = std::max(most, other);
        put(frequency_, &most, 1);
        exec_.synchronize();
    }
    /// Rows of `was` items each become `rows` of `all`; what is new is 0.
    std::vector<float> widened(const Buffer<float, Exec>& buffer, std::uint32_t rows_were, std::uint32_t was, std::uint32_t rows, std::uint32_t all) {
        std::vector<float> out(rows * std::size_t(all), 0.0f), earlier(rows_were * std::size_t(was));
        if (!earlier.empty()) exec_.download(earlier.data(), buffer.data(), earlier.size() * sizeof(float));
        for (std::uint32_t k = 0; k < rows_were; ++k) std::copy_n(earlier.data() + k * std::size_t(was), was, out.data() + k * std::size_t(all));
        return out;
    }
    /// After bonds went, what is made of the whole ones.
    void correct() {
        if (corrected_) return;
        corrected_ = true;
        exec_.for_each(n_, tissue::Correct{bonds(), solid(), at_.data(), terms_.data(), n_terms_});
    }

    /// The least member of each particle's piece.
    void find_labels(std::uint32_t* label) {
        exec_.for_each(n_, tissue::OwnLabel{label});
        for (std::uint32_t changed = n_ > 0; changed;) {
            std::uint32_t* flag = count_.reserve(1);
            exec_.clear(flag, sizeof *flag);
            exec_.for_each(n_, tissue::Hook{bonds(), label, flag});
            exec_.for_each(n_, tissue::Jump{label});
            exec_.download(&changed, flag, sizeof changed);
        }
    }
    void find_bodies() { find_labels(body_.reserve(n_)); }

    /// Nothing is felt yet; where the substeps of a step add it up.
    tissue::Felt begin_felt(float dt, const float3& gravity) {
        felt_dt_ = dt;
        felt_shapes_ = shapes_.n;
        feels_ = grasped_ != 0 || shapes_.n > 0;
        if (!feels_) return {};
        const std::size_t size = 2 * std::size_t(1 + shapes_.n) * n_;
        exec_.clear(felt_.reserve(size), size * sizeof(float3));
        exec_.clear(pressed_.reserve(2 * tissue::kMaxGrasps), 2 * tissue::kMaxGrasps * sizeof(sim::Impulse));
        return {felt_.data(), n_, gravity};
    }

    /// How many times as many substeps as at rest the next ones of `dt` seconds need.  They are stable up to four times the stiffness at rest; the
    /// stiffest particle tells how much more there is, and the pair that strains fastest how much may come until this is asked again.
    double hurry(const Quad* at, float dt) {
        tissue::Strained most, *out = strained_.reserve(1 + std::size_t(n_)), *each = out + 1;
        exec_.for_each(n_, tissue::Stiffening{bonds(), solid(), at, velocity_.data(), yielded_ ? stays_.data() : nullptr, quiet_.data(), each});
        exec_.reduce_in_order(n_, tissue::StrainedOf{each}, tissue::MostStrained{}, tissue::Strained{1.0, 0.0}, out);
        exec_.download(&most, out, sizeof most);
        return std::sqrt(std::min(std::max(1.0, most.stiffness / kBorne), kMostStiffening)) *  // 1 where it is no number
               std::min(std::max(1.0, most.rate * dt / kStrainOfPart), kMostByStrain);
    }
    /// In how many parts a step's strain is looked at, so that what grasps hold does not jump away from its neighbors before.
    int jumps(float dt) const {
        float fastest = 0.0f;
        for (int g = 0; g < tissue::kMaxGrasps; ++g)
            if (grasped_ >> g & 1u) fastest = std::max(fastest, length(motions_.velocity[g]) + length(motions_.spin[g]) * kReachOfGrasp * contact_);
        return int(std::min(std::ceil(fastest * dt / (kJumpOfPart * contact_)), kMostJumps));
    }
    /// Symplectic: exact at rest, and energy neither grows nor decays.  Strain changes within a step, and with it the substeps.
    int take_solid_substeps(float whole_dt, int asked, const float3& gravity) {
        moved();
        correct();
        if (yields_ && !yielded_) {
            const std::size_t size = 6 * std::size_t(stride());
            exec_.clear(stays_.reserve(size), size * sizeof(float));
            yielded_ = true;
        }
        const tissue::Felt felt = begin_felt(whole_dt, gravity);
        Quad *at = at_.data(), *next = next_.data();
        const int n_parts = asked > 0 ? 1 : std::max(ceil_div(substeps(whole_dt), kSubstepsOfPart), jumps(whole_dt));
        const float part_dt = whole_dt / float(n_parts);
        int n_done = 0;
        for (int part = 0; part < n_parts; ++part) {
            const int n_substeps = asked > 0 ? asked : substeps(part_dt * float(hurry(at, part_dt)));
            const float dt = part_dt / float(n_substeps);
            for (int s = 0; s < n_substeps; ++s) {
                shapes_.move(dt);
                walls_.elapsed += dt;
                if (n_terms_ || yielded_) {
                    const tissue::Memory memory{terms_.data(), yielded_ ? stays_.data() : nullptr, phase_.data(), materials_, n_terms_, stride(), n_, dt};
                    exec_.for_each_packet(n_, tissue::Strain<tissue::Memory>{bonds(), solid(), at, quiet_.data(), memory});
                } else {
                    exec_.for_each_packet(n_, tissue::Strain<tissue::NoMemory>{bonds(), solid(), at, quiet_.data(), {}});
                }
                exec_.for_each_packet(n_, tissue::Push{bonds(), solid(), at, next, velocity_.data(), acceleration_.data(), hold_.data(), phase_.data(),
                                                       materials_, motions_, shapes_, walls_, felt, dt});
                rub_cuts(at, next, dt, dt, felt);
                std::swap(at, next);
            }
            n_done += n_substeps;
        }
        if (at != at_.data()) at_.swap(next_);
        return n_done;
    }

    int take_substeps(float whole_dt, int asked, int iterations, const float3& gravity) {
        if (is_solid_) return take_solid_substeps(whole_dt, asked, gravity);
        moved();
        const int n_substeps = asked > 0 ? asked : substeps(whole_dt);
        const float dt = whole_dt / float(n_substeps);
        exec_.for_each(n_, tissue::Predict{at_.data(), velocity_.data(), acceleration_.data(), hold_.data(), motions_, dt});
        const tissue::Felt felt = begin_felt(whole_dt, gravity);
        float* lambda = iterations > 1 ? lambda_.reserve(n_entries_) : nullptr;
        Quad *at = at_.data(), *next = next_.data();
        const auto relax = [&]<bool single>(std::bool_constant<single>, int s, int k) {
            exec_.for_each_packet(n_, tissue::Relax<single>{bonds(), at, next, velocity_.data(), acceleration_.data(), hold_.data(), phase_.data(),
                                                         lambda, materials_, motions_, shapes_, walls_, felt, dt, contact_, k == 0, k + 1 == iterations,
                                                         s + 1 < n_substeps});
            if (k + 1 == iterations) rub_cuts(at, next, dt, s + 1 < n_substeps ? 2.0f * dt : dt, felt);
            std::swap(at, next);
        };
        for (int s = 0; s < n_substeps; ++s) {
            shapes_.move(dt);
            walls_.elapsed += dt;
            if (iterations == 1) relax(std::true_type{}, s, 0);
            else
                for (int k = 0; k < iterations; ++k) relax(std::false_type{}, s, k);
        }
        if (at != at_.data()) at_.swap(next_);
        return n_substeps;
    }

    /// Friction of cut faces: of their contacts at `at`, after the velocities that led to `next`.
    void rub_cuts(const Quad* at, Quad* next, float dt, float ahead, const tissue::Felt& felt) {
        if (!rubs_ || n_scars_ == 0) return;
        float3* impulse = rub_.reserve(n_);
        exec_.for_each(n_, tissue::Rub{bonds(), at, velocity_.data(), hold_.data(), phase_.data(), materials_, dt, contact_, is_solid_, impulse});
        exec_.for_each(n_, tissue::TakeRub{scarred_.data(), hold_.data(), impulse, next, velocity_.data(), motions_, felt, ahead});
    }

    /// The grid is a power of two times finer than float32 positions of that size need, and the same for
    /// every sweep through this tissue.
    tissue::SweptSurface on_grid(const BladeSweep& blade) {
        tissue::SweptSurface sweep;
        sweep.grid.cells_per_unit = std::exp2(std::floor(std::log2(65536.0 / contact_)));
        std::vector<tissue::GridPoint> vertices(blade.n_vertices);
        double lo[3] = {1e300, 1e300, 1e300}, hi[3] = {-1e300, -1e300, -1e300};
        for (std::uint32_t v = 0; v < blade.n_vertices; ++v) {
            const double* p = blade.vertices + 3 * std::size_t(v);
            vertices[v] = {sweep.grid.snap(p[0], 0), sweep.grid.snap(p[1], 1), sweep.grid.snap(p[2], 2)};
            for (int k = 0; k < 3; ++k) lo[k] = std::min(lo[k], p[k]), hi[k] = std::max(hi[k], p[k]);
        }
        const double margin = 1e-3 * contact_;
        sweep.lo = {float(lo[0] - margin), float(lo[1] - margin), float(lo[2] - margin)};
        sweep.hi = {float(hi[0] + margin), float(hi[1] + margin), float(hi[2] + margin)};
        put(vertices_, vertices.data(), vertices.size());
        put(triangles_, blade.triangles, 3 * std::size_t(blade.n_triangles));
        sweep.vertices = vertices_.data();
        sweep.triangles = triangles_.data();
        sweep.n = blade.n_triangles;
        sweep.n_moving = blade.n_moving;
        return sweep;
    }

    template <class Launch>
    std::uint32_t count(const Launch& launch) {
        if (n_ == 0) return 0;
        std::uint32_t n = 0, *counter = count_.reserve(1);
        exec_.clear(counter, sizeof n);
        launch(counter);
        exec_.download(&n, counter, sizeof n);
        return n;
    }
    /// Bonds that went change the pieces.
    template <class Launch>
    std::uint32_t counted(const Launch& launch) {
        const std::uint32_t n = count(launch);
        scar(n);
        return n;
    }
    void scar(std::uint32_t n) {
        n_scars_ += n;
        if (n) pieces_known_ = corrected_ = false;
    }

    /// Everything that lasts, with the number of its items.
    template <class Fn>
    void each_array(const Fn& fn) {
        fn("hold", hold_, n_);
        fn("other", other_, n_entries_);
        fn("rest", rest_at_, is_solid_ ? n_ : 0);
        fn("lame", lame_, is_solid_ ? 2 * stride() : 0);
        fn("terms", terms_, n_terms_ * std::size_t(tissue::kTermRows) * stride());
        fn("stays", stays_, yielded_ ? 6 * std::size_t(stride()) : 0);
        fn("frequency", frequency_, is_solid_ ? 1 : 0);
        fn("body", body_, n_);
        fn("at", at_, n_);
        fn("velocity", velocity_, n_);
        fn("phase", phase_, n_);
        fn("scarred", scarred_, n_);
        fn("volume", volume_, n_);
        fn("wetness", wetness_, n_);
        fn("first", first_, n_ ? ceil_div<std::size_t>(n_, tissue::kBlock) + 1 : 0);
        fn("length", length_, n_entries_);
        fn("stiffness", stiffness_, n_entries_);
        fn("vessel", vessel_, n_entries_);
        fn("before", before_, n_);
        fn("id", id_, n_);
    }

    /// What follows from the particles' number and ids.
    void make_room() {
        for (auto* b : {&acceleration_, &rest_}) b->reserve(n_);
        next_.reserve(n_);
        slot_.reserve(n_);
        before_.reserve(n_);
        std::vector<std::uint32_t> ids(n_);
        exec_.download(ids.data(), id_.data(), n_ * sizeof ids[0]);
        n_ids_ = 0;
        for (std::uint32_t id : ids)
            if (id != tissue::kNobody) n_ids_ = std::max(n_ids_, id + 1);
        std::vector<std::uint32_t> of_id(n_ids_, tissue::kNobody);
        for (std::uint32_t t = 0; t < n_; ++t)
            if (ids[t] != tissue::kNobody) of_id[ids[t]] = t;
        put(of_id_, of_id.data(), of_id.size());
        exec_.synchronize();
        pieces_known_ = pulled_ = corrected_ = feels_ = false;
        if (!is_solid_) {
            fastest_ = fastest_bond();
            return;
        }
        rows_.reserve(3 * std::size_t(stride()));
        exec_.for_each(n_, tissue::FindQuiet{bonds(), hold_.data(), quiet_.reserve(n_)});
        exec_.clear(correction_.reserve(6 * std::size_t(stride())), 6 * std::size_t(stride()) * sizeof(float));
        float frequency;
        exec_.download(&frequency, frequency_.data(), sizeof frequency);
        fastest_ = frequency;  // stable up to twice that step: what is strained is stiffer
    }
    /// Square root of the largest κ / α, from what is stored.
    double fastest_bond() {
        std::vector<Quad> at(n_);
        std::vector<std::uint32_t> first(ceil_div<std::size_t>(n_, tissue::kBlock) + 1), other(n_entries_);
        std::vector<float> stiffness(n_entries_);
        exec_.download(at.data(), at_.data(), n_ * sizeof at[0]);
        exec_.download(first.data(), first_.data(), first.size() * sizeof first[0]);
        exec_.download(other.data(), other_.data(), n_entries_ * sizeof other[0]);
        exec_.download(stiffness.data(), stiffness_.data(), n_entries_ * sizeof stiffness[0]);
        double fastest2 = 0.0;
        for (std::uint32_t t = 0; t < n_; ++t)
            for (std::uint32_t e = first[t / tissue::kBlock] + t % tissue::kBlock; e < first[t / tissue::kBlock + 1]; e += tissue::kBlock)
                fastest2 = std::max(fastest2, double(stiffness[e]) * (double(at[t].w) + at[other[e]].w));
        return std::sqrt(fastest2);
    }

    template <class T>
    void put(Buffer<T, Exec>& buffer, const T* from, std::size_t n) {
        if (n) exec_.upload(buffer.reserve(n), from, n * sizeof(T));
    }
    /// n_old items stay, `between` fills up to place `begin`, then come m new ones.
    template <class T>
    void extend(Buffer<T, Exec>& buffer, std::size_t n_old, std::size_t begin, const T* more, std::size_t m, const T& between) {
        std::vector<T> all(begin + m, between);
        if (n_old) exec_.download(all.data(), buffer.data(), n_old * sizeof(T));
        if (m) std::memcpy(all.data() + begin, more, m * sizeof(T));
        put(buffer, all.data(), all.size());
        exec_.synchronize();
    }
    void take_out(const Buffer<Quad, Exec>& buffer, float* to) {
        if (!to) return;
        std::vector<Quad> all(n_);
        exec_.download(all.data(), buffer.data(), n_ * sizeof(Quad));
        for (std::size_t t = 0; t < n_; ++t) std::memcpy(to + 3 * t, &all[t], 3 * sizeof(float));
    }
    void put_in(Buffer<Quad, Exec>& buffer, const float* from) {
        if (!from) return;
        std::vector<Quad> all(n_);
        exec_.download(all.data(), buffer.data(), n_ * sizeof(Quad));
        for (std::size_t t = 0; t < n_; ++t) std::memcpy(&all[t], from + 3 * t, 3 * sizeof(float));
        put(buffer, all.data(), n_);
        exec_.synchronize();
    }

    Exec& exec_;
    std::uint32_t n_ = 0, n_entries_ = 0, n_pieces_ = 0, n_ids_ = 0;
    std::uint64_t n_scars_ = 0;  ///< bonds that went; 0: none
    float contact_ = 0.0f, size_of_fluid_ = 1.0f;
    double fastest_ = 0.0;       ///< 1/s: substeps a second
    bool pieces_known_ = false, pulled_ = false, tears_ = false, yields_ = false, rubs_ = false, bleeds_ = false;
    bool is_written_ = false;  ///< from outside, array by array
    bool gathered_ = false, settled_ = false;  ///< as the state has the particles; nobody since a gather has changed who is held
    tissue::Materials materials_;
    tissue::Motions motions_;
    tissue::Shapes shapes_;
    tissue::Walls walls_;
    std::vector<BloodVessel> vessels_;
    Buffer<Quad, Exec> at_, next_, velocity_;
    Buffer<float3, Exec> acceleration_, pull_, before_, rest_;
    Buffer<std::uint32_t, Exec> id_, slot_;
    Buffer<std::uint8_t, Exec> hold_, phase_, scarred_, touched_;
    Buffer<std::uint32_t, Exec> first_, other_;
    Buffer<float, Exec> length_, stiffness_;
    Buffer<std::uint8_t, Exec> vessel_;
    Buffer<float, Exec> volume_, wetness_, lambda_;
    Buffer<std::uint32_t, Exec> label_, least_id_, piece_, count_, of_id_;
    Buffer<tissue::GridPoint, Exec> vertices_;
    Buffer<std::uint32_t, Exec> triangles_;
    Buffer<tissue::Drop, Exec> asking_, found_;  ///< the first of found: how many are found (t) and ask (vessel)
    Buffer<std::uint32_t, Exec> spent_;
    Buffer<double, Exec> energy_;
    Buffer<tissue::Strained, Exec> strained_;
    std::function<void()> before_use_;
    bool broken_ = false;
    bool is_solid_ = false, corrected_ = false;  ///< not bonds alone; no bond went since the corrections
    Buffer<Quad, Exec> rest_at_, rows_;
    Buffer<float, Exec> lame_, terms_, stays_, correction_, frequency_;
    std::uint32_t n_terms_ = 0;                  ///< of Prony series, the most that a body has
    bool yielded_ = false;                       ///< stays_ is there
    Buffer<std::uint32_t, Exec> body_;           ///< bodies, as they were made: the least member
    bool bodies_known_ = false;
    Buffer<std::uint8_t, Exec> beside_, quiet_;
    Buffer<float, Exec> within_;
    std::uint32_t grasped_ = 0;                  ///< bits of the grasps that hold
    bool feels_ = false;
    int felt_shapes_ = 0;
    float felt_dt_ = 0.0f;                       ///< of the last step
    Buffer<float3, Exec> felt_;
    Buffer<sim::Impulse, Exec> felt_sum_;
    Buffer<sim::Impulse, Exec> pressed_;         ///< of pressure and of its friction, per grasp
    Buffer<Quad, Exec> plane_;                   ///< of the wall before each particle
    Buffer<float, Exec> plane_speed_;
    Buffer<Quad, Exec> plane_rub_, loads_, change_;  ///< friction: of planes, of what is pressed together
    Buffer<float3, Exec> rub_;                   ///< of cut faces
    Buffer<double, Exec> rigid_loads_;
};

/// Tissue alone, with its own means.
template <class Exec>
struct OwnExec {
    Exec exec;
};
template <class Exec>
class TissueAlone final : private OwnExec<Exec>, public TissueImpl<Exec> {
public:
    template <class... Args>
    explicit TissueAlone(Args&&... args) : OwnExec<Exec>{Exec(std::forward<Args>(args)...)}, TissueImpl<Exec>(this->exec) {}
};

}  // namespace globule::core
