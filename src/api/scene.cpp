#include "globule/scene.hpp"

#include <cmath>
#include <algorithm>

#include "api/impl.hpp"
#include "api/spacing.hpp"
#include "field/surface_kernels.hpp"

namespace globule {
namespace {

constexpr std::size_t kDozen = 12;  ///< the spacing of so many is not kept
constexpr core::float3 kColor{0.28f, 0.52f, 0.80f};
constexpr int kSmoothEdges = 3;  ///< more samples at edges of images with a smooth surface, by default

/// What an update takes, checked.
struct Update {
    core::SceneArrays arrays;
    std::unique_ptr<Inputs> inputs;
    std::optional<double> one_support;  ///< none where each has its own, or where it is to be measured
    bool measured = false;
    double largest_support = 0;
};

core::FloatArray field(Inputs& inputs, const char* name, const Scalars& given, std::size_t n, float& one,
    double least = -kInfinity, double most = kInfinity) {
    if (given.one()) one = number(name, *given.one(), least, most);
    if (!given.each().given()) return {};
    const core::FloatArray each = inputs.floats(name, given.each(), 1, n);
    check_range(name, each, n, 1, least, most);
    return each;
}

/// Rays are walked in steps of the supports nearby, so those must be of comparable size.
double check_supports(const core::FloatArray& support, std::size_t n) {
    float largest = 0, smallest = std::numeric_limits<float>::infinity();
    for (std::size_t i = 0; i < n; ++i) {
        largest = std::max(largest, support.data[i]);
        if (support.data[i] > 0) smallest = std::min(smallest, support.data[i]);
    }
    if (largest > kMaxSupport) refuse("support", "at most " + text(kMaxSupport), text(largest));
    if (largest > kMaxRatio * smallest)
        refuse("support", "all within a factor of " + text(kMaxRatio), text(smallest) + " to " + text(largest));
    return largest;
}

/// Eigenvalues of a symmetric matrix, ascending, by Jacobi's rotations.
Vec3 eigenvalues(double a[3][3]) {
    for (int sweep = 0; sweep < 32; ++sweep) {
        const double off = a[0][1] * a[0][1] + a[0][2] * a[0][2] + a[1][2] * a[1][2];
        if (off <= 1e-30 * (a[0][0] * a[0][0] + a[1][1] * a[1][1] + a[2][2] * a[2][2])) break;
        for (int p = 0; p < 2; ++p)
            for (int q = p + 1; q < 3; ++q) {
                if (a[p][q] == 0) continue;
                const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
                const double t = (theta >= 0 ? 1 : -1) / (std::abs(theta) + std::sqrt(theta * theta + 1)),
                             c = 1 / std::sqrt(t * t + 1), s = t * c;
                for (int k = 0; k < 3; ++k) {
                    const double x = a[k][p], y = a[k][q];
                    a[k][p] = c * x - s * y;
                    a[k][q] = s * x + c * y;
                }
                for (int k = 0; k < 3; ++k) {
                    const double x = a[p][k], y = a[q][k];
                    a[p][k] = c * x - s * y;
                    a[q][k] = s * x + c * y;
                }
            }
    }
    Vec3 v{a[0][0], a[1][1], a[2][2]};
    std::sort(v.begin(), v.end());
    return v;
}

/// Ellipsoids as the core takes them: six numbers a matrix, the longest axes as supports, the largest ratio of axes.
struct Stretched {
    std::vector<float> six, longest;
    float most = 1;
};
Stretched stretched(const ArrayView& view, std::size_t n) {
    Inputs inputs(core::kHost);
    const core::FloatArray m = inputs.floats("anisotropy", view, 9, n);
    Stretched out;
    out.six.resize(6 * n);
    out.longest.resize(n);
    double most = 1;
    for (std::size_t i = 0; i < n; ++i) {
        const float* g = m.data + 9 * i;
        double a[3][3], size = 0, skew = 0;
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c) {
                a[r][c] = g[3 * r + c];
                size = std::max(size, std::abs(a[r][c]));
                skew = std::max(skew, double(std::abs(g[3 * r + c] - g[3 * c + r])));
            }
        const Vec3 short_ = std::isfinite(size) ? eigenvalues(a) : Vec3{0, 0, 0};
        if (!(skew <= 1e-4 * size && short_[0] > 0))
            refuse(
                "anisotropy", "symmetric positive definite matrices", "another (particle " + std::to_string(i) + ")");
        const float six[6] = {g[0], g[4], g[8], g[1], g[2], g[5]};
        std::copy(six, six + 6, &out.six[6 * i]);
        out.longest[i] = float(1.0001 / short_[0]);  // rounding must not cut off what it reaches
        most = std::max(most, short_[2] / short_[0]);
    }
    out.most = float(1.0001 * most);
    return out;
}

Update check_update(
    const Particles& p, int device, bool dense, bool smooth, double own_support, double measured_support) {
    Update u;
    u.inputs = std::make_unique<Inputs>(device);
    core::SceneArrays& a = u.arrays;
    Inputs& in = *u.inputs;
    if (!p.positions.given()) refuse("positions", "an array", "none");
    a.positions = in.rows("positions", p.positions, 3, a.n);
    if (a.n > kMaxParticles)
        refuse("positions", "at most " + std::to_string(kMaxParticles) + " particles", std::to_string(a.n));
    if (smooth) {
        if (measured_support > 0) u.one_support = measured_support;
        else u.measured = true;
    } else if (p.anisotropy.given()) {
        if (dense) refuse("anisotropy", "the sparse octree", "dense");
        Stretched s = stretched(p.anisotropy, a.n);
        a.most_stretch = s.most;
        a.stretch = in.keep(std::move(s.six));
        a.support = in.keep(std::move(s.longest));
    } else if (own_support > 0) {
        u.one_support = own_support;
    } else if (p.support.one()) {
        u.one_support = positive("support", *p.support.one());
    } else if (p.support.each().given()) {
        a.support = in.floats("support", p.support.each(), 1, a.n);
        check_range("support", a.support, a.n, 1, 0, kInfinity);
    } else if (measured_support > 0) {
        u.one_support = measured_support;
    } else {
        u.measured = true;
    }
    if (u.one_support && *u.one_support > kMaxSupport)
        refuse("support", "at most " + text(kMaxSupport), text(*u.one_support));
    if (a.support.data && a.support.device == core::kHost) u.largest_support = check_supports(a.support, a.n);
    a.weight = field(in, "weight", p.weight, a.n, a.one_weight);
    a.reflection = field(in, "reflection", p.reflection, a.n, a.one_reflection);
    a.refraction = field(in, "refraction", p.refraction, a.n, a.one_refraction);
    a.one_color = p.color.one() ? three("color", *p.color.one(), 0, 1) : kColor;
    if (p.color.each().given()) {
        a.color = in.floats("color", p.color.each(), 3, a.n);
        check_range("color", a.color, a.n, 3, 0, 1);
    }
    return u;
}

}  // namespace

