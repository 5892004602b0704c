"""One function a program: surface and image of particles, for surfaces.py.

Each takes a case (positions, spacing, camera) and the image's path, and returns CPU seconds of the
surface and of the image, peak memory in MiB, the volume over N · spacing³, and the gauge: mean and
largest distance of a flat pool's face from the truth, in spacings. Meshes of programs without a
renderer of their own are drawn by PyVista.
"""

from __future__ import annotations

import contextlib
import resource
import sys
import time

import numpy as np

COLOR = (0.25, 0.52, 0.80)  # sRGB; globule takes it linear
MARGIN = 10  # spacings from the pool's walls where the gauge does not look
PACKAGES = {
    "globule": ["globule"],
    "splashsurf": ["pysplashsurf", "pyvista"],
    "OVITO": ["ovito"],
    "PyVista": ["pyvista"],
    "Newton": ["newton", "warp", "pyvista"],
}


def globule(case, picture: str) -> dict:
    import globule as gb

    x, spacing = case["positions"], float(case["spacing"])
    camera = gb.Camera(*(tuple(case[k].tolist()) for k in ("eye", "look_at", "up")), float(case["fov"]))
    begin = time.process_time()
    scene = gb.Scene(gb.Particles(x, color=tuple(c**2.2 for c in COLOR)), surface="smooth")
    built = time.process_time()
    gb.render(scene, camera, tuple(case["size"].tolist()), {"background": (1, 1, 1)}).save(picture)
    drawn = time.process_time()
    memory = peak()
    mesh = gb.measure.mesh_surface(scene, 0.5 * spacing)  # to measure the volume: the image needs none
    found = result(case, built - begin, drawn - built, mesh.vertices, mesh.faces)
    return {**found, "memory": memory}


