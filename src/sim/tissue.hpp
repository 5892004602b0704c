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
#include "sim/parted.hpp"
#include "sim/solid.hpp"

namespace globule::core {

template <class Exec> class TissueImpl : public Tissue {
public:
    explicit TissueImpl(Exec& exec)
        : exec_(exec),
          side_(exec.sibling()),
          at_(exec),
          next_(exec),
          velocity_(exec),
          acceleration_(exec),
          pull_(exec),
          before_(exec),
          rest_(exec),
          by_pressure_(exec),
          response_(exec),
          owed_(exec),
          drag_(exec),
          id_(exec),
          slot_(exec),
          hold_(exec),
          phase_(exec),
          scarred_(exec),
          touched_(exec),
          first_(exec),
          other_(exec),
          length_(exec),
          stiffness_(exec),
          vessel_(exec),
          volume_(exec),
          next_volume_(exec),
          whose_(exec),
          next_whose_(exec),
          open_(exec),
          wetness_(exec),
          lambda_(exec),
          label_(exec),
          least_id_(exec),
          piece_(exec),
          count_(exec),
          of_id_(exec),
          vertices_(exec),
          triangles_(exec),
          asking_(exec),
          found_(exec),
          spent_(exec),
          energy_(exec),
          strained_(exec),
          rest_at_(exec),
          rows_(exec),
          spared_(exec),
          lame_(exec),
          terms_(exec),
          stays_(exec),
          correction_(exec),
          frequency_(exec),
          beside_cuts_(exec),
          body_(exec),
          beside_(exec),
          quiet_(exec),
          within_(exec),
          felt_(exec),
          one_sum_(exec),
          felt_sums_(exec),
          plane_(exec),
          plane_speed_(exec),
          plane_rub_(exec),
          loads_(exec),
          change_(exec),
          rub_(exec),
          contact_loads_(exec),
          rigid_loads_(exec) {}

    int device() const noexcept override { return exec_.device(); }
    Interrupt* whole() noexcept override { return &exec_.interrupt(); }
    void begin() override {
        if (broken_) throw Stale("tissue: an earlier call failed half way: make it anew");
        if (before_use_) before_use_();
    }
    void invalidate() noexcept override { broken_ = true; }
    /// Called before each use from outside; a simulation has its particles gathered there.
    void before_use(std::function<void()> call) { before_use_ = std::move(call); }

    void add(const TissueArrays& in) override;

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
        if (is_solid_ && step.iterations != 1)
            throw Refused("iterations: expected 1 for a solid, got " + std::to_string(step.iterations));
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

    void follow() override { exec_.for_each(n_, tissue::Remember{at_.data(), before_.data()}); }

    std::uint32_t cut(const BladeSweep& blade) override;

    /// Their number; the labels are then in piece_.
    std::uint32_t pieces() override;

    void grasp(const float3& center, float radius, int number) override {
        if (number < 0 || number >= tissue::kMaxGrasps)
            throw Refused(
                "number: expected 0 to " + std::to_string(tissue::kMaxGrasps - 1) + ", got " + std::to_string(number));
        disturbed();
        const std::uint32_t bit = 1u << number;
        felt_grasps_ &= ~bit;
        grasped_ = radius > 0.0f ? grasped_ | bit : grasped_ & ~bit;
        exec_.for_each(n_, tissue::Grasp<Quad>{at_.data(), hold_.data(), center, radius, std::uint8_t(number)});
    }

    /// Takes the particles inside the shape away, with all their bonds.
    std::uint32_t remove(const tissue::Shape& region) override {
        disturbed();
        const std::uint32_t n_removed = counted(
            [&](std::uint32_t* n) { exec_.for_each(n_, tissue::TakeAway{at_.data(), hold_.data(), region, n}); });
        if (n_removed) exec_.for_each(n_, tissue::DropBonds{bonds(), hold_.data()});
        return n_removed;
    }

    std::vector<double> felt() override {
        std::vector<double> out(6 * std::size_t(tissue::kMaxGrasps + felt_shapes_), 0.0);
        if (!feels_ || !(felt_dt_ > 0.0f)) return out;
        ask_felt();
        const tissue::FeltSums& sums = felt_answer_.wait();
        const auto add = [&](const sim::Impulse& sum, int i) {
            for (int k = 0; k < 3; ++k) out[6 * i + k] += sum.p[k], out[6 * i + 3 + k] += sum.l[k];
        };
        for (int i = 0; i < tissue::kMaxGrasps + felt_shapes_; ++i)
            if (i >= tissue::kMaxGrasps || felt_grasps_ >> i & 1u) add(sums.of[i], i);
        for (int i = 0; i < 2 * tissue::kMaxGrasps; ++i)
            if (felt_grasps_ >> i / 2 & 1u) add(sums.pressed[i], i / 2);
        for (double& v : out) v /= felt_dt_;
        return out;
    }
    /// What the last step's grasps and shapes felt begins its way to the host, which asks for it at every step.
    void ask_felt() {
        if (!feels_ || std::exchange(felt_asked_, true)) return;
        tissue::FeltSums* sums = felt_sums_.data();
        for (int i = 0; i < tissue::kMaxGrasps + felt_shapes_; ++i) {
            const bool holds = i < tissue::kMaxGrasps;
            if (holds && !(felt_grasps_ >> i & 1u)) continue;
            const std::size_t first = holds ? 0 : 2 * std::size_t(1 + i - tissue::kMaxGrasps) * n_;
            exec_.reduce_in_order(n_,
                tissue::FeltOf{
                    felt_.data() + first, holds ? hold_.data() : nullptr, std::uint8_t(tissue::kGrasped + i), n_},
                sim::AddImpulse{}, sim::Impulse{}, sums->of + i);
        }
        felt_answer_.ask(exec_, sums);
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
            exec_.reduce_in_order(n_,
                tissue::SolidEnergy{
                    bonds(), solid(), at_.data(), terms_.data(), yielded_ ? stays_.data() : nullptr, n_terms_},
                sim::AddDouble{}, 0.0, out);
        } else {
            exec_.reduce_in_order(n_, tissue::EnergyOf{bonds(), at_.data()}, sim::AddDouble{}, 0.0, out);
        }
        exec_.download(&sum, out, sizeof sum);
        return sum;
    }

