"""The panel View: fit, standard views, projection, bookmarks."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...render.camera import Camera, view_axes
from ...render.fit import fit_camera
from ..state import MOST_BOOKMARKS
from .panel import Panel

VIEWS = ("front", "back", "left", "right", "top", "bottom")
NONE = "(none yet)"
FOV = 40.0  # degrees, vertical, after an orthographic view


class View(Panel):
    """The camera of the browser."""

    title = "Camera"

    def build(self) -> None:
        """Make the widgets."""
        self.command("Fit all", "F", self.fit, True)
        self.command("First view", "0", self.viewer.reset, True)
        self.button("First view", self.viewer.reset, "The view that the page began with (key 0)", True)
        for label, views, keys in (("Look from", VIEWS[:3], "1, 2, 3"), ("", VIEWS[3:], "4, 5, 6")):
            hint = f"Show everything from a side (keys {keys})"
            group = self.gui.add_button_group(label, views, hint=hint, private=True)
            group.on_click(self.safe(lambda event: self.stand(event.client, event.target.value)))
        hint = "Orthographic: distance does not make things smaller (key O)"
        self.button("Perspective / orthographic", self.flatten, hint, True)
        with self.gui.add_folder("Bookmarks"):
            self.name = self.gui.add_text("Name", "view 1", hint="Of the view to save")
            self.button("Add bookmark", self.keep, "Keep this camera under the name above")
            self.names = self.gui.add_dropdown("Go to", self._names(), hint="A saved view")
            chosen = self.names
            self.button("Go", lambda b: self.go(b, chosen.value), "Use the chosen view", True)
            self.button("Delete", lambda b: self.forget(chosen.value), "Forget this view")
        self.state.listen(self._follow)
        for key, name in zip("123456", VIEWS, strict=True):
            self.command(f"Look from: {name}", key, lambda b, name=name: self.stand(b, name), True)
        self.command("Perspective or orthographic", "O", self.flatten, True)

    def stand(self, browser: Any, name: str) -> None:
        """Show everything from a direction in `VIEWS`."""
        right, above, front = view_axes(self.viewer.up)
        towards = (front, -front, -right, right, above, -above)[VIEWS.index(name)]
        # Orbit controls cannot look straight along their own axis.
        if name in ("top", "bottom"):
            towards = towards + 1e-3 * front
        self._see(browser, towards)

    def fit(self, browser: Any) -> None:
        """Show everything from the current direction."""
        camera = self.viewer.clients[browser.client_id].camera
        self._see(browser, np.subtract(camera.eye, camera.look_at))

    def grew(self, moved: bool) -> None:
        """Fit all views to the new extent."""
        for browser in list(self.page.desk.browsers.values()) if moved else ():
            self.fit(browser)

    def flatten(self, browser: Any) -> None:
        """Switch between a perspective and an orthographic camera with the same field of view."""
        camera = self.viewer.clients[browser.client_id].camera
        away = np.subtract(camera.eye, camera.look_at)
        distance = float(np.linalg.norm(away))
        slope = 2 * np.tan(np.radians(FOV) / 2)
        if camera.height is None:
            height = float(2 * distance * np.tan(np.radians(camera.fov) / 2))
            camera = Camera(camera.eye, camera.look_at, camera.up, height=height)
        else:
            eye = camera.look_at + camera.height / slope / distance * away
            camera = Camera(eye, camera.look_at, camera.up, FOV)
        self.viewer.move(browser, camera)

    def _see(self, browser: Any, towards: Any) -> None:
        viewer = self.viewer
        client = viewer.clients[browser.client_id]
        with viewer.source.lock:
            scene = viewer.source.scene(viewer.state.snapshot())
            size = client.room.free(client.pacer.full)
            around = viewer.source.outline()
            if around is None and scene.octree.n_inside == 0:
                raise ValueError("fit: expected particles to show, got none")
            now = client.camera
            how = {"direction": towards, "up": viewer.up, "fov": now.fov}
            camera = fit_camera(scene, size, around, orthographic=now.height is not None, **how)
        viewer.move(browser, client.room.seated(camera, client.pacer.full))

    # Bookmarks

    def _names(self) -> tuple[str, ...]:
        return tuple(self.state.bookmarks) or (NONE,)

    def keep(self, browser: Any) -> None:
        """Save the browser's camera as a bookmark. Raises ValueError."""
        name = self.name.value.strip()[:60]
        if not name:
            raise ValueError("bookmark: expected a name, got none")
        if len(self.state.bookmarks) >= MOST_BOOKMARKS and name not in self.state.bookmarks:
            raise ValueError(f"bookmarks: expected at most {MOST_BOOKMARKS}")
        self.state.bookmarks[name] = self.viewer.clients[browser.client_id].camera
        self.state.tell({"bookmarks"})
        self.names.value = name
        self.name.value = f"view {len(self.state.bookmarks) + 1}"

    def go(self, browser: Any, name: str) -> None:
        """Move the browser's camera to a bookmark."""
        if name in self.state.bookmarks:
            self.viewer.move(browser, self.state.bookmarks[name])

    def forget(self, name: str) -> None:
        """Delete a bookmark."""
        self.state.bookmarks.pop(name, None)
        self.state.tell({"bookmarks"})

    def _follow(self, changed: set[str]) -> None:
        if "bookmarks" in changed and self.names.options != self._names():
            self.names.options = self._names()
