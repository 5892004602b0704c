#include "globule/mesh.hpp"

#include <cmath>
#include <numbers>

#include "api/impl.hpp"

namespace globule {
namespace {

constexpr core::float3 kGray{0.62f, 0.62f, 0.62f};
constexpr std::size_t kMaxFaces = (std::size_t(1) << 29) - 1;

std::vector<std::uint32_t> faces_of(const ArrayView& view, std::size_t n_vertices) {
    const std::size_t n = rows_of("faces", view, 3);
    if (n > kMaxFaces) refuse("faces", "at most " + std::to_string(kMaxFaces), std::to_string(n));
    if (view.where().device != Location::host) refuse("faces", "host memory", "memory of a GPU");
    if (view.dtype() != DType::uint32 && view.dtype() != DType::int32)
        refuse("faces", "uint32 or int32", name_of(view.dtype()));
    if (n && !view.data()) refuse("faces", "an address", "null");
    const auto* from = static_cast<const std::uint32_t*>(view.data());  // a negative number is a very large one
    std::vector<std::uint32_t> faces(from, from + 3 * n);
    for (const std::uint32_t v : faces)
        if (v >= n_vertices)
            refuse("faces", "numbers of vertices below " + std::to_string(n_vertices), std::to_string(std::int32_t(v)));
    return faces;
}

}  // namespace

/// Throws without a change where the vertices cannot be used.
void Mesh::Impl::build(const core::FloatArray& vertices) {
    core::MeshArrays a;
    a.n_vertices = n_vertices;
    a.n_faces = held->faces.size() / 3;
    a.vertices = vertices;
    a.faces = {held->faces.data()};
    a.color = color;
    a.one_color = one_color;
    a.closed = options.solid;
    if (!held->order.empty()) {
        a.place_of_corner = {held->faces.data()};
        a.corners = {held->order.data()};
        a.corners_begin = {held->begins.data()};
        a.n_places = n_vertices;
        a.smooth_cosine = float(std::cos(options.smooth * std::numbers::pi / 180));
    }
    const core::Gates inside = scene->gates();
    scene->whole = false;
    scene->core.call_inside<&core::Scene::build_mesh>(inside, a);
    scene->whole = true;
}

Mesh::Mesh(const Triangles& t, const MeshOptions& o) : impl_(std::make_shared<Impl>()) {
    Impl& m = *impl_;
    m.options = o;
    number("smooth", o.smooth, 0, 180);
    const int threads = whole("threads", o.threads, 0, 4096);
    m.scene = std::make_shared<Inside::SceneImpl>();
    m.scene->chosen = choose(o.device);
    m.scene->core = core::make_scene(*m.scene->chosen.backend, m.scene->chosen.index, threads, nullptr);
    const int device = m.scene->core.device();
    const auto held = std::make_shared<Impl::Held>(Impl::Held{{}, {}, {}, Inputs(device)});
    Inputs inputs(device);
    const core::FloatArray vertices = inputs.rows("vertices", t.vertices, 3, m.n_vertices);
    check_range("vertices", vertices, m.n_vertices, 3, -1e18, 1e18);
    held->faces = faces_of(t.faces, m.n_vertices);
    m.one_color = t.color.one() ? three("color", *t.color.one(), 0, 1) : kGray;
    if (t.color.each().given()) {
        const core::FloatArray given = held->inputs.floats("color", t.color.each(), 3, m.n_vertices);
        check_range("color", given, m.n_vertices, 3, 0, 1);
        m.color = given.device == core::kHost ? held->inputs.keep({given.data, given.data + 3 * m.n_vertices}) : given;
    }
    if (o.smooth > 0 && !held->faces.empty()) {  // corners by vertex
        held->begins.assign(m.n_vertices + 1, 0);
        for (const std::uint32_t v : held->faces) ++held->begins[v + 1];
        for (std::size_t v = 0; v < m.n_vertices; ++v) held->begins[v + 1] += held->begins[v];
        std::vector<std::uint32_t> next(held->begins.begin(), held->begins.end() - 1);
        held->order.resize(held->faces.size());
        for (std::size_t k = 0; k < held->faces.size(); ++k) held->order[next[held->faces[k]]++] = std::uint32_t(k);
    }
    m.held = held;
    m.scene->held = held;
    m.build(vertices);
}

void Mesh::update(const ArrayView& vertices) {
    Impl& m = *Inside::shared(*this);
    Inputs inputs(m.scene->core.device());
    const core::FloatArray from = inputs.floats("vertices", vertices, 3, m.n_vertices);
    check_range("vertices", from, m.n_vertices, 3, -1e18, 1e18);
    m.build(from);
}

void Mesh::place(const Matrix4& p) {
    const Impl& m = Inside::of(*this, "mesh");
    const Vec3 x{p[0], p[1], p[2]}, y{p[4], p[5], p[6]}, z{p[8], p[9], p[10]};
    double off = std::abs(norm(x) - 1);
    for (const double e : {norm(y) - 1, norm(z) - 1, dot(x, y), dot(y, z), dot(z, x), dot(cross(x, y), z) - 1, p[12],
             p[13], p[14], p[15] - 1})
        off = std::max(off, std::abs(e));
    if (!(off < 1e-3))
        refuse("world_from_mesh", "a rotation and a translation; change the vertices for any other map", "another");
    const core::float3 at = three("world_from_mesh", {p[3], p[7], p[11]});
    m.scene->core.call<&core::Scene::place_mesh>(core::Pose{single(x), single(y), single(z), at});
}

std::size_t Mesh::size() const { return Inside::of(*this, "mesh").held->faces.size() / 3; }
const std::string& Mesh::device() const { return Inside::of(*this, "mesh").scene->chosen.device.name; }

}  // namespace globule