    void get(
        float* positions, float* velocities, std::uint32_t* piece, std::uint8_t* hold, std::uint32_t* ids) override {
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
            throw Refused("vessel: expected a number from 1 to " + std::to_string(tissue::kMaxVessels) + ", got " +
                          std::to_string(number));
        if (number > vessels_.size()) vessels_.resize(number);
        vessels_[number - 1] = vessel;
    }
    std::vector<BloodVessel> vessels() override { return vessels_; }
    bool has_vessels() const { return !vessels_.empty(); }

    std::vector<std::pair<std::string, std::size_t>> arrays() override {
        std::vector<std::pair<std::string, std::size_t>> out;
        each_array(
            [&](const char* name, auto& buffer, std::size_t n) { out.push_back({name, n * sizeof *buffer.data()}); });
        return out;
    }
    void read(const std::string& name, void* out) override {
        bool found = false;
        each_array([&](const char* its, auto& buffer, std::size_t n) {
            if (name != its) return;
            exec_.download(out, buffer.data(), n * sizeof *buffer.data());
            found = true;
        });
        if (!found) throw Refused("tissue: expected the name of one of its arrays, got " + name);
    }
    /// `hold` first, then `other`: from their lengths follow the others'.
    void write(const std::string& name, const void* in, std::size_t bytes) override;
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
    bool gather(const sim::State& state, const sim::Phase* phases, const std::uint32_t* slot_of, float volume);
    /// No density across the cuts of springs, nor within solids; the density of the rows that is there without their
    /// lists, or null.
    template <class Packet> const float* veto(const sim::Step<Packet>& step);
    /// What the pressure that led to these velocities does to what is held; after push.
    template <class Packet> void feel_pressure(const sim::Step<Packet>& step);
    /// Friction between what the pressure that led to these velocities presses together; after feel_pressure.
    /// on_rigid(phase, impulse): rigid bodies feel it, too.
    template <class Packet, class OnRigid>
    void rub(const sim::Step<Packet>& step, const std::map<int, tissue::RigidMass>& rigids, const OnRigid& on_rigid);
    /// What happens to tissue once a step, while its particles stand: it tears, and gets wet.
    template <class Packet> void change(const sim::Step<Packet>& step);
    /// What tissue meets: walls, which the substeps keep it out of, and others.
    /// `fluids`: there are some, and what presses is found by a solve.
    template <class Packet> void find_contacts(const sim::Step<Packet>& step, bool rubs, bool fluids);
    /// After a step whose next one is chosen by speeds alone: `far` is how far a particle may move in it.
    void count_as(const sim::State& state, float far) {
        const float substep = far * float(fastest_);
        exec_.for_each(n_, tissue::CountAs{state, slot_.data(), beside_.data(), response(),
                               {0.0f, substep / kSubstepsByFaces, substep / kSubstepsByOthers},
                               substep / kSubstepsByFluid, substep / kSubstepsOfSprings});
    }
    /// What the last step owes to solids: no velocity shows it.
    sim::Impulse owed() {
        sim::Impulse sum{}, *out = one_sum_.reserve(1);
        if (n_ == 0 || !is_solid_) return sum;
        exec_.reduce_in_order(
            n_, tissue::OwedMomentum{at_.data(), velocity_.data(), owed_.data()}, sim::AddImpulse{}, sum, out);
        exec_.download(&sum, out, sizeof sum);
        return sum;
    }
    /// Before the forces.  The device looks for the strain first, so that the host, which counts the substeps by it,
    /// need not wait.
    void take_velocities(const sim::State& state) {
        if (n_ == 0) return;
        exec_.for_each(n_, tissue::TakeVelocity{state, slot_.data(), hold_.data(), velocity_.data()});
        if (!is_solid_) return;
        prepare_solid();
        ask_strain(at_.data());
        asked_strain_ = true;
    }
    /// After the forces: the bonds' substeps, into the state's velocities.
    void push(const sim::State& state, float dt, const float3& gravity) {
        if (n_ == 0) return;
        // Springs hold their own pressure, which would lag in long steps.
        exec_.for_each(
            n_, tissue::TakeAcceleration{state, slot_.data(), velocity_.data(), by_pressure_.data(),
                    is_solid_ ? owed_.data() : nullptr, response(), 1.0f / dt, gravity, acceleration_.data()});
        take_substeps(dt, 0, 1, gravity);
        exec_.for_each(n_, tissue::GiveVelocity{state, slot_.data(), at_.data(), velocity_.data(), hold_.data(),
                               response(), dt, 1.0f / dt, rest_.data(), by_pressure_.data()});
    }
    /// After the divergence solve and its friction.
    void take_pressed(const sim::State& state, float dt) {
        exec_.for_each(n_, tissue::TakePressed{state, slot_.data(), hold_.data(), response(), 1.0f / dt,
                               by_pressure_.data(), is_solid_ ? owed_.data() : nullptr});
    }
    /// After the density solve, before particles move.
    void hold_on(const sim::State& state, float dt) {
        exec_.for_each(n_, tissue::HoldOn{state, slot_.data(), at_.data(), hold_.data(), 1.0f / dt});
    }
    /// After they moved.
    void add_rest(const sim::State& state, const sim::Phase* phases) {
        exec_.for_each(n_, tissue::AddRest{state, phases, slot_.data(), rest_.data(), response()});
    }