void Scene::Impl::check_whole() const {
    if (!n_of_owner && !whole)
        throw Error(ErrorCode::stale, "scene: its octree was not finished: update the scene first");
}

void Scene::Impl::update(const Particles& p) {
    if (n_of_owner) throw Error(ErrorCode::invalid, "update: the scene of a simulation follows its particles");
    const core::Gates inside = gates();
    Update u = check_update(p, core.device(), tree.dense, smooth, own_support, measured_support);
    const bool was_whole = whole;
    bool changed = false;
    double found = 0;
    const auto build = [&](double one) {
        u.arrays.one_support = float(one);
        u.arrays.spacing = smooth ? float(one) / core::surface::kAxis : 0.0f;
        try {
            core.call_inside<&core::Scene::build>(inside, u.arrays, tree);
        } catch (const Error& e) {
            whole =
                was_whole && !changed && e.code() == ErrorCode::invalid;  // then it was refused before anything changed
            throw;
        }
        changed = true;
        whole = false;
    };
    const float* positions = u.arrays.positions.device == core::kHost ? u.arrays.positions.data : nullptr;
    if (u.measured) {
        build(0);
        found = core::measured_spacing(core, inside, positions, u.arrays.n, smooth);
        const double spacings = smooth ? double(core::surface::kAxis) : defaults_of(kernel).spacings;
        const double support_found = spacings * (found > 0 ? found : 1);
        if (support_found > kMaxSupport) refuse("support", "at most " + text(kMaxSupport), text(support_found));
        u.one_support = support_found;
    }
    build(u.one_support.value_or(1.0));
    if (found > 0 && u.arrays.n > kDozen) measured_support = *u.one_support;
    few_or_flat.clear();
    if (positions && (u.arrays.n < core::kFewParticles || core::axes_of(positions, u.arrays.n).size() < 3))
        few_or_flat.assign(positions, positions + 3 * u.arrays.n);
    held = std::move(u.inputs);
    n = u.arrays.n;
    support = u.one_support.value_or(0);
    largest_support = u.one_support.value_or(u.largest_support);
    whole = true;
}

