"""The page: panels beside the picture."""

from __future__ import annotations

from typing import Any

import numpy as np


class Page:
    def __init__(self, viewer: Any):
        self.viewer = viewer
        server = viewer.server
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.set_panel_label(viewer.title)
        server.scene.set_up_direction(viewer.up)
        server.scene.world_axes.visible = False
        self._first_camera()

    def _first_camera(self) -> None:
        camera, place = self.viewer.first_camera, self.viewer.placement
        first = self.viewer.server.initial_camera
        first.position, first.look_at = place.to_page(camera.eye), place.to_page(camera.look_at)
        first.up, first.fov = camera.up, float(np.radians(camera.fov))

    def connected(self, browser: Any, client: Any) -> None:
        pass

    def disconnected(self, browser: Any) -> None:
        pass