    /// What bleed() asks for runs beside what is asked for from now on.
    void begin_aside() {
        if (!vessels_.empty()) side_->follow(exec_);
    }
    /// Blood that comes out of cut ends: the device looks for room, while the tree is that of the positions.  After
    /// gather and begin_aside.
    void bleed(const Tree& tree, const SortedParticles& particles, const sim::Sizes& sizes, float dt);
    /// The drops that it found, in the order of the tissue, not too close to each other, as long as the pools last.
    std::vector<tissue::Drop> drops();
    int phase_of_blood(std::uint32_t vessel) const { return vessels_[vessel - 1].phase; }

    /// Blood shows on what it wetted; colors and wetness by rank of the ids.
    void stain(
        const std::uint32_t* rank, const std::uint32_t* slot_of, const float* blood, float* color, float* wetness) {
        exec_.for_each(n_,
            tissue::Stain{id_.data(), slot_of, rank, wetness_.data(), {blood[0], blood[1], blood[2]}, color, wetness});
    }

private:
    static constexpr float kWithin =
        2.6f;  ///< spacings at rest: a solid's pairs that are closer are its stress's, not the density solve's
    static constexpr double kBorne = 1.5, kMostStiffening = 256.0;
    static constexpr double kStrainOfPart = 2.0, kMostByStrain = 2.0;
    /// Of a step, where tissue is beside these; beside a fluid, of springs.
    static constexpr float kSubstepsByFluid = 8.0f, kSubstepsByFaces = 6.0f, kSubstepsByOthers = 2.0f,
                           kSubstepsOfSprings = 4.0f;
    static constexpr float kJumpOfPart = 0.5f, kReachOfGrasp = 8.0f,
                           kMostJumps =
                               4096.0f;  ///< spacings that a grasp moves; that what it holds is from its center
    static constexpr float kSubstepsOfLoad = 64.0f,
                           kGapOfContact = 0.05f;  ///< spacings
    static constexpr float kPressureWithin = 0.6f,
                           kWetWithin = 0.2f;  ///< share of the last pressure that acts in the substeps; beside a fluid
    static constexpr int kSubstepsOfPart = 16;         ///< after as many the strain is looked at again
    static constexpr std::size_t kDropsAtOnce = 2048;  ///< compared pairwise
    using FirstDrops = std::array<tissue::Drop, 64>;   ///< that come together with their number