Scene::Scene(const SceneOptions& o) : impl_(std::make_shared<Impl>()) {
    if (int(o.kernel) < 0 || int(o.kernel) > int(Kernel::solid))
        refuse("kernel", "one of the seven", std::to_string(int(o.kernel)));
    const bool dense = o.octree == OctreeKind::dense;
    if (o.key_bits != 32 && o.key_bits != 64) refuse("key_bits", "32 or 64", std::to_string(o.key_bits));
    if (dense && o.key_bits != 32) refuse("key_bits", "32, which the dense octree uses", "64");
    const int deepest = dense ? 8 : o.key_bits == 32 ? 10 : 21;
    impl_->kernel = core::KernelName(o.kernel);
    impl_->smooth = o.surface == Surface::smooth;
    if (impl_->smooth && (o.kernel != Kernel::murakami || dense || o.support))
        refuse("surface", "the kernel murakami, the sparse octree and no support with a smooth one",
            dense       ? "the dense octree"
            : o.support ? "a support"
                        : "another kernel");
    if (o.spacing && !impl_->smooth) refuse("spacing", "a smooth surface with it", "balls");
    const double by_default = impl_->smooth ? double(core::surface::kThreshold) : defaults_of(impl_->kernel).threshold;
    impl_->threshold = o.threshold ? positive("threshold", *o.threshold) : by_default;
    if (o.spacing) impl_->measured_support = core::surface::kAxis * positive("spacing", *o.spacing);
    core::TreeRequest& tree = impl_->tree;
    tree.key_bits = o.key_bits;
    tree.depth = whole("level", o.level.value_or(dense ? 6 : deepest), 0, deepest);
    tree.dense = dense;
    tree.typical_support = number("typical_support", o.typical_support, 0);
    tree.most_weight = number("most_weight", o.most_weight, 0);
    if (o.bounds) {
        tree.fixed_space = true;
        tree.lo = three("bounds.low", o.bounds->low);
        tree.hi = three("bounds.high", o.bounds->high);
        if (tree.lo.x > tree.hi.x || tree.lo.y > tree.hi.y || tree.lo.z > tree.hi.z)
            refuse("bounds", "low not above high", text(o.bounds->low) + " and " + text(o.bounds->high));
    }
    if (o.support) impl_->own_support = positive("support", *o.support);
    const int threads = globule::whole("threads", o.threads, 0, 4096);
    impl_->chosen = choose(o.device);
    impl_->core = core::make_scene(*impl_->chosen.backend, impl_->chosen.index, threads, o.poll);
}
Scene::Scene(const Particles& particles, const SceneOptions& options) : Scene(options) { impl_->update(particles); }

void Scene::update(const Particles& particles) { Inside::shared(*this)->update(particles); }

Frame Scene::render(
    const Camera& camera, int width, int height, const RenderSettings& settings, const std::vector<Clip>& clips) const {
    return globule::render({Layer{.scene = *this}}, camera, width, height, settings, clips);
}

