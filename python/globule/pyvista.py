"""The exact surface of particles in a PyVista or VTK window, between the meshes of that window.

The surface is ray-traced by `globule.render` for the window's camera before each frame. VTK gets it
as one quadrilateral that fills the window and has a color and a depth of its own in each pixel, so
that meshes, translucent ones too, lie in front of it, behind it or cut it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ._base.checks import optional
from .pieces.scene import Scene
from .render.camera import Camera
from .render.frame import Frame
from .render.render import render
from .render.settings import RenderSettings

_SHADER = """
vec4 globule = texture(actortexture, tcoordVCVSOutput);
if (globule.a > 1.0) discard;
gl_FragDepth = globule.a;
fragOutput0 = vec4(globule.rgb, 1.0);
"""
_MISS = 2.0  # a depth behind everything


def add_particles(
    plotter: Any, particles: Any, settings: RenderSettings | dict[str, Any] | None = None, **options: Any
) -> ParticlesActor:
    """Add the surface of particles to a window.

        plotter = pyvista.Plotter()
        plotter.add_mesh(pyvista.Box())
        globule.pyvista.add_particles(plotter, particles)
        plotter.show()

    The surface follows the window's camera and size. Its light is that of `settings`, not that of
    the window; the window's meshes cast no shadow on it.

    Args:
        plotter: `pyvista.Plotter`, or a `vtkRenderer`.
        particles: a `Scene`, or an argument of `Scene`.
        settings: `RenderSettings`, or a dict of its fields; background and sky are not drawn.
        options: `color_by`, `colormap`, `range`, `clips`: those of `globule.render`.

    Returns:
        The `ParticlesActor`; its `update` shows other particles.

    Raises:
        MissingPackageError: VTK is not installed.
    """
    optional("vtkmodules.vtkRenderingOpenGL2", "pyvista", "vtk")  # which draws what is made here
    renderer = getattr(plotter, "renderer", plotter)
    if not hasattr(renderer, "AddViewProp"):
        raise TypeError("plotter: expected a pyvista.Plotter or a vtkRenderer, "
                        f"got {type(plotter).__name__}")  # fmt: skip
    actor = ParticlesActor(renderer, particles, settings, options)
    if getattr(plotter, "camera_set", None) is False and hasattr(plotter, "reset_camera"):
        plotter.reset_camera()
    return actor


class ParticlesActor:
    """Particles in a window, made by `add_particles`.

    actor  the vtkActor
    scene  the `Scene` that is drawn
    frame  the `Frame` that was drawn last, or None
    """

    def __init__(self, renderer: Any, particles: Any, settings: Any, options: dict[str, Any]):
        from vtkmodules.vtkCommonDataModel import vtkImageData
        from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkTexture

        self._renderer, self._settings, self._options = renderer, settings, options
        self.scene = particles if isinstance(particles, Scene) else Scene(particles)
        self.frame: Frame | None = None
        self._of_frame: tuple = ()
        self._of_depth: tuple = ()
        self._version = 0
        self._image = vtkImageData()
        self._texture = vtkTexture()
        self._texture.SetInputData(self._image)
        self._texture.SetColorModeToDirectScalars()
        self._texture.InterpolateOff()
        self._texture.MipmapOff()
        self._texture.RepeatOff()
        self._fill(np.full((1, 1, 4), _MISS, np.float32))
        self._mapper = vtkPolyDataMapper()
        self._mapper.SetInputData(self._window())
        self.actor = vtkActor()
        self.actor.SetMapper(self._mapper)
        self.actor.SetTexture(self._texture)
        self.actor.GetProperty().LightingOff()
        self.actor.ForceOpaqueOn()
        self.actor.PickableOff()
        shader = self.actor.GetShaderProperty()
        place = "gl_Position = vec4(2.0 * tcoord - 1.0, 0.0, 1.0);\n"
        shader.AddVertexShaderReplacement("//VTK::PositionVC::Impl", True, place, False)
        for tag in ("TCoord", "Depth"):
            shader.AddFragmentShaderReplacement(f"//VTK::{tag}::Impl", True, "", False)
        shader.AddFragmentShaderReplacement("//VTK::Light::Impl", True, _SHADER, False)
        renderer.AddViewProp(self.actor)
        self._observer = renderer.AddObserver("StartEvent", self._draw)

    def update(self, particles: Any = None, **fields: Any) -> None:
        """Show other particles from the next frame on; the arguments are those of
        `Scene.update`."""
        self.scene.update(particles, **fields)
        self.refresh()

    def refresh(self) -> None:
        """Draw anew at the next frame: the scene was changed."""
        self._version += 1
        self._mapper.SetInputData(self._window())

    def remove(self) -> None:
        """Take the surface out of the window."""
        self._renderer.RemoveObserver(self._observer)
        self._renderer.RemoveViewProp(self.actor)

    def _window(self) -> Any:
        """A quadrilateral whose corners are those of the particles' box, for the bounds of the
        window's scene; its texture's coordinates place it in the window."""
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

        particles = self.scene.particles
        corners = np.zeros((2, 3))
        if len(particles.finite_positions()):
            corners = np.asarray(particles.bounds(), np.float64)
        support = 0.0 if self.scene.support is None else float(np.max(self.scene.support))
        (x0, y0, z0), (x1, y1, z1) = corners + [[-support / 2], [support / 2]] + self._origin()
        points = vtkPoints()
        places = np.array([[x0, y0, z0], [x1, y0, z0], [x1, y1, z1], [x0, y1, z1]], np.float32)
        points.SetData(numpy_to_vtk(places, deep=True))
        cells = vtkCellArray()
        cells.InsertNextCell(4)
        for i in range(4):
            cells.InsertCellPoint(i)
        window = vtkPolyData()
        window.SetPoints(points)
        window.SetPolys(cells)
        across = numpy_to_vtk(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32), deep=True)
        across.SetName("across")
        window.GetPointData().SetTCoords(across)
        return window

    def _origin(self) -> np.ndarray:
        """(3,) float64, world: the window has world coordinates, the scene those from here."""
        return np.array(self.scene.particles.origin, np.float64)

    def _draw(self, *_: Any) -> None:
        """Before each frame: render if the view is another one, and place the depths."""
        if not self.actor.GetVisibility():
            return
        view, whole = self._renderer.GetActiveCamera(), self._renderer.GetSize()
        parts = self._renderer.GetRenderWindow().GetTileScale()  # of an image that is larger than the window
        size = whole[0] // parts[0], whole[1] // parts[1]
        if min(size) < 1 or max(size) > 16384:
            return
        camera, around, corner = _around(view, size)
        origin = self._origin()
        camera = replace(camera, eye=np.subtract(camera.eye, origin), look_at=np.subtract(camera.look_at, origin))
        wanted = (camera, around, self._version)
        if wanted != self._of_frame:
            self.frame = render(self.scene, camera, around, self._settings, **self._options)
            self._of_frame = wanted
        matrix = view.GetCompositeProjectionTransformMatrix(size[0] / size[1], -1.0, 1.0)
        rows = tuple(matrix.GetElement(i, j) for i in (2, 3) for j in range(4))
        if (wanted, rows, corner) != self._of_depth:
            part = np.s_[corner[1] : corner[1] + size[1], corner[0] : corner[0] + size[0]]
            self._place(np.array(rows).reshape(2, 4), part)
            self._of_depth = wanted, rows, corner

    def _place(self, rows: np.ndarray, part: Any) -> None:
        """Color and window depth of each pixel of a part of the frame as the texture; `rows` are z
        and w of the clip space."""
        assert self.frame is not None
        hit = np.isfinite(self.frame.distance[part])
        pixels = np.full((*hit.shape, 4), _MISS, np.float32)
        pixels[..., :3] = self.frame.image[part][..., :3] / np.float32(255)
        where = self.frame.position[part][hit] + self._origin()
        z, w = where @ rows[:, :3].T[:, 0] + rows[0, 3], where @ rows[1, :3] + rows[1, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = 0.5 + 0.5 * z / w
        # Nearer or farther than the window's clipping planes: as VTK cuts its meshes.
        pixels[hit, 3] = np.where((depth >= 0) & (depth <= 1), depth, _MISS)
        self._fill(pixels[::-1])

    def _fill(self, pixels: np.ndarray) -> None:
        from vtkmodules.util.numpy_support import numpy_to_vtk

        height, width = pixels.shape[:2]
        self._image.SetDimensions(width, height, 1)
        values = numpy_to_vtk(np.ascontiguousarray(pixels).reshape(-1, 4), deep=True)
        self._image.GetPointData().SetScalars(values)
        self._image.Modified()
        self._texture.Modified()


def _around(view: Any, size: tuple[int, int]) -> tuple[Camera, tuple[int, int], tuple[int, int]]:
    """The camera on whose axis a window lies that is a part of a larger image, as programs make images
    larger than their window; the size of the image around the axis, and the window's left upper corner
    in it."""
    center = view.GetWindowCenter()
    if tuple(center) == (0.0, 0.0):
        return camera_of(view), size, (0, 0)
    wide, high = (1 + abs(c) for c in center)
    larger = type(view)()
    larger.DeepCopy(view)
    larger.SetWindowCenter(0, 0)
    larger.SetViewAngle(math.degrees(2 * math.atan(high * math.tan(math.radians(view.GetViewAngle()) / 2))))
    larger.SetParallelScale(high * view.GetParallelScale())
    corner = (wide + center[0] - 1) * size[0] / 2, (high - center[1] - 1) * size[1] / 2
    return camera_of(larger), (round(wide * size[0]), round(high * size[1])), (round(corner[0]), round(corner[1]))


def camera_of(view: Any) -> Camera:
    """The `Camera` that sees what a vtkCamera sees.

    Raises ValueError for a view that is sheared or off its axis.
    """
    if tuple(view.GetWindowCenter()) != (0.0, 0.0) or view.GetUseHorizontalViewAngle():
        raise ValueError("camera: expected a vertical view angle and a window center of (0, 0), "
                         "got another view")  # fmt: skip
    height = 2.0 * view.GetParallelScale() if view.GetParallelProjection() else None
    fov = min(max(view.GetViewAngle(), 1e-3), 179.9)
    if not math.isfinite(fov):
        raise ValueError(f"camera: expected a finite view angle, got {fov}")
    return Camera(view.GetPosition(), view.GetFocalPoint(), view.GetViewUp(), fov, height)