    tissue::Bonds bonds() {
        return {n_, first_.data(), other_.data(), length_.data(), stiffness_.data(), vessel_.data(), scarred_.data(),
            is_solid_ ? spared_.data() : nullptr};
    }
    tissue::Members members() { return {of_id_.data(), n_ids_}; }
    double drop_volume() const { return std::pow(double(contact_) * size_of_fluid_, 3); }

    tissue::Solid solid() {
        return {rest_at_.data(), lame_.data(), correction_.data(), rows_.data(), stride(), contact_};
    }
    std::uint32_t stride() const { return ceil_div<std::uint32_t>(n_, tissue::kBlock) * tissue::kBlock; }
    /// Positions at rest, and what particles are made of, beside those of other bodies.
    void add_solid(const TissueArrays& in, std::uint32_t old, std::uint32_t before, const std::vector<Quad>& at);
    void put_none_slid();
    /// Rows of `was` items each become `rows` of `all`; what is new is 0.
    std::vector<float> widened(const Buffer<float, Exec>& buffer, std::uint32_t rows_were, std::uint32_t was,
        std::uint32_t rows, std::uint32_t all);
    /// After bonds went, what is made of the whole ones.
    void correct() {
        if (corrected_) return;
        corrected_ = true;
        exec_.for_each(n_, tissue::Correct{bonds(), solid(), at_.data(), terms_.data(), n_terms_});
    }

    /// The least member of each particle's piece.
    void find_labels(std::uint32_t* label);

    tissue::Response response() const {
        return {wet_ ? response_.data() : nullptr, is_solid_ ? kPressureWithin : 0.0f, kWetWithin};
    }

    /// Nothing is felt yet; where the substeps of a step add it up.
    tissue::Felt begin_felt(float dt, const float3& gravity);

    /// Where the substeps of a step keep what presses walls and shapes.
    void begin_rub();

