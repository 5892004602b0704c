"""The handles of plane, box and sphere in one browser's image."""

from __future__ import annotations

from typing import Any

import numpy as np
from viser.transforms import SO3

from .tools import DRAGGED

SIZE = 0.45  # page units


class CutHandles:
    """Handles that follow the settings, and change them when a person drags them.

    Each browser has its own. They are hidden while its tool draws in the image: a stroke that
    begins on a handle would move the cut instead.

    Args:
        panel: `CutPanel`.
        browser: `viser.ClientHandle`.
    """

    def __init__(self, panel: Any, browser: Any):
        self.panel, self.browser = panel, browser
        self.state, self.place = panel.state, panel.viewer.placement
        self._dragged: Any = None
        self.plane = self._add("plane", {"cuts__point": "at", "cuts__normal": "axis"}, along_normal=True)
        self.lo = self._add("low corner", {"cuts__lo": "at"})
        self.hi = self._add("high corner", {"cuts__hi": "at"})
        self.ball = self._add("ball", {"cuts__center": "at"})
        self.follow()

    def _add(self, name: str, settings: dict[str, str], along_normal: bool = False) -> Any:
        """A handle; settings: which of them get its place and which its x axis; along_normal: it is
        one arrow, along its x axis."""
        handle = self.browser.scene.add_transform_controls(
            f"/cut/{name}",
            scale=SIZE,
            depth_test=False,
            visible=False,
            active_axes=(True, not along_normal, not along_normal),
            disable_rotations=True,
        )

        @handle.on_update
        async def _(event: Any) -> None:  # in the event loop, which keeps the order
            self._dragged = None if event.phase == "end" else handle
            values = {
                "at": tuple(self.place.to_world(handle.position).tolist()),
                "axis": tuple(SO3(handle.wxyz).as_matrix()[:, 0].tolist()),
            }
            try:
                self.state.set(**{key: values[what] for key, what in settings.items()})
            except ValueError as error:
                self.panel.page.complain(self.browser, str(error))

        return handle

    def follow(self) -> None:
        """Show the handles of the cuts that are on, where the settings say."""
        cuts, place = self.state.cuts, self.place.to_page
        hand = self.panel.page.tools.hands.get(self.browser.client_id)
        free = hand is None or hand.tool not in DRAGGED
        for handle, on, at in (
            (self.plane, cuts.plane, cuts.point),
            (self.lo, cuts.box, cuts.lo),
            (self.hi, cuts.box, cuts.hi),
            (self.ball, cuts.sphere, cuts.center),
        ):
            if handle.visible != (on and free):
                handle.visible = on and free
                if self._dragged is handle:  # its end is not reported
                    self._dragged = None
            if handle is not self._dragged and not np.allclose(handle.position, place(at), atol=1e-6):
                handle.position = place(at)
        normal = np.asarray(cuts.normal) / (np.linalg.norm(cuts.normal) or 1)
        turned = not np.allclose(SO3(self.plane.wxyz).as_matrix()[:, 0], normal, atol=1e-5)
        if any(cuts.normal) and turned and self.plane is not self._dragged:
            self.plane.wxyz = turn_to(normal)


def turn_to(normal: np.ndarray) -> tuple[float, float, float, float]:
    """The rotation (w, x, y, z) that turns the x axis to a unit vector (3,)."""
    w = 1 + float(normal[0])
    if w < 1e-6:
        return 0.0, 0.0, 1.0, 0.0
    quaternion = np.array([w, 0.0, -normal[2], normal[1]])
    w, x, y, z = (quaternion / np.linalg.norm(quaternion)).tolist()
    return w, x, y, z
