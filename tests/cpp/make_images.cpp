// Makes what tests/test_cpp.py compares with Python, byte for byte:   make_images POSITIONS.raw SWEEP.raw FOLDER
// POSITIONS: (N, 3) float32; SWEEP: (24, 40, 48) uint8, with the poses that `pose` says.
#include <globule/globule.hpp>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>

using namespace globule;

namespace {

std::string folder;

template <class T> void save(const std::string& name, const std::vector<T>& values) {
    std::ofstream file(folder + "/" + name, std::ios::binary);
    file.write(reinterpret_cast<const char*>(values.data()), std::streamsize(values.size() * sizeof(T)));
}
std::vector<char> load(const char* path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
}
void save(const std::string& name, const Volume& v) {
    std::vector<std::uint8_t> both = v.bytes;
    both.insert(both.end(), v.radius.begin(), v.radius.end());
    save(name, both);
    save(name + ".matrix", std::vector<double>(v.world_from_voxel.begin(), v.world_from_voxel.end()));
}

void draw(const std::vector<float>& p) {
    const int w = 160, h = 120;
    const char* kernels[] = {"murakami", "nishimura", "wyvill", "blinn", "cubic_spline", "wendland_c2", "solid"};
    for (int k = 0; k < 7; ++k) {
        const Scene s({.positions = p}, {.kernel = Kernel(k), .key_bits = k % 2 ? 64 : 32, .device = "cpu"});
        const Camera camera = Camera::fit(p, {.width = w, .height = h, .margin = s.margin()});
        const Frame f = s.render(camera, w, h);
        save(std::string("kernel_") + kernels[k], f.image());
        save(std::string("depth_") + kernels[k], f.distance());
    }
    const std::size_t n = p.size() / 3;
    std::vector<float> color, support, weight;
    for (std::size_t i = 0; i < n; ++i) {
        for (int c = 0; c < 3; ++c) color.push_back(float((i + std::size_t(c) * 7) % 32) / 32.0f);
        support.push_back(0.2f + 0.0625f * float(i % 3));
        weight.push_back(i % 5 ? 1.0f : 0.5f);
    }
    const Particles particles{
        .positions = p, .support = support, .weight = weight, .color = color, .reflection = 0.25, .refraction = 0.5};
    const Scene s(particles, {.octree = OctreeKind::dense, .device = "cpu"});
    const Camera flat = Camera::fit(p, {.direction = {-1, 0.5, 0.25},
                                           .up = {0, 0, 1},
                                           .width = w,
                                           .height = h,
                                           .margin = s.margin(),
                                           .orthographic = true});
    save("orthographic", s.render(flat, w, h, {}, {ClipPlane{{1, 0.5, 0}, 0.5}}).image());

    RenderSettings rich;
    rich.lights = {
        DirectionalLight{.direction = {1, 2, 0.5}, .angle = 2}, PointLight{.position = {2, 3, 4}, .radius = 0.25}};
    rich.ambient = std::nullopt;
    rich.sky = Sky{};
    rich.ground = Ground{.height = -0.25, .check = 0.5, .reflection = 0.25};
    rich.shadows = true;
    rich.ambient_rays = 3;
    rich.samples = 2;
    const Camera camera = Camera::fit(p, {.width = w, .height = h});
    const Frame f =
        s.render(camera, w, h, rich, {ClipSphere{{0.5, 0.5, 0.5}, 0.25}, ClipBox{{-9, -9, -9}, {9, 9, 0.75}, true}});
    save("rich", f.image());
    save("rich_refined", f.refine(2).image());
    save("rich_normal", f.normal());

    std::vector<float> image;
    for (int i = 0; i < 8 * 16 * 3; ++i) image.push_back(float(i % 11) / 8.0f);
    Environment environment(ArrayView(image.data(), {8, 16, 3}));
    environment.turn = 30;
    environment.strength = 0.75;
    RenderSettings mirror;
    mirror.sky = environment;
    mirror.material = {.reflection = 0.5, .color = Vec3{0.25, 0.5, 0.75}, .specular = 0.5};
    std::vector<float> shifted = p;
    for (float& v : shifted) v += 0.3f;
    const Scene other({.positions = shifted, .color = {0.75, 0.25, 0.125}}, {.support = 0.25, .device = "cpu"});
    save("layers", render({{s, {}, {ClipPlane{{0, 1, 0}, 0.5}}},
                              {other, Material{.transmission = 0.75, .index = 1.25, .absorption = Vec3{1, 2, 3}}}},
                       camera, w, h, mirror)
                       .image());
}

void simulate() {
    Simulation sim({.spacing = 0.05,
                       .domain = {{0, 0, 0}, {1, 0.75, 0.5}},
                       .periodic = {false, false, true},
                       .gravity = {0, -9.81, 0}},
        {.phases = {{.name = "water", .viscosity = 0.5}, {.name = "oil", .density = 800, .color = {0.75, 0.5, 0.25}}},
            .walls = true,
            .device = "cpu"});
    std::vector<float> water, oil;
    for (int x = 0; x < 6; ++x)
        for (int y = 0; y < 10; ++y)
            for (int z = 0; z < 10; ++z)
                for (const int c : {x, y, z}) (y < 6 ? water : oil).push_back((float(c) + 0.5f) * 0.05f);
    sim.add(water, "water");
    sim.add(oil, "oil", {0.5, 0, 0});
    for (int i = 0; i < 5; ++i) sim.step();
    sim.run(0.05);
    save("sim_positions", sim.positions());
    save("sim_velocities", sim.velocities());
    save("sim_ids", sim.ids());
    save("sim_image", sim.scene().render({.eye = {0.5, 0.5, 2.5}, .look_at = {0.5, 0.25, 0.25}}, 160, 120).image());
}

Matrix4 pose(int f) {
    const double tilt = 0.015625 * f;
    return {0.5, 0, 0, 1, 0, 0.5, 0, 2, tilt, 0.03125, 1, 0.75 * f, 0, 0, 0, 1};
}

void volumes(const std::vector<char>& bytes) {
    const int n = 24, h = 40, w = 48;
    const auto* frames = reinterpret_cast<const std::uint8_t*>(bytes.data());
    std::vector<double> poses;
    for (int f = 0; f < n; ++f) {
        const Matrix4 m = pose(f);
        poses.insert(poses.end(), m.begin(), m.end());
    }
    poses[16 * 5 + 3] = NAN;  // a lost pose
    std::vector<std::uint8_t> mask(std::size_t(h) * w, 1);
    for (int x = 0; x < w; ++x) mask[std::size_t(x)] = mask[std::size_t(3) * w + std::size_t(x)] = 0;
    const Sweep sweep{.frames = ArrayView(frames, {n, h, w}),
        .world_from_image = ArrayView(poses.data(), {n, 4, 4}),
        .mask = ArrayView(mask.data(), {h, w})};
    const char* methods[] = {"pvn-om", "vvn-om", "pvn", "vvn", "bezier", "frames"};
    for (int m = 0; m < 6; ++m)
        save(std::string("volume_") + methods[m],
            reconstruct(sweep, {.method = ReconstructionMethod(m), .spacing = 0.7, .device = "cpu"}));
    const char* compoundings[] = {"mean", "maximum", "latest", "first", "median"};
    for (int c = 0; c < 5; ++c)
        save(std::string("compound_") + compoundings[c],
            reconstruct(sweep,
                {.size = 31, .max_kernel = 5, .compounding = Compounding(c), .max_distance = 1.5, .device = "cpu"}));
    std::vector<float> floats(frames, frames + std::size_t(n) * h * w);
    for (float& v : floats) v = v * 0.37f - 5.0f;
    save("volume_float", reconstruct({.frames = ArrayView(floats.data(), {n, h, w}),
                                         .world_from_image = ArrayView(poses.data(), {n, 4, 4})},
                             {.spacing = 0.6, .region = Box{{2, 3, 1}, {20, 15, 12}}, .device = "cpu"}));
    Reconstructor r({.spacing = 0.7, .mask = mask, .device = "cpu"});
    for (const int f : {12, 3, 20, 8, 0, 23, 16}) {
        const Matrix4 m = pose(f);
        r.add(ArrayView(frames + std::size_t(f) * h * w, {h, w}), ArrayView(m.data(), {4, 4}));
    }
    save("live", r.volume());
}

}  // namespace

int main(int, char** arguments) {
    try {
        const std::vector<char> positions = load(arguments[1]);
        folder = arguments[3];
        const auto* p = reinterpret_cast<const float*>(positions.data());
        draw({p, p + positions.size() / sizeof(float)});
        simulate();
        volumes(load(arguments[2]));
    } catch (const Error& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
}