    /// How many times as many substeps as at rest the next ones of `dt` seconds need.  They are stable up to four times
    /// the stiffness at rest; the stiffest particle tells how much more there is, and the pair that strains fastest how
    /// much may come until this is asked again.
    double hurry(float dt) const;
    /// Begins to find these two.
    void ask_strain(const Quad* at);
    void prepare_solid();
    /// In how many parts a step's strain is looked at, so that what grasps hold does not jump away from its neighbors
    /// before.
    int jumps(float dt) const;
    /// Symplectic: exact at rest, and energy neither grows nor decays.  Strain changes within a step, and with it the
    /// substeps.
    int take_solid_substeps(float whole_dt, int asked, const float3& gravity);

    int take_substeps(float whole_dt, int asked, int iterations, const float3& gravity);

    /// Friction of cut faces: of their contacts at `at`, after the velocities that led to `next`.
    void rub_cuts(const Quad* at, Quad* next, float dt, float ahead, const tissue::Felt& felt);

    /// The grid is a power of two times finer than float32 positions of that size need, and the same for
    /// every sweep through this tissue.
    tissue::SweptSurface on_grid(const BladeSweep& blade);

    template <class Launch> std::uint32_t count(const Launch& launch) {
        if (n_ == 0) return 0;
        std::uint32_t n = 0, *counter = count_.reserve(1);
        exec_.clear(counter, sizeof n);
        launch(counter);
        exec_.download(&n, counter, sizeof n);
        return n;
    }
    /// Bonds that went change the pieces.
    template <class Launch> std::uint32_t counted(const Launch& launch) {
        const std::uint32_t n = count(launch);
        scar(n);
        return n;
    }
    void scar(std::uint32_t n) {
        n_scars_ += n;
        if (n) pieces_known_ = corrected_ = false;
    }

    /// Everything that lasts, with the number of its items.
    template <class Fn> void each_array(const Fn& fn);

    /// What follows from the particles' number and ids.
    void make_room();
    /// Square root of the largest κ / α, from what is stored.
    double fastest_bond();

    template <class T> void put(Buffer<T, Exec>& buffer, const T* from, std::size_t n) {
        if (n) exec_.upload(buffer.reserve(n), from, n * sizeof(T));
    }
    /// n_old items stay, `between` fills up to place `begin`, then come m new ones.
    template <class T>
    void extend(
        Buffer<T, Exec>& buffer, std::size_t n_old, std::size_t begin, const T* more, std::size_t m, const T& between);
    void take_out(const Buffer<Quad, Exec>& buffer, float* to);
    void put_in(Buffer<Quad, Exec>& buffer, const float* from);

