"""Figures 6.4 and 6.6: a brain from a tomography, and a colored mesh, as metaballs.

Both come with the package nilearn, which holds them as files; without it shapes made by formulas
stand in, and the pictures say so.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from globule._base.colormaps import colorize
from globule._base.plot import GRAY, Figure
from globule.data.particles import Particles
from globule.data.surface import vertex_particles
from globule.pieces.scene import Scene
from globule.render.clips import ClipBox
from globule.render.fit import fit_camera
from globule.render.presets import load_preset
from globule.render.render import render

from .style import show_frame

LEVEL = 0.35  # least intensity of tissue
TISSUE, AIR = (0.25, 1.0), 0.0
FOLDS = 9.0  # mm, of the phantom's surface
UP = (0, 0, 1)


def tomography(resolution: int = 2) -> tuple[np.ndarray, np.ndarray, str]:
    """Intensities (X, Y, Z) in [0, 1], world_from_voxel (4, 4) in mm, RAS, and what they are."""
    try:
        from nilearn.datasets import load_mni152_template
    except ImportError:
        return *phantom(resolution), "a phantom made by formulas"
    image = load_mni152_template(resolution=resolution)
    return image.get_fdata(), image.affine, "MNI152 template"


def phantom(resolution: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """A brain-like body with folds, gray and white matter and ventricles, as `tomography`."""
    axes = [np.arange(-reach, reach + 1, resolution, dtype=np.float64) for reach in (72, 90, 70)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    folds = np.sin(x / FOLDS + 2 * np.sin(y / 17)) * np.sin(y / FOLDS + 2 * np.sin(z / 15))
    folds = folds + np.sin(z / FOLDS + 2 * np.sin(x / 13))
    fissure = 9 * np.exp(-((x / 5) ** 2)) * (z > -20)
    ellipsoid = np.sqrt((x / 66) ** 2 + (y / 82) ** 2 + (z / 62) ** 2)
    below = 66 * (1 - ellipsoid) - fissure + 3.5 * folds  # mm under the surface, about
    side = np.abs(x) - 9 - 0.06 * (y + 40)
    hollow = np.sqrt((side / 6) ** 2 + (y / 34) ** 2 + ((z - 6 + y * y / 160) / 9) ** 2)
    values = np.select([below < 0, hollow < 1, below < 9 + 3 * folds], [AIR, 0.12, 0.62], 0.95)
    world_from_voxel = np.diag([resolution, resolution, resolution, 1.0])
    world_from_voxel[:3, 3] = [axis[0] for axis in axes]
    return values, world_from_voxel


def metaballs(values: np.ndarray, world_from_voxel: np.ndarray) -> Particles:
    """One metaball per voxel of tissue, gray by intensity, support two voxels."""
    index = np.argwhere(values >= LEVEL)
    positions = index @ world_from_voxel[:3, :3].T + world_from_voxel[:3, 3]
    found = values[tuple(index.T)]
    gray = np.interp(found, TISSUE, (0.08, 0.95))
    voxel = abs(np.linalg.det(world_from_voxel[:3, :3])) ** (1 / 3)
    return Particles(positions, support=2 * voxel, color=np.repeat(gray[:, None], 3, axis=1))


def brain(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """A brain from a tomography, one metaball per voxel of tissue; a slab is cut away, and the cut
    faces show the intensities inside."""
    values, world_from_voxel, name = tomography(2 if dpi > 60 else 4)
    scene = Scene(metaballs(values, world_from_voxel), device=device)
    lo, hi = scene.particles.bounds()
    middle = (lo + hi) / 2
    slab = ClipBox((middle[0] - 1, lo[1] - 99, middle[2] - 8), (hi[0] + 99, hi[1] + 99, hi[2] + 99))
    size = (int(6 * dpi * 1.5), int(4.8 * dpi * 1.5))
    camera = fit_camera(scene, size, direction=(0.95, 0.75, 0.7), up=UP, fov=30)
    with Figure(path, 6, 4.8, dpi) as figure:
        frame = render(scene, camera, size, load_preset("tissue", scene, UP), clips=[slab])
        _shown(figure, frame.picture, f"{name}, {len(scene):,} metaballs")


def surface_mesh() -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Vertices (N, 3), faces (F, 3), a value a vertex (N,), and what they are."""
    try:
        from nilearn.datasets import fetch_surf_fsaverage
        from nilearn.surface import load_surf_data, load_surf_mesh
    except ImportError:
        return *knot(), "a knot made by formulas"
    files = fetch_surf_fsaverage("fsaverage5")  # held by the package, nothing is fetched
    mesh = load_surf_mesh(files["pial_left"])
    depth = load_surf_data(files["sulc_left"])
    return mesh.coordinates, mesh.faces, depth, "fsaverage5, left, depth of the sulci"


def knot(around: int = 400, across: int = 26) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A tube along a trefoil knot: vertices, faces, the angle across it."""
    t, a = np.meshgrid(np.arange(around) / around * 2 * np.pi, np.arange(across) / across * 2 * np.pi, indexing="ij")

    def curve(t: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], -1)

    ahead = curve(t + 1e-3) - curve(t - 1e-3)
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    other = np.cross(side, ahead)
    other /= np.linalg.norm(other, axis=-1, keepdims=True)
    radius = 0.42 + 0.05 * np.cos(8 * t)
    vertices = curve(t) + radius[..., None] * (np.cos(a)[..., None] * side + np.sin(a)[..., None] * other)
    i, j = (grid.ravel() for grid in np.indices((around, across)))
    i1, j1 = (i + 1) % around, (j + 1) % across
    corners = [k * across + m for k, m in ((i, j), (i1, j), (i1, j1), (i, j1))]
    faces = np.concatenate([np.stack(corners[:3], 1), np.stack([corners[0], *corners[2:]], 1)])
    return 20 * vertices.reshape(-1, 3), faces, np.cos(a + 2 * t).ravel()


def colored_mesh(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """A colored mesh shown by metaballs at its vertices alone: no triangle is drawn, and between
    the vertices their colors blend smoothly."""
    vertices, faces, values, name = surface_mesh()
    lo, hi = np.quantile(values, [0.02, 0.85])
    color = colorize(values, "coolwarm", lo, hi)
    particles = vertex_particles(Particles(vertices, color=color), faces)
    scene = Scene(particles, device=device)
    size = (int(6 * dpi * 1.5), int(4.4 * dpi * 1.5))
    camera = fit_camera(scene, size, direction=(-1, 0.3, 0.35), up=UP, fov=30)
    look = dataclasses.replace(
        load_preset("clay", scene, UP), ground=None, sky=None, background=(1,) * 3, ambient=(0.45,) * 3
    )
    with Figure(path, 6, 4.4, dpi) as figure:
        frame = render(scene, camera, size, look)
        _shown(figure, frame.picture, f"{name}, {len(scene):,} metaballs")


def _shown(figure: Any, picture: np.ndarray, name: str) -> None:
    figure.set_layout_engine("none")
    ax = figure.add_axes((0, 0, 1, 1))
    show_frame(ax, picture)
    ax.text(0.015, 0.02, name, color=GRAY, fontsize=8, transform=ax.transAxes)