def splashsurf_mesh(positions, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and normals, by the settings that its README recommends."""
    import pysplashsurf

    with contextlib.redirect_stdout(sys.stderr):
        found = pysplashsurf.reconstruction_pipeline(
            np.asarray(positions, np.float64),
            particle_radius=0.5 * spacing,
            smoothing_length=2.0,
            cube_size=0.5,
            iso_surface_threshold=0.6,
            mesh_cleanup=True,
            mesh_smoothing_weights=True,
            mesh_smoothing_iters=25,
            compute_normals=True,
            normals_smoothing_iters=10,
        )
    mesh = found[0]
    normals = np.asarray(mesh.point_attributes["normals"])
    return np.asarray(mesh.mesh.vertices), np.asarray(mesh.mesh.triangles), normals


def splashsurf(case, picture: str) -> dict:
    import pyvista  # noqa: F401, not part of the time

    begin = time.process_time()
    vertices, faces, normals = splashsurf_mesh(case["positions"], float(case["spacing"]))
    built = time.process_time()
    draw_mesh(case, vertices, faces, normals, picture)
    return result(case, built - begin, time.process_time() - built, vertices, faces)


def ovito_pipeline(positions, radius, cell: float):
    """A pipeline with the surface of a Gaussian density, cells of edge `cell`."""
    from ovito.data import DataCollection, Particles, SimulationCell
    from ovito.modifiers import ConstructSurfaceModifier
    from ovito.pipeline import Pipeline, StaticSource

    x, margin = np.asarray(positions, np.float64), 4 * np.max(radius)
    lo, extent = x.min(0) - margin, np.ptp(x, axis=0) + 2 * margin
    data = DataCollection()
    box = SimulationCell(pbc=(False, False, False))
    box[...] = np.c_[np.diag(extent), lo]
    box.vis.enabled = False
    data.objects.append(box)
    particles = Particles()
    particles.create_property("Position", data=x)
    particles.create_property("Radius", data=np.broadcast_to(radius, len(x)).astype(np.float64))
    particles.vis.enabled = False
    data.objects.append(particles)
    pipeline = Pipeline(source=StaticSource(data=data))
    modifier = ConstructSurfaceModifier(method=ConstructSurfaceModifier.Method.GaussianDensity)
    modifier.grid_resolution = int(np.ceil(extent.max() / cell))
    modifier.vis.surface_color, modifier.vis.show_cap = COLOR, False
    pipeline.modifiers.append(modifier)
    return pipeline


def ovito_view(eye, target, up, fov: float):
    from ovito.vis import Viewport

    view = Viewport(type=Viewport.Type.Perspective, fov=np.radians(fov))
    view.camera_pos, view.camera_up = eye, up
    view.camera_dir = np.subtract(target, eye)
    return view


def ovito(case, picture: str) -> dict:
    """A Gaussian density with cells of half a spacing, drawn by OVITO's Tachyon, with
    its light from the camera alone, as the others have it."""
    from ovito.vis import TachyonRenderer

    spacing = float(case["spacing"])
    begin = time.process_time()
    pipeline = ovito_pipeline(case["positions"], 0.5 * spacing, 0.5 * spacing)
    surface = pipeline.compute().surfaces["surface"]
    built = time.process_time()
    pipeline.add_to_scene()
    view = ovito_view(case["eye"], case["look_at"], case["up"], float(case["fov"]))
    tachyon = TachyonRenderer(ambient_occlusion=False, shadows=False, antialiasing_samples=4)
    size = tuple(case["size"].tolist())
    view.render_image(size, filename=picture, background=(1, 1, 1), renderer=tachyon)
    drawn = time.process_time()
    return result(case, built - begin, drawn - built, surface.get_vertices(), surface.get_faces())


def pyvista(case, picture: str) -> dict:
    """The particles as spheres: PyVista makes no surface of its own that fits a fluid."""
    import pyvista as pv

    def spheres(plotter: pv.Plotter) -> None:
        plotter.add_points(
            case["positions"], style="points_gaussian", render_points_as_spheres=True, emissive=False, color=COLOR
        ).mapper.scale_factor = 0.5 * float(case["spacing"])

    begin = time.process_time()
    draw(case, spheres, picture)
    return result(case, 0.0, time.process_time() - begin)


def newton_surface(spacing: float):
    """A function of positions that returns vertices, triangles and normals: anisotropic kernels,
    voxels of half a spacing; on the GPU where there is one."""
    import warp as wp
    from newton.geometry import ParticleSurface

    wp.config.quiet = True
    make = ParticleSurface(0.5 * spacing, kernel_radius=3 * spacing, anisotropic=True)

    def mesh(positions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = wp.array(positions, dtype=wp.vec3)
        radii = wp.array(np.full(len(x), 0.5 * spacing, np.float32))
        vertices, indices, normals = (a.numpy() for a in make.extract(x, radii).to_arrays())
        return vertices, indices.reshape(-1, 3), normals

    return mesh


def newton(case, picture: str) -> dict:
    import pyvista  # noqa: F401, not part of the time

    mesh = newton_surface(float(case["spacing"]))
    mesh(case["positions"])  # compiles its kernels
    begin = time.process_time()
    vertices, faces, normals = mesh(case["positions"])
    built = time.process_time()
    draw_mesh(case, vertices, faces, normals, picture)
    return result(case, built - begin, time.process_time() - built, vertices, faces)


PEERS = {"globule": globule, "splashsurf": splashsurf, "OVITO": ovito, "PyVista": pyvista, "Newton": newton}


def draw(case, add, picture: str) -> None:
    import pyvista as pv

    plotter = pv.Plotter(off_screen=True, window_size=case["size"].tolist())
    plotter.set_background("white")
    add(plotter)
    plotter.camera.position, plotter.camera.focal_point = case["eye"], case["look_at"]
    plotter.camera.up, plotter.camera.view_angle = case["up"], float(case["fov"])
    plotter.reset_camera_clipping_range()
    plotter.enable_anti_aliasing("ssaa")
    plotter.screenshot(picture)
    plotter.close()


def draw_mesh(case, vertices, faces, normals, picture: str) -> None:
    import pyvista as pv

    mesh = pv.PolyData(vertices, np.c_[np.full(len(faces), 3), faces].ravel().astype(np.int64))
    mesh.point_data.active_normals = np.asarray(normals, np.float32)
    draw(case, lambda p: p.add_mesh(mesh, color=COLOR, smooth_shading=True, specular=0.3), picture)


def peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # KiB on Linux


def result(case, surface: float, image: float, vertices=None, faces=None) -> dict:
    found = {"surface": surface, "image": image, "memory": peak(), "volume": None, "gauge": None}
    if vertices is None:
        return found
    x, spacing = case["positions"], float(case["spacing"])
    v = np.asarray(vertices, np.float64) - x.mean(axis=0)
    a, b, c = (v[np.asarray(faces)[:, k]] for k in range(3))
    volume = abs(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
    found["volume"] = volume / (len(x) * spacing**3)
    if case["pool"]:
        lo, hi = x.min(0), x.max(0)
        inside = ((vertices > lo + MARGIN) & (vertices < hi - MARGIN))[:, [0, 2]].all(axis=1)
        top = vertices[inside & (vertices[:, 1] > 0.5 * (lo + hi)[1]), 1] - (hi[1] + 0.5)
        found["gauge"] = (float(top.mean() / spacing), float(np.abs(top).max() / spacing))
    return found