void Scene::field(const ArrayView& points, const MutableArrayView& out) const {
    const Impl& s = Inside::of(*this, "scene");
    Inputs in(s.core.device());
    std::size_t m;
    const core::FloatArray p = in.rows("points", points, 3, m);
    Output result("out", out, DType::float32, m);
    s.ask<&core::Scene::evaluate>(s.field(), m, p, result.as<float>(), static_cast<float*>(nullptr));
    result.deliver();
}
void Scene::gradient(const ArrayView& points, const MutableArrayView& out) const {
    const Impl& s = Inside::of(*this, "scene");
    Inputs in(s.core.device());
    std::size_t m;
    const core::FloatArray p = in.rows("points", points, 3, m);
    Output result("out", out, DType::float32, 3 * m);
    s.ask<&core::Scene::evaluate>(s.field(), m, p, static_cast<float*>(nullptr), result.as<float>());
    result.deliver();
}
namespace {
/// Values of particles, a row each.
struct Rows {
    core::FloatArray data;
    std::size_t n, channels;
};
std::size_t channels_of(const ArrayView& values) {
    const Shape& shape = values.shape();
    if (shape.rank() < 1 || shape.rank() > 2 || (shape.rank() == 2 && (shape[1] < 1 || shape[1] > 1024)))
        refuse("values", "shape (N,) or (N, K)", text(shape));
    return shape.rank() == 2 ? shape[1] : 1;
}
Rows rows_of_values(Inputs& in, const ArrayView& values) {
    const std::size_t channels = channels_of(values), n = values.shape()[0];
    return {in.floats("values", values, channels, n), n, channels};
}
}  // namespace

void Scene::blend(const ArrayView& points, const ArrayView& values, const MutableArrayView& out) const {
    const Impl& s = Inside::of(*this, "scene");
    Inputs in(s.core.device());
    std::size_t m;
    const core::FloatArray p = in.rows("points", points, 3, m);
    const Rows v = rows_of_values(in, values);
    Output result("out", out, DType::float32, v.channels * m);
    s.ask<&core::Scene::blend>(s.field(), m, p, v.data, v.n, int(v.channels), result.as<float>());
    result.deliver();
}
void Scene::integrate(
    const ArrayView& origins, const ArrayView& directions, const ArrayView& values, const MutableArrayView& out) const {
    const Impl& s = Inside::of(*this, "scene");
    Inputs in(s.core.device());
    std::size_t m;
    const core::FloatArray o = in.rows("origins", origins, 3, m), d = in.floats("directions", directions, 3, m);
    const Rows v = rows_of_values(in, values);
    Output result("out", out, DType::float32, v.channels * m);
    s.ask<&core::Scene::integrate>(s.field(), m, o, d, v.data, v.n, int(v.channels), result.as<float>());
    result.deliver();
}
Neighbors Scene::neighbors(const ArrayView& points, double radius) const {
    const Impl& s = Inside::of(*this, "scene");
    Inputs in(s.core.device());
    std::size_t m;
    const core::FloatArray p = in.rows("points", points, 3, m);
    return s.ask<&core::Scene::neighbors>(m, p, float(positive("radius", radius)));
}
std::size_t Scene::neighbors(
    const ArrayView& points, double radius, const MutableArrayView& offsets, const MutableArrayView& indices) const {
    const Neighbors found = neighbors(points, radius);
    const std::size_t n = found.indices.size();
    Output ends("offsets", offsets, DType::uint64, found.offsets.size());
    std::ranges::copy(found.offsets, ends.as<std::uint64_t>());
    ends.deliver();
    if (n > indices.shape().size()) return n;
    Output all("indices", {indices.data(), indices.dtype(), Shape(n), indices.where()}, DType::uint32, n);
    std::ranges::copy(found.indices, all.as<std::uint32_t>());
    all.deliver();
    return n;
}
void Scene::intersect(const ArrayView& origins, const ArrayView& directions, const MutableArrayView& distance,
    const MutableArrayView& normal, const MutableArrayView& albedo) const {
    const Impl& s = Inside::of(*this, "scene");
    Inputs in(s.core.device());
    std::size_t m;
    const core::FloatArray o = in.rows("origins", origins, 3, m);
    core::FloatArray d = in.floats("directions", directions, 3, m);
    std::vector<float> unit;  // of a GPU's arrays only the GPU could tell
    if (d.device == core::kHost && m) {
        unit.assign(d.data, d.data + 3 * m);
        d.data = unit.data();
    }
    for (std::size_t i = 0; 3 * i < unit.size(); ++i) {
        float* v = &unit[3 * i];
        const double length = std::sqrt(double(v[0]) * v[0] + double(v[1]) * v[1] + double(v[2]) * v[2]);
        if (!std::isfinite(length) || length == 0) std::fill_n(v, 3, NAN);  // a ray that meets nothing
        else if (std::abs(length - 1) > 5e-4)
            refuse("directions", "unit vectors", "length " + text(length) + " (ray " + std::to_string(i) + ")");
    }
    Output t("distance", distance, DType::float32, m), n("normal", normal, DType::float32, 3 * m),
        a("albedo", albedo, DType::float32, 3 * m);
    s.ask<&core::Scene::intersect>(s.field(), m, o, d, t.as<float>(), n.as<float>(), a.as<float>());
    for (const Output* result : {&t, &n, &a}) result->deliver();
}

