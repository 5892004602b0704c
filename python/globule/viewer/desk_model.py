"""What toolbar, timeline and list of layers show, as plain values for JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.colormaps import colorize
from ..data.attributes import attribute_values, colormap_of
from ..render.display import displayed
from ..scene.mesh import Mesh
from .layers import hidden, layer_names
from .plots import over_time
from .roles import LOOK

BINS = 48
MOST_COUNTED = 1_000_000  # particles of a histogram
SLOW = 1.5  # s that an image takes before the person is told


class Model:
    """Reads the viewer; never waits for the source's lock.

    Args:
        viewer: `globule.viewer.app.Viewer`.
    """

    def __init__(self, viewer: Any):
        self.viewer = viewer
        self.series: dict[int, str] = {}  # what a browser plots over time
        self.sections: dict[int, str] = {}  # which section of the inspector it shows
        self._counted: tuple = ()
        self._plot: dict[str, Any] | None = None

    def of(self, browser: Any) -> dict[str, Any]:
        """The model for one browser (`globule.viewer.desk.Browser`)."""
        page, state = self.viewer.page, self.viewer.state
        hand = page.tools.hands.get(browser.client_id)
        client = self.viewer.clients.get(browser.client_id)
        undo, redo = state.history.lengths
        saving: Any = next(p for p in page.panels if type(p).__name__ == "Save")
        return {
            "title": self.viewer.title,
            "tools": list(hand.choices if hand else page.tools.choices),
            "role": client.role if client else LOOK,
            "people": [len(self.viewer.clients), self.viewer.most_clients],
            "tool": hand.tool if hand else page.tools.choices[0],
            "picked": hand.text if hand and hand.picked else "",
            "banner": self._banner(client),
            "facts": self._facts(browser, client),
            "tissue": self.viewer.source.has_tissue,
            "opens": self.viewer.on_open is not None,
            "undo": undo + page.cut_is_newest,
            "redo": redo,
            "plane": state.cuts.plane,
            "handles": [] if client is None else [one for panel in page.panels for one in panel.handles(browser)],
            "recording": saving.records(browser),
            "time": self._time(),
            "pull": self.pull(),
            "said": hand.said if hand else "",
            "layers": self._layers(),
            "color": {
                "by": state.color.by,
                "options": self.viewer.source.color_names(),
                "low": state.color.low,
                "high": state.color.high,
                "automatic": state.color.automatic,
                "beyond": self.viewer.source.maker.beyond if state.color.by and state.color.automatic else 0,
            },
            "plot": self._histogram(),
            "line": self._line(client),
            "series": over_time(self.viewer.source, self.series.get(browser.client_id, "")),
            "compare": state.compare.at if self.viewer.source.kind == "compare" else None,
            "sides": getattr(self.viewer.source, "sides", []),
        }

    def pull(self) -> str:
        """The force for the label beside a pointer that holds tissue; "": none is held."""
        return getattr(self.viewer.source, "pull_words", str)()

    def _line(self, client: Any) -> dict[str, Any] | None:
        """The values along the measured line, with the unit of lengths."""
        profile = client.profile if client else None
        return profile and {**profile, "unit": self.viewer.source.unit}

    def _banner(self, client: Any) -> str:
        """What the person waits for."""
        if client is None:
            return ""
        if not client.number:
            return "Making the first image …"
        engine = self.viewer.engine
        since = client.since
        return "Computing the image …" if since is not None and engine.clock() - since > SLOW else ""

    def _facts(self, browser: Any, client: Any) -> str:
        """The table of statistics, for a browser that shows it."""
        if client is None or self.sections.get(browser.client_id) != "Statistics":
            return ""
        panel = next(p for p in self.viewer.page.panels if type(p).__name__ == "Statistics")
        return panel.table(client)

    def _time(self) -> dict[str, Any] | None:
        source, time = self.viewer.source, self.viewer.state.time
        if source.kind == "sequence":
            return {
                "kind": "sequence",
                "running": time.playing,
                "frame": min(time.frame, source.n_frames - 1),
                "frames": source.n_frames,
                "loop": time.loop,
                "words": f"{source.frame + 1} / {source.n_frames}",
            }
        if source.kind in ("simulation", "sweep"):
            words = source.status().replace("**", "").replace("  \n", " · ")
            told = {"kind": source.kind, "running": source.running, "words": words}
            if source.kind == "simulation":
                told["frame"], told["frames"] = source.place
            return told
        return None

    def _layers(self) -> list[dict[str, Any]]:
        gone = hidden(self.viewer.state)
        return [
            {"name": name, "kind": kind, "shown": i not in gone}
            for i, (name, kind) in enumerate(layer_names(self.viewer.source))
        ]

    def _histogram(self) -> dict[str, Any] | None:
        """How often the coloring values occur between the ends of the color map."""
        source, color = self.viewer.source, self.viewer.state.color
        scene = source.maker.last_scene
        if not color.by or scene is None or isinstance(scene, Mesh):
            return None
        particles = scene.particles
        ends = source.maker.range
        what = id(particles), source.version, color.by, color.colormap, ends
        if what != self._counted:
            try:
                values = attribute_values(particles, color.by)
            except ValueError:  # shown for a moment only
                return None
            values = values[:: 1 + len(values) // MOST_COUNTED]
            values = values[np.isfinite(values)]
            lo, hi = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
            if not hi > lo:  # one value says nothing more in a plot
                self._counted, self._plot = what, None
                return None
            counts = np.histogram(values, BINS, (lo, hi))[0]
            middles = np.linspace(lo, hi, BINS)
            low, high = ends if ends[1] > ends[0] else (lo, hi)
            linear = colorize(middles, colormap_of(color.by, color.colormap), low, high)
            self._plot = {
                "counts": counts.tolist(),
                "colors": displayed(linear).tolist(),
                "lo": lo,
                "hi": hi,
                "from": low,
                "to": high,
                "name": color.by,
            }
            self._counted = what
        return self._plot
