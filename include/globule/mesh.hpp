// Triangles and capsules that images show as they are, beside particles.
#pragma once
#include <array>
#include <memory>
#include <optional>
#include <string>

#include "globule/array.hpp"
#include "globule/error.hpp"
#include "globule/particles.hpp"
#include "globule/poll.hpp"
#include "globule/vector.hpp"

namespace globule {

/// Vertices and the triangles between them.  Mesh copies what it needs.
struct Triangles {
    ArrayView
        vertices{};  ///< (N, 3), or flat (3 N,), coordinates of the mesh; float32, in host memory float64 is converted
    ArrayView faces{};  ///< (M, 3), or flat, uint32 or int32 in host memory: vertices of each triangle, all below N
    Colors color{};     ///< (N, 3) linear RGB of the vertices in [0, 1], or one for all; default: gray
};

/// Tubes with round ends: vessels, fibers, instruments.  Mesh copies what it needs.
struct Capsules {
    ArrayView vertices{};  ///< (N, 3), as of triangles
    ArrayView ends{};  ///< (M, 2), or flat, uint32 or int32 in host memory: both ends of each, which may be the same
    Scalars radius{};  ///< (M,), or one for all, coordinates of the mesh, above 0
    Colors color{};    ///< (N, 3) linear RGB of the vertices in [0, 1], or one for all; default: gray
};

struct MeshOptions {
    /// The mesh is closed and its normals point outwards: it refracts, absorbs, shows cut faces and displaces fluids.
    /// Otherwise it is a thin sheet with two sides.  Nothing checks this.
    bool solid = false;
    /// Images blend the normals of triangles that share a vertex and meet at less than this angle, degrees, 0 to 180.
    double smooth = 30;
    std::string device = "auto";  ///< "auto", "cpu", "cuda" or "cuda:N": the device of the image's scenes
    int threads = 0;              ///< of the CPU; 0: all
    Poll* poll = nullptr;
};

/// Triangles or capsules on one device, ready for images: Layer::mesh.  Copies are handles of the same mesh.
///
/// Any thread may call any method.  All methods throw Error: invalid for an argument (nothing was changed), cancelled,
/// memory, device.
class GLOBULE_API Mesh {
public:
    /// An empty handle.
    Mesh() noexcept = default;
    explicit Mesh(const Triangles& triangles, const MeshOptions& options = {});
    explicit Mesh(const Capsules& capsules, const MeshOptions& options = {});
    explicit operator bool() const noexcept { return impl_ != nullptr; }

    /// Other vertices, as many as before; faces, colors and the pose stay, the hierarchy is built anew.
    void update(const ArrayView& vertices);
    /// world_from_mesh of a rotation and a translation, from the next image on; the hierarchy stays.
    void place(const Matrix4& world_from_mesh);

    std::size_t size() const;           ///< triangles, or capsules
    const std::string& device() const;  ///< "cpu" or "cuda:N"

private:
    friend struct Inside;
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

}  // namespace globule