std::vector<float> Scene::field(const ArrayView& points) const {
    std::vector<float> out(rows_of("points", points, 3));
    return field(points, out), out;
}
std::vector<float> Scene::gradient(const ArrayView& points) const {
    std::vector<float> out(3 * rows_of("points", points, 3));
    return gradient(points, out), out;
}
std::vector<float> Scene::blend(const ArrayView& points, const ArrayView& values) const {
    std::vector<float> out(channels_of(values) * rows_of("points", points, 3));
    return blend(points, values, out), out;
}
std::vector<float> Scene::integrate(
    const ArrayView& origins, const ArrayView& directions, const ArrayView& values) const {
    std::vector<float> out(channels_of(values) * rows_of("origins", origins, 3));
    return integrate(origins, directions, values, out), out;
}
Intersections Scene::intersect(const ArrayView& origins, const ArrayView& directions) const {
    const std::size_t m = rows_of("origins", origins, 3);
    Intersections out{std::vector<float>(m), std::vector<float>(3 * m), std::vector<float>(3 * m)};
    return intersect(origins, directions, out.distance, out.normal, out.albedo), out;
}

double Scene::spacing() const {
    const Impl& s = Inside::of(*this, "scene");
    const core::Gates inside = s.gates();
    s.check_whole();
    if (s.smooth && s.measured_support > 0) return s.measured_support / core::surface::kAxis;
    const float* positions = s.few_or_flat.empty() ? nullptr : s.few_or_flat.data();
    return core::measured_spacing(s.core, inside, positions, s.few_or_flat.size() / 3, s.smooth);
}
OctreeFacts Scene::octree(bool with_hashes) const {
    const core::TreeFacts f = Inside::of(*this, "scene").ask<&core::Scene::facts>(with_hashes);
    OctreeFacts out;
    out.n_nodes = f.n_nodes;
    out.n_leaves = f.n_leaves;
    out.n_inside = f.n_inside;
    out.level = f.header.deepest;
    out.bytes = f.bytes;
    out.low = {f.header.space.lo.x, f.header.space.lo.y, f.header.space.lo.z};
    out.extent = f.header.space.extent;
    out.build_seconds = f.build_seconds;
    out.typical_support = f.header.typical_support;
    out.most_weight = f.header.most_weight;
    if (with_hashes) out.key_hash = f.key_hash, out.node_hash = f.node_hash;
    return out;
}
void Scene::sorted_keys(std::vector<std::uint64_t>& keys, std::vector<std::uint32_t>& index) const {
    const Impl& s = Inside::of(*this, "scene");
    const core::Gates inside = s.gates();
    s.check_whole();
    const std::size_t n = s.size();
    std::vector<std::uint64_t> k(n);
    std::vector<std::uint32_t> i(n);
    s.core.call_inside<&core::Scene::sorted>(inside, k.data(), i.data());
    keys = std::move(k);
    index = std::move(i);
}

std::size_t Scene::size() const {
    const Impl& s = Inside::of(*this, "scene");
    const core::Gates inside = s.gates();
    return s.size();
}
double Scene::threshold() const { return Inside::of(*this, "scene").threshold; }
double Scene::support() const {
    const Impl& s = Inside::of(*this, "scene");
    const core::Gates inside = s.gates();
    return s.support;
}
double Scene::margin() const {
    const Impl& s = Inside::of(*this, "scene");
    const core::Gates inside = s.gates();
    double largest = s.largest_support;
    if (!(largest > 0) && s.size() > 0) {
        s.check_whole();
        largest = s.core.call_inside<&core::Scene::facts>(inside, false).header.typical_support;
    }
    return defaults_of(s.kernel).reach * largest;
}
const std::string& Scene::device() const { return Inside::of(*this, "scene").chosen.device.name; }