    Exec& exec_;
    std::shared_ptr<Exec> side_;  ///< works beside it, on what few particles leave idle
    std::uint32_t n_ = 0, n_entries_ = 0, n_pieces_ = 0, n_ids_ = 0;
    std::uint64_t n_scars_ = 0;  ///< bonds that went; 0: none
    float contact_ = 0.0f, size_of_fluid_ = 1.0f;
    double fastest_ = 0.0;  ///< 1/s: substeps a second
    bool pieces_known_ = false, pulled_ = false, tears_ = false, yields_ = false, rubs_ = false, bleeds_ = false;
    bool is_written_ = false;  ///< from outside, array by array
    bool gathered_ = false,
         settled_ = false;  ///< as the state has the particles; nobody since a gather has changed who is held
    tissue::Materials materials_;
    tissue::Motions motions_;
    tissue::Shapes shapes_;
    tissue::Walls walls_;
    std::vector<BloodVessel> vessels_;
    Buffer<Quad, Exec> at_, next_, velocity_;
    Buffer<float3, Exec> acceleration_, pull_, before_, rest_;
    Buffer<float3, Exec> by_pressure_;  ///< acceleration in the last step; within a step, the velocity before pressure
    Buffer<float, Exec> response_;      ///< of this step
    Buffer<float3, Exec> owed_, drag_;  ///< of solids: velocity from the last step; acceleration
    bool wet_ = false;                  ///< response_ and drag_ count
    Buffer<std::uint32_t, Exec> id_, slot_;
    Buffer<std::uint8_t, Exec> hold_, phase_, scarred_, touched_;
    Buffer<std::uint32_t, Exec> first_, other_;
    Buffer<float, Exec> length_, stiffness_;
    Buffer<std::uint8_t, Exec> vessel_;
    Buffer<float, Exec> volume_, next_volume_;              ///< of blood
    Buffer<std::uint8_t, Exec> whose_, next_whose_, open_;  ///< the vessel that it comes from, 0: none
    Buffer<float, Exec> wetness_, lambda_;
    Buffer<std::uint32_t, Exec> label_, least_id_, piece_, count_, of_id_;
    Buffer<tissue::GridPoint, Exec> vertices_;
    Buffer<std::uint32_t, Exec> triangles_;
    typename Exec::template Answer<FirstDrops> first_drops_;
    Buffer<tissue::Drop, Exec> asking_, found_;  ///< the first of found: how many are found (t) and ask (vessel)
    Buffer<std::uint32_t, Exec> spent_;
    Buffer<double, Exec> energy_;
    Buffer<tissue::Strained, Exec> strained_;
    typename Exec::template Answer<tissue::Strained> most_strained_;
    bool asked_strain_ = false;  ///< of where the substeps begin
    std::function<void()> before_use_;
    bool broken_ = false;
    bool is_solid_ = false, corrected_ = false;  ///< not bonds alone; no bond went since the corrections
    Buffer<Quad, Exec> rest_at_, rows_;
    Buffer<float, Exec> spared_;  ///< as in OwnPairs
    Buffer<float, Exec> lame_, terms_, stays_, correction_, frequency_;
    std::uint32_t n_terms_ = 0;                ///< of Prony series, the most that a body has
    bool yielded_ = false;                     ///< stays_ is there
    Buffer<std::uint32_t, Exec> beside_cuts_;  ///< rows: how many, then which
    Buffer<std::uint32_t, Exec> body_;         ///< bodies, as they were made: the least member
    bool bodies_known_ = false;
    Buffer<std::uint8_t, Exec> beside_, quiet_;
    Buffer<float, Exec> within_;
    std::uint32_t grasped_ = 0;  ///< bits of the grasps that hold
    bool feels_ = false, felt_asked_ = false;
    std::uint32_t felt_grasps_ = 0;  ///< a bit for each that held in the last step, and does since
    int felt_shapes_ = 0;
    float felt_dt_ = 0.0f;  ///< of the last step
    Buffer<float3, Exec> felt_;
    Buffer<sim::Impulse, Exec> one_sum_;
    Buffer<tissue::FeltSums, Exec> felt_sums_;
    typename Exec::template Answer<tissue::FeltSums> felt_answer_;
    Buffer<Quad, Exec> plane_;  ///< of the wall before each particle
    Buffer<float, Exec> plane_speed_;
    Buffer<Quad, Exec> plane_rub_, loads_, change_;  ///< friction: of planes, of what is pressed together
    Buffer<float3, Exec> rub_;                       ///< of cut faces
    Buffer<Quad, Exec> contact_loads_;               ///< (2, n) as in MeanLoads, of walls and of shapes
    bool loaded_ = false;                            ///< contact_loads_ is there
    Buffer<double, Exec> rigid_loads_;
};

/// Tissue alone, with its own means.
template <class Exec> struct OwnExec { Exec exec; };
template <class Exec> class TissueAlone final : private OwnExec<Exec>, public TissueImpl<Exec> {
public:
    template <class... Args>
    explicit TissueAlone(Args&&... args)
        : OwnExec<Exec>{Exec(std::forward<Args>(args)...)}, TissueImpl<Exec>(this->exec) {}
};

}  // namespace globule::core

#include "sim/tissue_blood.hpp"
#include "sim/tissue_contact.hpp"
#include "sim/tissue_cuts.hpp"
#include "sim/tissue_store.hpp"
#include "sim/tissue_substeps.hpp"
