"""The panel Cut: a plane, a box and a sphere, with handles in the image."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..roles import STEER
from .cut_handles import CutHandles
from .panel import Panel

FACES = "Set the plane across an axis or the view, or turn it around"


class CutPanel(Panel):
    """Clips and their handles."""

    title = "Cut"

    def build(self) -> None:
        """Make the widgets."""
        self.handles: dict[int, CutHandles] = {}  # by browser
        extent = self.viewer.placement.extent
        self.fresh = self.state.cuts == type(self.state.cuts)()  # no file was loaded, no plane was set
        if self.fresh:
            self._begin()
        self.gui.add_markdown("Switch on a plane, box or sphere, then drag its handle in the image.")
        plane: Any = self.add("cuts", "plane")
        plane._called.insert(0, self._begin_with)
        faces = self.gui.add_button_group("Faces", ("x", "y", "z", "view", "flip"), hint=FACES)
        faces.on_click(self.safe(self._face))
        self.add("cuts", "normal", step=0.05)
        self.add("cuts", "point", step=extent / 100)
        for name in ("box", "keep_box", "sphere", "keep_sphere"):
            self.add("cuts", name)
        self.radius = self.add("cuts", "radius", least=extent / 100, most=extent)
        off = {"cuts__plane": False, "cuts__box": False, "cuts__sphere": False}
        hint = "Show the whole scene again: no plane, box or sphere"
        self.button("Remove all cuts", lambda browser: self.state.set(**off), hint)
        self.command("Cutting plane on and off", "C", self._turn)
        self.state.listen(self._follow)

    def _turn(self, browser: Any) -> None:
        if not self.state.cuts.plane:
            self.begin_plane(browser)
        self.state.set(cuts__plane=not self.state.cuts.plane)

    def _begin_with(self, event: Any) -> None:
        if event.target.value:
            self.begin_plane(event.client)

    def begin_plane(self, browser: Any) -> None:
        """Put a plane that nobody has set yet through the surface nearest to the middle of what a
        browser sees: something of it always stays."""
        hand = None if browser is None else self.page.tools.hands.get(browser.client_id)
        if not self.fresh or hand is None:
            return
        self.fresh = False
        point = hand.in_the_middle()
        if point is not None:
            self.state.set(cuts__point=point)

    def _begin(self) -> None:
        """Start plane, box and sphere in the middle of the scene."""
        with self.viewer.source.lock:
            around = self.viewer.source.outline()
            lo, hi = self.viewer.source.bounds()
        if around is not None:  # of a simulation: what is seen, not the whole domain
            lo, hi = around.min(axis=0), around.max(axis=0)
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
        self.radius.min, self.radius.max, self.radius.step = extent / 100, extent, extent / 200
        if not (cuts.plane or cuts.box or cuts.sphere):
            self._begin()
        self._follow({"cuts."})

    def _face(self, event: Any) -> None:
        name, cuts = event.target.value, self.state.cuts
        self.begin_plane(event.client)
        if name == "flip":
            normal = tuple(-v for v in cuts.normal)
        elif name == "view":
            camera = self.viewer.camera_of(event.client.camera)
            away = np.subtract(camera.eye, camera.look_at)
            normal = tuple((away / np.linalg.norm(away)).tolist())
        else:
            normal = tuple(float(axis == name) for axis in "xyz")
        self.state.set(cuts__normal=normal, cuts__plane=True)

    # Handles: each browser that steers has its own

    def connected(self, browser: Any, client: Any) -> None:
        """Add the handles of a browser."""
        if client.role == STEER:
            self.handles[browser.client_id] = CutHandles(self, browser)

    def disconnected(self, browser: Any) -> None:
        """Forget the handles of a browser that has left."""
        self.handles.pop(browser.client_id, None)

    def took(self, browser: Any) -> None:
        """Show or hide the handles of a browser that has taken another tool."""
        if browser.client_id in self.handles:
            self.handles[browser.client_id].follow()

    def _follow(self, changed: set[str]) -> None:
        if any(name.startswith("cuts.") for name in changed):
            self.fresh &= "cuts.normal" not in changed and "cuts.point" not in changed
            for handles in list(self.handles.values()):
                handles.follow()
