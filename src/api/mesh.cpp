#include "globule/mesh.hpp"

#include <cmath>
#include <numbers>

#include "api/impl.hpp"

namespace globule {
namespace {

constexpr core::float3 kGray{0.62f, 0.62f, 0.62f};
constexpr std::size_t kMaxFaces = (std::size_t(1) << 29) - 1;

std::vector<std::uint32_t> faces_of(
    const char* name, const ArrayView& view, std::size_t corners, std::size_t n_vertices) {
    const std::size_t n = rows_of(name, view, corners);
    if (n > kMaxFaces) refuse(name, "at most " + std::to_string(kMaxFaces), std::to_string(n));
    if (view.where().device != Location::host) refuse(name, "host memory", "memory of a GPU");
    if (view.dtype() != DType::uint32 && view.dtype() != DType::int32)
        refuse(name, "uint32 or int32", name_of(view.dtype()));
    if (n && !view.data()) refuse(name, "an address", "null");
    const auto* from = static_cast<const std::uint32_t*>(view.data());  // a negative number is a very large one
    std::vector<std::uint32_t> faces(from, from + corners * n);
    for (const std::uint32_t v : faces)
        if (v >= n_vertices)
            refuse(name, "numbers of vertices below " + std::to_string(n_vertices), std::to_string(std::int32_t(v)));
    return faces;
}

}  // namespace

/// Throws without a change where the vertices cannot be used.
void Mesh::Impl::build(const core::FloatArray& vertices) {
    core::MeshArrays a;
    a.n_vertices = n_vertices;
    a.n_faces = held->faces.size() / corners;
    a.vertices = vertices;
    a.faces = {held->faces.data()};
    a.color = color;
    a.one_color = one_color;
    a.closed = options.solid;
    a.capsules = corners == 2;
    if (!held->radius.empty()) a.radius = {held->radius.data()};
    a.one_radius = one_radius;
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

void Mesh::Impl::make(const ArrayView& vertex_view, const ArrayView& faces, const char* name, const Colors& colors,
    const Scalars& radius) {
    const MeshOptions& o = options;
    number("smooth", o.smooth, 0, 180);
    const int threads = whole("threads", o.threads, 0, 4096);
    scene = std::make_shared<Inside::SceneImpl>();
    scene->chosen = choose(o.device);
    scene->core = core::make_scene(*scene->chosen.backend, scene->chosen.index, threads, o.poll);
    const int device = scene->core.device();
    const auto made = std::make_shared<Held>(Held{{}, {}, {}, {}, Inputs(device)});
    Inputs inputs(device);
    const core::FloatArray vertices = inputs.rows("vertices", vertex_view, 3, n_vertices);
    check_range("vertices", vertices, n_vertices, 3, -1e18, 1e18);
    made->faces = faces_of(name, faces, corners, n_vertices);
    one_color = colors.one() ? three("color", *colors.one(), 0, 1) : kGray;
    if (colors.each().given()) {
        const core::FloatArray given = made->inputs.floats("color", colors.each(), 3, n_vertices);
        check_range("color", given, n_vertices, 3, 0, 1);
        color = given.device == core::kHost ? made->inputs.keep({given.data, given.data + 3 * n_vertices}) : given;
    }
    if (corners == 2) {
        const std::size_t n = made->faces.size() / 2;
        if (radius.each().given()) {
            if (radius.each().where().device != Location::host) refuse("radius", "host memory", "memory of a GPU");
            const core::FloatArray given = inputs.floats("radius", radius.each(), 1, n);
            check_range("radius", given, n, 1, 1e-30, 1e18);
            made->radius.assign(given.data, given.data + n);
        } else {
            if (!radius.one()) refuse("radius", "one for all, or one each", "none");
            one_radius = float(positive("radius", *radius.one()));
        }
    } else if (o.smooth > 0 && !made->faces.empty()) {  // corners by vertex
        made->begins.assign(n_vertices + 1, 0);
        for (const std::uint32_t v : made->faces) ++made->begins[v + 1];
        for (std::size_t v = 0; v < n_vertices; ++v) made->begins[v + 1] += made->begins[v];
        std::vector<std::uint32_t> next(made->begins.begin(), made->begins.end() - 1);
        made->order.resize(made->faces.size());
        for (std::size_t k = 0; k < made->faces.size(); ++k) made->order[next[made->faces[k]]++] = std::uint32_t(k);
    }
    held = made;
    scene->held = made;
    build(vertices);
}

Mesh::Mesh(const Triangles& t, const MeshOptions& o) : impl_(std::make_shared<Impl>()) {
    impl_->options = o;
    impl_->make(t.vertices, t.faces, "faces", t.color, {});
}
Mesh::Mesh(const Capsules& c, const MeshOptions& o) : impl_(std::make_shared<Impl>()) {
    impl_->options = o;
    impl_->corners = 2;
    impl_->make(c.vertices, c.ends, "ends", c.color, c.radius);
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

std::size_t Mesh::size() const {
    const Impl& m = Inside::of(*this, "mesh");
    return m.held->faces.size() / m.corners;
}
const std::string& Mesh::device() const { return Inside::of(*this, "mesh").scene->chosen.device.name; }

}  // namespace globule
