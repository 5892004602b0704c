"""The mouse tools: clicks and strokes in the image. Each browser has its own tool."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any

import numpy as np

from ..._base.terminal import plain_number
from ...data.attributes import attribute_values
from ...render.frame import Picked
from ..compare_source import Split
from ..engine import Client
from ..markdown import table
from ..overlay import RED, Mark
from ..plots import line_mark
from ..roles import STEER
from ..source import Probed
from ..state import Names
from .widgets import safe

ROTATE, MEASURE, CUT = "Rotate, pick", "Measure", "Cut"
GRASP, SUCTION = "Grasp", "Suction"
DRAGGED = (CUT, GRASP, SUCTION)  # tools with which a drag does not rotate the view
SAID = {
    ROTATE: "",
    MEASURE: "Click two points of the surface.",
    CUT: "Draw a line across the surface to cut it.",
    GRASP: "Run the simulation, then drag a part of the surface.",
    SUCTION: "Run the simulation, then drag over the fluid to remove it.",
}
MOST_POINTS = 400  # of a stroke
MISSED = 0.01  # of the image's height, by which a click may miss the surface
STAYS = 4.0  # s that a stroke is shown
WOUND = (60, 8, 12)
LONGEST = 12  # attributes in the panel
MOVING = ("surface.", "cuts.", "slices.", "layers.", "time.frame")  # settings after which other surfaces are seen


class Tools:
    """The tools that the source allows, and the `Hand` of each browser."""

    def __init__(self, page: Any):
        self.page = page
        self.hands: dict[int, Hand] = {}
        self.unit = f" {page.viewer.source.unit}".rstrip()
        self.choices: tuple[str, ...] = (ROTATE, MEASURE, CUT)
        if hasattr(page.viewer.source, "grasp"):
            self.choices += (GRASP,)
        if getattr(page.viewer.source, "suction", lambda: None)():
            self.choices += (SUCTION,)
        page.viewer.state.listen(self._follow)
        command = page.gui.add_command("Next tool", "T")
        command.private = True
        command.on_trigger(safe(page)(lambda event: self.hands[event.client_id].next_tool()))

    def _follow(self, changed: Names) -> None:
        """What was picked may not be there any more."""
        if any(name.startswith(MOVING) for name in changed):
            for hand in [*self.hands.values()]:
                if hand.picked:
                    hand.use(hand.tool)

    def choices_of(self, client: Client) -> tuple[str, ...]:
        """The tools of a browser; who looks has those that change nothing."""
        harmless = (ROTATE, MEASURE)
        return self.choices if client.role == STEER else harmless

    def connected(self, browser: Any, client: Client) -> None:
        """Add the hand of a browser."""
        self.hands[browser.client_id] = Hand(self, browser, client)

    def disconnected(self, browser: Any) -> None:
        """Remove the hand of a browser."""
        self.hands.pop(browser.client_id, None)


class Hand:
    """The tool of one browser, and its marks."""

    def __init__(self, tools: Tools, browser: Any, client: Client):
        self.tools, self.page, self.browser, self.client = tools, tools.page, browser, client
        self.choices = tools.choices_of(client)
        self.viewer = tools.page.viewer
        self.picked: list[Picked | Probed] = []
        self.unit = tools.unit
        self.stroke: list[tuple[float, float]] = []
        self.tool, self.text = ROTATE, ""
        self._drawing = False
        self._seen: tuple[Any, np.ndarray] | None = None

    @property
    def said(self) -> str:
        """What the tool asks for or has found, for a note below the toolbar: the first line;
        without the values of a picked point, which are a table."""
        text = self.text.partition("\n")[0].strip()
        if self.tool == MEASURE and text.startswith("|"):
            return "Click the second point."
        return "" if text.startswith("|") else text.replace("*", "")

    def say(self, text: str) -> None:
        """Say a sentence in Markdown."""
        self.text = text
        self.page.desk.refresh()

    def next_tool(self) -> None:
        """Select the next tool."""
        self.use(self.choices[(self.choices.index(self.tool) + 1) % len(self.choices)])

    def use(self, tool: Any) -> None:
        """Select a tool by its name and remove the marks of the last one. Raises ValueError."""
        if tool not in self.choices:
            expected = ", ".join(self.choices)
            raise ValueError(f"tool: expected one of {expected}, got {str(tool)[:40]}")
        self.tool = tool
        self.picked = []
        self.client.line = None
        self.client.mark([])
        self.say(SAID[tool])

    # Clicks

    def click(self, place: tuple[float, float]) -> None:
        """A click or tap at a place (0, 0) to (1, 1) of the image."""
        if self.tool in DRAGGED:
            return
        found = self.pick(place)
        if found is None:
            if self.tool != MEASURE:  # whose first point stays
                self.picked = []
                self.client.mark([])
            self.say("There is no surface here.")
            return
        self.picked = [*self.picked, found][-2:] if self.tool == MEASURE else [found]
        if self.tool == MEASURE and len(self.picked) == 2:
            a, b = (np.asarray(p.position, np.float64) for p in self.picked)
            distance = float(np.linalg.norm(b - a))
            self.say(f"**Distance {distance:.6g}{self.unit}**  \nfrom {_words(a)} to {_words(b)}")
            self._keep_line(a, b)
            return
        x, y, z = (float(v) for v in found.position)
        if isinstance(found, Probed):
            title, told = found.words.get("value", ""), table(found.words)
        else:
            title, told = titled(found, self.viewer.state.color.by, self.unit), describe(found, self.unit)
        self.say(told)
        self.client.mark([Mark(((x, y, z),), "" if self.tool == MEASURE else title, RED)])

    def _keep_line(self, a: np.ndarray, b: np.ndarray) -> None:
        """Keep a measurement in the settings; of a browser that looks: for itself."""
        if self.client.role == STEER:
            self.client.mark([])
            start, end = tuple(a.tolist()), tuple(b.tolist())
            self.viewer.state.set(measure__shown=True, measure__start=start, measure__end=end)
            return
        self.client.line = np.array([a, b])
        self.client.mark([line_mark(self.client.line, self.unit)])

    def pick(self, screen: tuple[float, float]) -> Picked | Probed | None:
        """The surface or slice at a place (0, 0) to (1, 1) of this browser's image, or None."""
        frame = self.client.frame
        if frame is None:
            return None
        column, row = self._pixel(frame, screen)
        # A person waits; the images of others go on where the person only looks.
        self.viewer.engine.interrupt(None if self.client.role == STEER else self.client)
        with self.viewer.source.lock:
            found = frame.pick(column, row)
            if found is None and (near := self._nearest(frame, column, row)) is not None:
                found = frame.pick(*near)
            if found is not None:
                add_color(found, frame.part(column) if isinstance(frame, Split) else frame, self.viewer.state.color.by)
            before = self.viewer.source.probe(
                self.viewer.state.snapshot(),
                self.client.camera,
                frame.size,
                screen,
                np.inf if found is None else found.distance,
            )
            return before or found

    def _nearest(self, frame: Any, column: int, row: int) -> tuple[int, int] | None:
        """The pixel with a surface that is nearest to another, if it is within `MISSED`."""
        reach = max(1, round(MISSED * frame.size[1]))
        left, top = max(0, column - reach), max(0, row - reach)
        near = self._depth(frame)[top : row + reach + 1, left : column + reach + 1]
        rows, columns = np.nonzero(np.isfinite(near))
        far = np.hypot(columns + left - column, rows + top - row)
        if not far.size or far.min() > reach:
            return None
        i = int(far.argmin())
        return left + int(columns[i]), top + int(rows[i])

    @staticmethod
    def _pixel(frame: Any, screen: tuple[float, float]) -> tuple[int, int]:
        width, height = frame.size
        return (int(np.clip(screen[0] * width, 0, width - 1)), int(np.clip(screen[1] * height, 0, height - 1)))

    # Strokes

    def drag(self, value: Any) -> None:
        """A part of a drag: its phase ("start", "move", "end"), its first place and the present one,
        (0, 0) to (1, 1) of the image. Raises ValueError."""
        from ..desk import place_of

        if not (isinstance(value, list) and len(value) == 3 and value[0] in ("start", "move", "end")):
            raise ValueError(f"page: expected a part of a drag, got {str(value)[:40]}")
        if self.tool in DRAGGED:
            self._drawn(value[0], place_of(value[1]), place_of(value[2]))

    def _drawn(self, phase: str, start: tuple, here: tuple) -> None:
        if phase == "start":
            self.stroke, self._drawing = [start], True
        if not self._drawing:  # a late move after the end
            return
        self._drawing = phase != "end"
        if len(self.stroke) < MOST_POINTS:
            self.stroke.append(here)
        if self.tool == GRASP:
            self.viewer.source.grasp(self, phase, start, here)
            return
        if self.tool == SUCTION:
            self.viewer.source.suck(self, phase, here)
            return
        if phase != "end":
            label = getattr(self.viewer.source, "cut_words", str)()
            self.client.mark([Mark(tuple(self.along_stroke()), label, RED)])
            return
        points, self.stroke = self.along_stroke(), []
        self.client.mark([])
        if len(points) > 1:
            said = self.page.viewer.cut_along(points, self.client.camera)
            self.say(said)
            self._leave(Mark(tuple(points), "", WOUND, thin=True))

    def _leave(self, mark: Mark) -> None:
        """Show the stroke for a moment."""
        left = [mark]
        self.client.mark(left)

        def gone() -> None:
            if self.client.marks is left:
                self.client.mark([])

        timer = threading.Timer(STAYS, gone)
        timer.daemon = True
        timer.start()

    def along_stroke(self) -> list[tuple[float, float, float]]:
        """The points of the stroke on the surface, (x, y, z) each, world."""
        return self.on_surface(self.stroke)

    def on_surface(self, screens: list) -> list[tuple[float, float, float]]:
        """Points, world, at places (0, 0) to (1, 1) of the image.

        Beside the surface, the median distance of the other points applies.
        """
        frame = self.client.frame
        if frame is None:
            return []
        depth = self._depth(frame)
        pixels = [self._pixel(frame, screen) for screen in screens]
        found = np.array([depth[row, column] for column, row in pixels], np.float64)
        hit = np.isfinite(found)
        camera = self.client.camera
        usual = (
            float(np.median(found[hit]))
            if hit.any()
            else float(np.linalg.norm(np.subtract(camera.look_at, camera.eye)))
        )
        points = []
        for screen, far in zip(screens, np.where(hit, found, usual), strict=True):
            origin, direction = camera.ray(frame.size, screen)
            points.append(tuple((origin + far * direction).tolist()))
        return points

    def in_the_middle(self) -> tuple[float, float, float] | None:
        """The point of the surface that is nearest to the middle of the image, world."""
        frame = self.client.frame
        if frame is None:
            return None
        depth = self._depth(frame)
        rows, columns = np.nonzero(np.isfinite(depth))
        if not len(rows):
            return None
        height, width = depth.shape
        i = int(np.hypot(columns - width / 2, rows - height / 2).argmin())
        place = (columns[i] + 0.5) / width, (rows[i] + 0.5) / height
        origin, direction = self.client.camera.ray(frame.size, place)
        x, y, z = (origin + depth[rows[i], columns[i]] * direction).tolist()
        return x, y, z

    def _depth(self, frame: Any) -> np.ndarray:
        """The distances (H, W) of the frame, fetched once."""
        if self._seen is None or self._seen[0] is not frame:
            self._seen = frame, frame.distance
        return self._seen[1]