void Scene::cancel() const noexcept {
    if (impl_) impl_->core.object()->cancel();
}
void Scene::synchronize() const { Inside::of(*this, "scene").core.call<&core::Scene::synchronize>(); }

namespace {

/// The picture's next samples; its scenes are locked.
std::shared_ptr<const Inside::FrameImpl> trace(
    Inside::FrameImpl f, const core::Gates& inside, int samples, const core::Handle<core::Frame>& before) {
    f.request.passes = samples;
    const core::Handle<core::Scene>& first = f.scenes[0]->core;
    f.core = {first.backend(), first.call_inside<&core::Scene::render>(inside, f.request, before.object()), nullptr};
    return std::make_shared<const Inside::FrameImpl>(std::move(f));
}
core::Gates gates_of(const Inside::FrameImpl& f) {
    std::vector<core::Gate*> gates;
    for (const auto& scene : f.scenes) gates.push_back(scene->core.gate().get());
    return core::Gates(std::move(gates));
}

}  // namespace

Frame render(const std::vector<Layer>& layers, const Camera& camera, int width, int height,
    const RenderSettings& settings, const std::vector<Clip>& clips) {
    if (layers.empty() || layers.size() > core::kMaxLayers)
        refuse("layers", "1 to " + std::to_string(core::kMaxLayers), std::to_string(layers.size()));
    const Look seen = look(settings);
    Inside::FrameImpl f;
    f.request.camera = rays(camera, width, height);
    f.request.lighting = seen.lighting;
    f.request.sky_image = seen.sky_image;
    f.request.sky_id = seen.sky_id;
    if (const auto* environment = std::get_if<Environment>(&settings.sky))
        f.sky = std::make_shared<const Environment>(*environment);
    f.width = width;
    f.height = height;
    for (const Layer& layer : layers) {
        if (layer.scene && layer.mesh) refuse("layers", "a scene or a mesh in each", "both");
        const auto& scene = layer.mesh ? Inside::shared(layer.mesh)->scene : Inside::shared(layer.scene);
        if (!f.scenes.empty() &&
            (scene->chosen.backend != f.scenes[0]->chosen.backend || scene->chosen.index != f.scenes[0]->chosen.index))
            refuse("layers", "all on " + f.scenes[0]->chosen.device.name, scene->chosen.device.name);
        f.request.lighting.materials[f.request.layers.size()] =
            material(layer.material ? *layer.material : settings.material, seen);
        core::LayerRequest request{scene->core.object().get(), scene->field(), {}};
        for (const auto* list : {&layer.clips, &clips})
            for (const Clip& c : *list) request.clips.push_back(clip(c));
        f.request.layers.push_back(std::move(request));
        f.scenes.push_back(scene);
    }
    const int samples = whole("samples", settings.samples, 1, kMaxSamples);
    f.device = f.scenes[0]->chosen.device.name;
    f.device_number = f.scenes[0]->core.device();
    const core::Gates inside = gates_of(f);
    for (const auto& scene : f.scenes) scene->check_whole();
    const bool smooth = std::ranges::any_of(f.scenes, [](const auto& scene) { return scene->smooth; });
    if (!settings.edge_samples && smooth) f.request.lighting.edge_samples = kSmoothEdges;
    if (settings.ambient_rays && !settings.ambient_distance)
        f.request.lighting.ambient_distance = float(0.1 * f.scenes[0]->core.call_inside<&core::Scene::extent>(inside));
    return Inside::frame(trace(std::move(f), inside, samples, {}));
}

Frame Frame::refine(int samples) const {
    const Impl& f = Inside::of(*this, "frame");
    whole("samples", samples, 1, kMaxSamples);
    if (f.core.read<&core::Frame::passes>() + samples > kMaxSamples)
        refuse("samples", "at most " + std::to_string(kMaxSamples) + " in all", std::to_string(samples) + " more");
    const core::Gates inside = gates_of(f);
    for (const auto& scene : f.scenes) scene->check_whole();
    return Inside::frame(trace(f, inside, samples, f.core));
}

}  // namespace globule
