"""Two data sets in one image: the first left of a divider, the second right of it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .._base.arrays import box_corners
from ..data.attributes import attribute_values
from ..data.particles import Particles
from ..render.frame import Frame, Picked
from ..render.layers import Layer
from .scenes import usual_range
from .source import Origin, Source
from .state import State

JOINED = ("color", "image", "picture", "distance", "position", "normal", "albedo", "mask")


class CompareSource(Source):
    """Two sources with one camera, one light and one range of colors.

    Args:
        first, second: sources of the kind "scene".

    Raises:
        ValueError: a source that changes in time, or a volume.
    """

    kind = "compare"

    def __init__(self, first: Source, second: Source):
        super().__init__(f"{first.name} | {second.name}")
        for source in (first, second):
            if source.kind != "scene":
                raise ValueError(
                    f"compare: expected particles or meshes that do not change, got a {source.kind}: {source.name}"
                )
        self.first, self.second = first, second
        self.maker, self.files, self.up = first.maker, first.files, first.up
        self.reading, self.beside = first.reading, first.beside

    @property
    def sides(self) -> list[str]:
        """The names left and right of the divider."""
        return [self.first.name, self.second.name]

    @property
    def is_mesh(self) -> bool:
        """Whether the first layer is a mesh."""
        return getattr(self.first, "is_mesh", False)

    def particles(self) -> Particles:
        """The particles of the first data set."""
        return self.first.particles()

    def layers(self, state: State) -> list[Layer]:
        """The layers of the first data set. The caller holds `lock`."""
        return self.first.layers(self.shared(state))

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) of both, world."""
        ends = [source.bounds() for source in (self.first, self.second)]
        lo, hi = (np.array(corners) for corners in zip(*ends, strict=True))
        return lo.min(axis=0), hi.max(axis=0)

    def outline(self) -> np.ndarray:
        """The corners of a box around both."""
        return box_corners(*self.bounds())

    def color_names(self) -> list[str]:
        """The fields and attributes that both have."""
        known = set(self.second.color_names())
        return [name for name in self.first.color_names() if name in known]

    def shared(self, state: State) -> State:
        """The settings with one range of colors for both data sets."""
        if not (state.color.by and state.color.automatic):
            return state
        found = [attribute_values(source.particles(), state.color.by) for source in (self.first, self.second)]
        (lo, hi), _ = usual_range(np.concatenate([one[np.isfinite(one)] for one in found]))
        other = state.snapshot()
        other.color = dataclasses.replace(state.color, automatic=False, low=lo, high=hi)
        return other

    def origin(self, state: State) -> Origin:
        """How to get the first data set without the viewer."""
        found = self.first.origin(state)
        found.left.append("the second data set")
        return found

    def close(self) -> None:
        """Close both."""
        self.first.close()
        self.second.close()


class Split:
    """Two frames of one size as one: columns left of a share of the width from the first.

    It has what the viewer needs of a `Frame`, and its arrays.
    """

    def __init__(self, left: Frame, right: Frame, at: float):
        self._frames = left, right
        self.size = left.size
        self._layers = (*left._layers, *right._layers)
        self._at = round(at * left.size[0])

    @property
    def samples(self) -> int:
        """Rays per pixel so far."""
        return min(frame.samples for frame in self._frames)

    def refine(self, samples: int = 1) -> Split:
        """Add samples to both frames; one that was interrupted catches up."""
        wanted = self.samples + samples
        for frame in self._frames:
            if frame.samples < wanted:
                frame.refine(wanted - frame.samples)
        return self

    def pick(self, column: int, row: int) -> Picked | None:
        """The data behind a pixel."""
        return self.part(column).pick(column, row)

    def part(self, column: int) -> Frame:
        """The frame that a column shows."""
        return self._frames[column >= self._at]

    def __getattr__(self, name: str) -> Any:
        if name not in JOINED:
            raise AttributeError(name)
        left, right = (getattr(frame, name) for frame in self._frames)
        return np.concatenate([left[:, : self._at], right[:, self._at :]], axis=1)
