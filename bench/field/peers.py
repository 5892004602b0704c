"""One class a program. Each takes a case and an image's size, and answers

    move(positions)  the particles of a frame
    image(camera)    (H, W, 3) uint8, one sample a pixel: what is timed
    judged(camera)   mask (H, W) bool, normals (H, W, 3) or None, at pixel centers: not timed
    surface()        the `Surface` that the program says it draws, or None where it is not written
                     as a sum of kernels

`SETTINGS` of each says what was set; everything else is the program's default. All use as many
threads as they like.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from cases import Case
from judging import Surface

sys.path.insert(0, str(Path(__file__).parents[1] / "peers"))
import surface_peers as shared

LINEAR = tuple(c**2.2 for c in shared.COLOR)
H_SPH = 1.2  # smoothing lengths in spacings, for VTK


class Peer:
    SETTINGS = ""
    PACKAGES: tuple[str, ...] = ()  # modules, with the names to install them by
    INSTALL = ""

    def __init__(self, case: Case, size: tuple[int, int]):
        self.case, self.size, self.positions = case, size, case.positions

    def move(self, positions: np.ndarray) -> None:
        self.positions = positions

    def image(self, camera: Any) -> np.ndarray:
        raise NotImplementedError

    def judged(self, camera: Any) -> tuple[np.ndarray, np.ndarray | None]:
        raise NotImplementedError

    def surface(self) -> Surface | None:
        return None

    @classmethod
    def missing(cls) -> bool:
        return any(importlib.util.find_spec(name) is None for name in cls.PACKAGES)

    @classmethod
    def version(cls) -> str:
        return metadata.version(cls.PACKAGES[0])


class Globule(Peer):
    """Metaballs, the exact intersection for each ray."""

    SETTINGS = 'Scene(surface="balls"): kernel (1 - r²/R²)², R = two spacings, threshold 0.6; no edge samples'
    PACKAGES, INSTALL = ("globule",), "pip install globule"
    KIND = "balls"

    def __init__(self, case: Case, size: tuple[int, int]):
        super().__init__(case, size)
        import globule as gb

        self.gb, self.scene = gb, None
        self.look = {"background": (1, 1, 1), "edge_samples": 1}

    def move(self, positions: np.ndarray) -> None:
        self.positions = positions
        if self.scene is None:
            support = 4 * self.case.radius().astype(np.float32)
            smooth = {} if self.KIND == "smooth" else {"support": support}
            particles = self.gb.Particles(positions, color=LINEAR, **smooth)
            self.scene = self.gb.Scene(particles, surface=self.KIND)
        else:
            self.scene.update(positions=positions)

    def image(self, camera: Any) -> np.ndarray:
        return self.gb.render(self.scene, camera, self.size, self.look).picture

    def judged(self, camera: Any) -> tuple[np.ndarray, np.ndarray | None]:
        frame = self.gb.render(self.scene, camera, self.size, self.look)
        return np.isfinite(frame.distance), frame.normal

    def surface(self) -> Surface:
        support = 4 * self.case.radius()
        return Surface(self.positions, support, 1.0, "murakami", self.scene.threshold)

    @classmethod
    def version(cls) -> str:
        import globule

        return globule.__version__


class GlobuleSmooth(Globule):
    """Anisotropic kernels (Yu and Turk 2013) that fit a fluid."""

    SETTINGS = 'Scene(surface="smooth"), spacing measured by globule'
    KIND = "smooth"

    def surface(self) -> Surface:
        matrices, weight = self.scene.surface_kernels()
        return Surface(self.positions, matrices, weight, "murakami", self.scene.threshold)


class PovRay(Peer):
    """`blob`: the same metaballs, the exact root for each ray. It reads a text of all particles."""

    SETTINGS = "blob with strength 1, radius two spacings, threshold 0.6; no antialiasing, no shadows"
    INSTALL = "apt-get install povray"

    def __init__(self, case: Case, size: tuple[int, int]):
        super().__init__(case, size)
        import povray

        self.povray, self.folder = povray, tempfile.TemporaryDirectory()

    def _run(self, camera: Any, mode: str) -> tuple[np.ndarray, tuple[float, float]]:
        path = Path(self.folder.name) / f"{mode}.pov"
        view = {"eye": camera.eye, "look_at": camera.look_at, "up": camera.up, "fov": camera.fov}
        reach = 4 * self.case.radius()
        ends = self.povray.write_scene(path, self.positions, reach, 1.0, 0.6, view, mode, self.size)
        return self.povray.run(path, self.size, threads=os.cpu_count() or 1)[0], ends

    def image(self, camera: Any) -> np.ndarray:
        return (self._run(camera, "shaded")[0] >> 8).astype(np.uint8)

    def judged(self, camera: Any) -> tuple[np.ndarray, np.ndarray | None]:
        image, ends = self._run(camera, "depth")
        mask, _ = self.povray.hit_mask_and_depth(image, *ends)
        return mask, self.povray.normals(self._run(camera, "normal")[0])

    def surface(self) -> Surface:
        return Surface(self.positions, 4 * self.case.radius(), 1.0, "murakami", 0.6)

    @classmethod
    def missing(cls) -> bool:
        return shutil.which("povray") is None

    @classmethod
    def version(cls) -> str:
        import subprocess

        said = subprocess.run(["povray", "--version"], capture_output=True, text=True)
        found = re.search(r"POV-Ray (\d[\w.]*)", said.stdout + said.stderr)
        return found[1] if found else "version not known"


class Window(Peer):
    """A program whose surface VTK draws, in one window that stays open."""

    PACKAGES, INSTALL = ("pyvista",), "pip install pyvista"

    def __init__(self, case: Case, size: tuple[int, int]):
        super().__init__(case, size)
        import pyvista

        self.pv = pyvista
        self.plotter = pyvista.Plotter(off_screen=True, window_size=list(size))
        self.plotter.set_background("white")
        self.actor: Any = None

    def add(self) -> Any:
        """The actor of the particles."""
        raise NotImplementedError

    def move(self, positions: np.ndarray) -> None:
        self.positions = positions
        if self.actor is not None:
            self.plotter.remove_actor(self.actor, render=False)
        self.actor = self.add()

    def image(self, camera: Any) -> np.ndarray:
        view = self.plotter.camera
        view.position, view.focal_point = camera.eye, camera.look_at
        view.up, view.view_angle = camera.up, camera.fov
        self.plotter.reset_camera_clipping_range()
        self.plotter.render()
        return np.asarray(self.plotter.screenshot(return_img=True))

    def judged(self, camera: Any) -> tuple[np.ndarray, np.ndarray | None]:
        return (self.image(camera) != 255).any(axis=-1), None


class Meshed(Window):
    """A mesh with a normal at each vertex."""

    def mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        raise NotImplementedError

    def add(self) -> Any:
        vertices, faces, normals = self.mesh()
        rows = np.c_[np.full(len(faces), 3), faces].ravel().astype(np.int64)
        self.drawn = self.pv.PolyData(np.asarray(vertices, np.float32), rows)
        self.drawn.point_data.active_normals = np.asarray(normals, np.float32)
        return self.plotter.add_mesh(self.drawn, color=shared.COLOR, smooth_shading=True, specular=0.3, render=False)

    def judged(self, camera: Any) -> tuple[np.ndarray, np.ndarray | None]:
        mask, _ = super().judged(camera)
        self.drawn["shown"] = 0.5 + 0.5 * self.drawn.point_data.active_normals
        self.plotter.remove_actor(self.actor, render=False)
        self.actor = self.plotter.add_mesh(self.drawn, scalars="shown", rgb=True, lighting=False, render=False)
        coded = self.image(camera) / 127.5 - 1
        return mask, coded / np.maximum(np.linalg.norm(coded, axis=-1, keepdims=True), 1e-9)


class Splashsurf(Meshed):
    """A mesh of the SPH density, its vertices smoothed by weights; drawn by VTK."""

    SETTINGS = (
        "as its README recommends: smoothing length 2 radii, cells of half a radius, "
        "threshold 0.6, weighted smoothing of mesh and normals"
    )
    PACKAGES, INSTALL = ("pysplashsurf", "pyvista"), "pip install pysplashsurf pyvista"

    def mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return shared.splashsurf_mesh(self.positions, self.case.spacing)

    def surface(self) -> Surface | None:
        """The density before its smoothing: a part of the difference is meant."""
        from scipy.spatial import cKDTree

        reach, x = 2.0 * self.case.spacing, self.positions.astype(np.float64)
        if len(x) > 1_000_000:
            return None
        tree = cKDTree(x)
        pairs = tree.query_pairs(reach, output_type="ndarray")
        q = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1) / reach
        b = np.where(q <= 0.5, 1 - 6 * q**2 + 6 * q**3, 2 * (1 - q) ** 3)
        total = 1.0 + sum(np.bincount(pairs[:, k], b, len(x)) for k in (0, 1))
        return Surface(self.positions, reach, 1 / total, "cubic_spline", 0.6)


class VtkSph(Meshed):
    """`vtkSPHInterpolator` on a grid, then `vtkFlyingEdges3D`."""

    SETTINGS = (
        f"vtkSPHCubicKernel of smoothing length {H_SPH} spacings, cells of half a spacing, "
        "no Shepard normalization, contour 0.5"
    )

    def mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        import vtk

        spacing = self.case.spacing
        cloud = self.pv.PolyData(self.positions)
        n = len(self.positions)
        cloud["one"], cloud["rho"] = np.ones(n, np.float32), np.ones(n, np.float32)
        cloud["mass"] = np.full(n, spacing**3, np.float32)
        margin = 2 * H_SPH * spacing + 0.5 * spacing
        lo, hi = self.positions.min(0) - margin, self.positions.max(0) + margin
        counts = np.ceil((hi - lo) / (0.5 * spacing)).astype(int) + 1
        grid = self.pv.ImageData(dimensions=counts, spacing=(0.5 * spacing,) * 3, origin=lo)
        kernel = vtk.vtkSPHCubicKernel()
        kernel.SetDimension(3)
        kernel.SetSpatialStep(H_SPH * spacing)
        sum_up = vtk.vtkSPHInterpolator()
        sum_up.SetInputData(grid)
        sum_up.SetSourceData(cloud)
        sum_up.SetKernel(kernel)
        sum_up.SetDensityArrayName("rho")
        sum_up.SetMassArrayName("mass")
        sum_up.SetShepardNormalization(False)
        sum_up.SetNullPointsStrategyToNullValue()
        sum_up.Update()
        field = self.pv.wrap(sum_up.GetOutput())
        mesh = field.contour([0.5], scalars="one", method="flying_edges", compute_normals=True)
        return mesh.points, mesh.regular_faces, mesh.point_data["Normals"]

    def surface(self) -> Surface:
        reach = 2 * H_SPH * self.case.spacing
        weight = 8 / np.pi * (self.case.spacing / reach) ** 3
        return Surface(self.positions, reach, weight, "cubic_spline", 0.5)

    @classmethod
    def version(cls) -> str:
        return metadata.version("vtk")


class VtkSpheres(Window):
    """`vtkPointGaussianMapper`: a ball with the radius of half a spacing at each particle."""

    SETTINGS = "points drawn as shaded spheres, radius half a spacing"

    def add(self) -> Any:
        cloud = self.pv.PolyData(self.positions)
        cloud["radius"] = self.case.radius().astype(np.float32)
        actor = self.plotter.add_points(
            cloud, style="points_gaussian", render_points_as_spheres=True, emissive=False,
            color=shared.COLOR, render=False,
        )  # fmt: skip
        actor.mapper.scale_factor = 1.0
        actor.mapper.scale_array = "radius"
        return actor

    def surface(self) -> Surface:
        return Surface(self.positions, self.case.radius(), 1.0, "union", 0.0)

    version = VtkSph.version


class Newton(Meshed):
    """A mesh of anisotropic kernels, made by Warp on a GPU, or on one core; drawn by VTK."""

    SETTINGS = "anisotropic kernels of radius three spacings, voxels of half a spacing"
    PACKAGES, INSTALL = ("newton", "warp", "pyvista"), "pip install newton pyvista"

    def __init__(self, case: Case, size: tuple[int, int]):
        super().__init__(case, size)
        self.make = shared.newton_surface(case.spacing)

    def mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.make(self.positions)


class Ovito(Peer):
    """A mesh of a Gaussian density, drawn by OSPRay."""

    SETTINGS = (
        "Construct surface mesh, Gaussian density, cells of half a spacing, radius half a spacing; "
        "OSPRay with one sample, no denoising, no ambient light samples"
    )
    PACKAGES, INSTALL = ("ovito",), "pip install ovito"

    def move(self, positions: np.ndarray) -> None:
        self.positions = positions
        if getattr(self, "pipeline", None) is not None:
            self.pipeline.remove_from_scene()
        self.pipeline = shared.ovito_pipeline(positions, self.case.radius(), 0.5 * self.case.spacing)
        self.pipeline.compute()
        self.pipeline.add_to_scene()

    def _renderer(self) -> Any:
        from ovito.vis import OSPRayRenderer

        return OSPRayRenderer(samples_per_pixel=1, denoising_enabled=False)

    def _array(self, camera: Any, background: tuple) -> np.ndarray:
        view = shared.ovito_view(camera.eye, camera.look_at, camera.up, camera.fov)
        path = Path(tempfile.gettempdir()) / f"ovito-{os.getpid()}.png"
        view.render_image(self.size, filename=str(path), background=background, renderer=self._renderer())
        from PIL import Image

        with Image.open(path) as image:
            found = np.asarray(image.convert("RGB"))
        path.unlink()
        return found

    def image(self, camera: Any) -> np.ndarray:
        return self._array(camera, (1, 1, 1))

    def judged(self, camera: Any) -> tuple[np.ndarray, np.ndarray | None]:
        """A pixel that changes with the background shows no particle."""
        a, b = self._array(camera, (1, 1, 1)), self._array(camera, (1, 0, 0))
        return (a == b).all(axis=-1), None


class Mitsuba(Peer):
    """The shape `ellipsoids`: a ball with the radius of half a spacing at each particle."""

    SETTINGS = (
        "shape ellipsoids, radius half a spacing, extent 1; lengths in spacings, since smaller "
        "ellipsoids lose their shape; integrator direct, one sample; variant scalar_rgb"
    )
    PACKAGES, INSTALL = ("mitsuba",), "pip install mitsuba"

    def __init__(self, case: Case, size: tuple[int, int]):
        super().__init__(case, size)
        import mitsuba as mi

        mi.set_variant("scalar_rgb")
        self.mi = mi

    def move(self, positions: np.ndarray) -> None:
        mi, self.positions = self.mi, positions
        n, unit = len(positions), self.case.spacing
        centers = positions / np.float32(unit)
        radius = (self.case.radius() / unit).astype(np.float32)
        scales = np.repeat(radius[:, None], 3, axis=1)
        turns = np.tile(np.array([0, 0, 0, 1], np.float32), (n, 1))
        self.scene = mi.load_dict({
            "type": "scene",
            "light": {"type": "directional", "direction": [-0.3, -1, -0.5],
                      "irradiance": {"type": "rgb", "value": [2.0] * 3}},
            "balls": {"type": "ellipsoids", "centers": mi.TensorXf(centers),
                      "extent": 1.0,
                      "scales": mi.TensorXf(scales), "quaternions": mi.TensorXf(turns),
                      "bsdf": {"type": "twosided", "inner": {"type": "diffuse", "reflectance":
                               {"type": "rgb", "value": list(LINEAR)}}}},
        })  # fmt: skip

    def _sensor(self, camera: Any) -> Any:
        mi, unit = self.mi, self.case.spacing
        eye, target = np.divide(camera.eye, unit), np.divide(camera.look_at, unit)
        world = mi.ScalarTransform4f().look_at(origin=eye.tolist(), target=target.tolist(), up=list(camera.up))
        reach = float(np.linalg.norm(target - eye))
        return mi.load_dict({
            "type": "perspective", "fov": float(camera.fov), "fov_axis": "y", "to_world": world,
            "near_clip": 1e-4 * reach, "far_clip": 100 * reach,
            "film": {"type": "hdrfilm", "width": self.size[0], "height": self.size[1],
                     "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 1},
        })  # fmt: skip

    def image(self, camera: Any) -> np.ndarray:
        direct = self.mi.load_dict({"type": "direct", "hide_emitters": True})
        image = self.mi.render(self.scene, sensor=self._sensor(camera), integrator=direct)
        return np.asarray(self.mi.Bitmap(image).convert(
            self.mi.Bitmap.PixelFormat.RGB, self.mi.Struct.Type.UInt8, True))  # fmt: skip

    def judged(self, camera: Any) -> tuple[np.ndarray, np.ndarray | None]:
        mi = self.mi
        origins, directions = (a.reshape(-1, 3) for a in camera.rays(self.size))
        origins, directions = (origins / self.case.spacing).tolist(), directions.tolist()
        mask, normals = np.zeros(len(origins), bool), np.zeros((len(origins), 3), np.float32)
        for i, (o, d) in enumerate(zip(origins, directions, strict=True)):
            found = self.scene.ray_intersect(mi.Ray3f(o, d))
            if found.is_valid():
                mask[i], normals[i] = True, np.array(found.n).ravel()
        shape = (self.size[1], self.size[0])
        return mask.reshape(shape), normals.reshape(*shape, 3)

    def surface(self) -> Surface:
        return Surface(self.positions, self.case.radius(), 1.0, "union", 0.0)


PEERS: dict[str, type[Peer]] = {
    "globule, balls": Globule,
    "globule, smooth": GlobuleSmooth,
    "POV-Ray": PovRay,
    "splashsurf + VTK": Splashsurf,
    "VTK, SPH": VtkSph,
    "VTK, spheres": VtkSpheres,
    "OVITO + OSPRay": Ovito,
    "Mitsuba, spheres": Mitsuba,
    "Newton + VTK": Newton,
}
ONE_RADIUS = {"globule, smooth", "splashsurf + VTK", "VTK, SPH", "Newton + VTK"}
