// How an image is made: lights, materials, sky, ground, clips.  Colors and radiances are linear, 1 = white.
// Limits are checked when an image is rendered.
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <variant>
#include <vector>

#include "globule/array.hpp"
#include "globule/vector.hpp"
#include "globule/version.hpp"

namespace globule {

/// Light from the eye; it casts no visible shadow.
struct Headlight { Vec3 radiance{0.35, 0.35, 0.35}; };
/// Light from far away.
struct DirectionalLight {
    Vec3 direction{-0.4, 1.0, 0.6};  ///< towards the light
    Vec3 radiance{0.75, 0.73, 0.70};
    double angle = 0;  ///< angular diameter, degrees (the sun: 0.53), at most 170; 0: hard shadows
};
/// Light from a ball, without fall-off.
struct PointLight {
    Vec3 position{0, 0, 0};  ///< world
    Vec3 radiance{0.75, 0.75, 0.75};
    double radius = 0;  ///< world; 0: hard shadows
};
using Light = std::variant<Headlight, DirectionalLight, PointLight>;

/// The radiance of rays that hit nothing: a gradient.
struct Sky {
    Vec3 zenith{0.30, 0.48, 0.80};
    Vec3 horizon{0.85, 0.90, 0.95};
    Vec3 ground{0.30, 0.28, 0.26};
    Vec3 up{0, 1, 0};
};

/// A sky from an image; copies of an Environment share it.
class GLOBULE_API Environment {
public:
    /// image: (H, W, 3) linear radiance >= 0, equirectangular, row 0 at the zenith; it is copied.  Throws Error:
    /// invalid.
    explicit Environment(const ArrayView& image);
    // Copies share the image; there is nothing that a move could leave behind.
    Environment(const Environment&) = default;
    Environment& operator=(const Environment&) = default;

    double strength = 1;  ///< factor of the image
    Vec3 up{0, 1, 0};
    double turn = 0;  ///< rotation about up, degrees

    /// Mean radiance over all directions.
    Vec3 mean() const;

    struct Image;
    const Image& image() const { return *image_; }

private:
    std::shared_ptr<const Image> image_;
};

/// A plane under the scene.
struct Ground {
    double height = 0;  ///< where it crosses the normal, world
    Vec3 normal{0, 1, 0};
    Vec3 color{0.75, 0.75, 0.75};
    Vec3 other{0.55, 0.55, 0.55};  ///< of every second field of a checkerboard
    double check = 0;              ///< edge of its fields, world; 0: one color
    double reflection = 0;         ///< [0, 1]
};

/// How a surface splits the light that meets it; an empty optional leaves the value to the particles.
struct Material {
    std::optional<double> reflection{};    ///< specular reflectance at normal incidence, [0, 1]
    std::optional<double> transmission{};  ///< share of the rest that is transmitted, [0, 1]
    std::optional<double> index{};         ///< of refraction, 1 to 4; adds Fresnel's reflection
    std::optional<Vec3> color{};
    std::optional<Vec3>
        absorption{};      ///< per world unit (Beer's law); default: the surface's color filters what enters
    double roughness = 0;  ///< of reflected and refracted directions (GGX), [0, 1]
    std::optional<double> specular{}, shininess{};  ///< highlight of the lights (Blinn-Phong); default: the settings'
};

/// Removes the points x with dot(normal, x) > offset.
struct ClipPlane {
    Vec3 normal{1, 0, 0};
    double offset = 0;
};
/// Removes what lies inside the box, or with keep what lies outside.
struct ClipBox {
    Vec3 low{0, 0, 0}, high{1, 1, 1};
    bool keep = false;
};
/// Removes what lies inside the ball, or with keep what lies outside.
struct ClipSphere {
    Vec3 center{0, 0, 0};
    double radius = 1;
    bool keep = false;
};
using Clip = std::variant<ClipPlane, ClipBox, ClipSphere>;

struct RenderSettings {
    std::vector<Light> lights{Headlight{}, DirectionalLight{}};  ///< up to 8
    std::optional<Vec3> ambient = Vec3{0.16, 0.18, 0.21};        ///< light from everywhere; nullopt: the sky's own
    Vec3 background{0.93, 0.94, 0.96};                           ///< behind the scene, where there is no sky
    Material material{};                                         ///< of every scene that has none of its own
    double specular = 0.22, shininess = 60;                      ///< highlight, where the material says nothing
    double exposure = 1;                                         ///< factor of the image's light
    bool shadows = false;                                        ///< of directional and point lights
    int ambient_rays = 0;                                        ///< per sample, for ambient occlusion; at most 256
    std::optional<double> ambient_distance{};                    ///< their length, world; default: a tenth of the scene
    std::variant<std::monostate, Sky, Environment> sky{};  ///< also seen behind the scene; monostate: the background
    std::optional<Ground> ground{};
    int bounces = 4;           ///< reflected and refracted generations, at most 32
    double cutoff = 1.0 / 32;  ///< a ray with a smaller share of a pixel's light ends in the sky
    int samples = 1;           ///< rays per pixel, at most 65536; the first through its center
    /// More rays, at most 64, for pixels beside a jump of distance, normal or layer (silhouettes, creases), in images
    /// of one sample; with shadows, ambient rays, reflection, transmission, clips, sky, ground or several layers also
    /// beside a jump of color.  Default: 3 where a layer has a smooth surface, else 0.
    std::optional<int> edge_samples{};
};

}  // namespace globule