def add_color(found: Picked, frame: Any, by: str) -> None:
    """Put the value that colors a picked particle first; its other attributes may not name it (speed)."""
    if found.particle is None or by in ("", *"xyz", *found.attributes):
        return
    scene = frame._layers[found.layer].scene
    with suppress(ValueError):  # another layer may not have it
        own = {by: attribute_values(scene.particles[[found.particle]], by)[0]}
        others = dict(found.attributes)
        found.attributes.clear()
        found.attributes.update(own | others)


def titled(found: Picked, by: str, unit: str = "") -> str:
    """What stands beside a picked point: the value that colors it, else its particle."""
    if by in found.attributes:
        return f"{by} {_words(found.attributes[by])}"
    if by in ("x", "y", "z"):
        return f"{by} {_words(found.position['xyz'.index(by)])}{unit}"
    return f"particle {found.particle:,}"


def describe(found: Picked, unit: str = "") -> str:
    """A picked point as a table for the panel; unit: of lengths."""
    rows = {
        "position": _words(found.position) + unit,
        "normal": _words(found.normal),
        "distance": f"{found.distance:.6g}{unit}",
        "particle": f"{found.particle:,}",
    }
    if found.layer:
        rows["layer"] = str(found.layer)
    for name, value in list(found.attributes.items())[:LONGEST]:
        rows[name] = _words(value)
    return table(rows)


def _words(values: Any) -> str:
    return ", ".join(plain_number(v, 5) for v in np.ravel(values))
