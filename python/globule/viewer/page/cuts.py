"""The panel Cut: a plane, a box and a sphere, with handles in the image."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..roles import STEER
from .panel import Panel, handle
from .tools import DRAGGED

FACES = "Set the plane across an axis or the view, or turn it around"


class CutPanel(Panel):
    """Clips and their handles."""

    title = "Cut"

    def build(self) -> None:
        """Make the widgets."""
        extent = self.viewer.extent
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
        extent = self.viewer.extent
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
        extent, cuts = self.viewer.extent, self.state.cuts
        self.radius.min, self.radius.max, self.radius.step = extent / 100, extent, extent / 200
        if not (cuts.plane or cuts.box or cuts.sphere):
            self._begin()

    def _face(self, event: Any) -> None:
        name, cuts = event.target.value, self.state.cuts
        self.begin_plane(event.client)
        if name == "flip":
            normal = tuple(-v for v in cuts.normal)
        elif name == "view":
            camera = self.viewer.clients[event.client_id].camera
            away = np.subtract(camera.eye, camera.look_at)
            normal = tuple((away / np.linalg.norm(away)).tolist())
        else:
            normal = tuple(float(axis == name) for axis in "xyz")
        self.state.set(cuts__normal=normal, cuts__plane=True)

    def handles(self, browser: Any) -> list[dict[str, Any]]:
        """The handles of the cuts that are on, for a browser that steers. A tool that draws in the
        image has none: a stroke that begins on a handle would move the cut instead."""
        hand, cuts = self.page.tools.hands.get(browser.client_id), self.state.cuts
        if hand is None or hand.client.role != STEER or hand.tool in DRAGGED:
            return []
        normal = np.divide(cuts.normal, np.linalg.norm(cuts.normal) or 1)
        return [
            *([handle("plane", "Cutting plane", cuts.point, [normal])] if cuts.plane else []),
            *([handle("lo", "Low corner of the box", cuts.lo, np.eye(3))] if cuts.box else []),
            *([handle("hi", "High corner of the box", cuts.hi, np.eye(3))] if cuts.box else []),
            *([handle("center", "Middle of the sphere", cuts.center, np.eye(3))] if cuts.sphere else []),
        ]

    def pulled(self, name: str, at: Any, axes: Any) -> None:
        """Move a cut."""
        self.state.set(**{f"cuts__{'point' if name == 'plane' else name}": tuple(at.tolist())})

    def _follow(self, changed: set[str]) -> None:
        self.fresh &= "cuts.normal" not in changed and "cuts.point" not in changed
