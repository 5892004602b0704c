"""The panel Cut: a plane, a box and a sphere, with handles in the image."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._base.rotations import matrix
from .panel import Panel

HANDLE = 0.45  # page units
FACES = "Set the plane across an axis or the view, or turn it around"


class CutPanel(Panel):
    """Clips and their handles."""

    title = "Cut"

    def build(self) -> None:
        """Make the widgets."""
        extent = self.viewer.placement.extent
        cuts, plain = self.state.cuts, type(self.state.cuts)()
        if cuts == plain:  # no file was loaded
            self._begin()
        self.gui.add_markdown(
            "Switch on a plane, box or sphere, then drag its handles in the image."
        )
        self.add("cuts", "plane")
        self.gui.add_button_group("Faces", ("x", "y", "z", "view", "flip"), hint=FACES).on_click(
            self.safe(self._face)
        )
        self.add("cuts", "normal", step=0.05)
        self.add("cuts", "point", step=extent / 100)
        self.add("cuts", "box")
        self.add("cuts", "keep_box")
        self.add("cuts", "sphere")
        self.add("cuts", "keep_sphere")
        self.radius = self.add("cuts", "radius", least=extent / 100, most=extent)
        self.button(
            "Remove all cuts",
            lambda browser: self.state.set(cuts__plane=False, cuts__box=False, cuts__sphere=False),
            "Show the whole scene again: no plane, box or sphere",
        )
        self.command(
            "Cutting plane on and off",
            "C",
            lambda browser: self.state.set(cuts__plane=not self.state.cuts.plane),
        )
        self._handles()
        self.state.listen(self._follow)
        self._follow({"cuts."})

    def _begin(self) -> None:
        """Start plane, box and sphere in the middle of the scene."""
        with self.viewer.source.lock:
            lo, hi = self.viewer.source.bounds()
        extent = self.viewer.placement.extent
        middle = tuple(((lo + hi) / 2).tolist())
        near, far = (lo + hi) / 2, hi + 0.05 * extent
        self.state.set(
            cuts__point=middle,
            cuts__center=middle,
            cuts__radius=extent / 4,
            cuts__lo=tuple(near.tolist()),
            cuts__hi=tuple(far.tolist()),
        )

    def grew(self, moved: bool) -> None:
        """Fit radius and handles to the new extent."""
        if not moved:
            return
        extent, cuts = self.viewer.placement.extent, self.state.cuts
        self.radius.min, self.radius.max = extent / 100, extent
        self.radius.step = extent / 200
        if not (cuts.plane or cuts.box or cuts.sphere):
            self._begin()
        self._follow({"cuts."})

    def _face(self, event: Any) -> None:
        name, cuts = event.target.value, self.state.cuts
        if name == "flip":
            normal = tuple(-v for v in cuts.normal)
        elif name == "view":
            camera = self.viewer.camera_of(event.client.camera)
            away = np.subtract(camera.eye, camera.look_at)
            normal = tuple((away / np.linalg.norm(away)).tolist())
        else:
            normal = tuple(float(axis == name) for axis in "xyz")
        self.state.set(cuts__normal=normal, cuts__plane=True)

    def _handles(self) -> None:
        add = self.page.server.scene.add_transform_controls
        plain = {"scale": HANDLE, "depth_test": False, "visible": False}
        self.plane = add("/cut/plane", **plain)
        self.lo = add("/cut/low corner", disable_rotations=True, **plain)
        self.hi = add("/cut/high corner", disable_rotations=True, **plain)
        self.ball = add("/cut/ball", disable_rotations=True, **plain)

        place = self.viewer.placement

        def follow(handle: Any, **names: str) -> None:
            @handle.on_update
            def _(event: Any) -> None:
                changes = {f"cuts__{names['at']}": tuple(place.to_world(handle.position).tolist())}
                if "normal" in names:
                    changes["cuts__normal"] = tuple(matrix(handle.wxyz)[:, 0].tolist())
                try:
                    self.state.set(**changes)
                except ValueError as error:
                    self.page.complain(event.client, str(error))

        follow(self.plane, at="point", normal="normal")
        follow(self.lo, at="lo")
        follow(self.hi, at="hi")
        follow(self.ball, at="center")

    def _follow(self, changed: set[str]) -> None:
        """Move the handles to their settings."""
        if not any(name.startswith("cuts.") for name in changed):
            return
        cuts, place = self.state.cuts, self.viewer.placement.to_page
        for handle, on, at in (
            (self.plane, cuts.plane, cuts.point),
            (self.lo, cuts.box, cuts.lo),
            (self.hi, cuts.box, cuts.hi),
            (self.ball, cuts.sphere, cuts.center),
        ):
            if handle.visible != on:
                handle.visible = on
            if not np.allclose(handle.position, place(at), atol=1e-6):
                handle.position = place(at)
        normal = np.asarray(cuts.normal) / (np.linalg.norm(cuts.normal) or 1)
        if any(cuts.normal) and not np.allclose(matrix(self.plane.wxyz)[:, 0], normal, atol=1e-5):
            self.plane.wxyz = turn_to(normal)


def turn_to(normal: np.ndarray) -> tuple[float, float, float, float]:
    """The rotation (w, x, y, z) that turns the x axis to a unit vector (3,)."""
    w = 1 + float(normal[0])
    if w < 1e-6:
        return 0.0, 0.0, 1.0, 0.0
    quaternion = np.array([w, 0.0, -normal[2], normal[1]])
    w, x, y, z = (quaternion / np.linalg.norm(quaternion)).tolist()
    return w, x, y, z
