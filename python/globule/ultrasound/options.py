"""What is done with the pixels of a sweep: settings of a reconstruction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from .._base.settings import Choice, Number, Switch, Whole, check_all, setting

METHODS = ("frames", "pvn-om", "vvn-om", "pvn", "vvn", "bezier")
COMPOUNDINGS = ("mean", "maximum", "latest", "first", "median")
HOLE_WEIGHTS = ("normalized", "printed")


class Odd(Whole):
    """An odd whole number."""

    noun = "an odd number"

    def _take(self, value: Any) -> Any:
        if super()._take(value) % 2 == 0:
            raise self.wrong(value)
        return int(value)


@dataclass(frozen=True)
class Options:
    """What is done with the pixels. Raises TypeError and ValueError naming the wrong one."""

    method: str = setting(
        Choice(*METHODS), "pvn-om", "reconstruction method",
        usual="frames; pvn-om with --live and --voxel-size, and with another --compounding than "
        "mean",
    )  # fmt: skip
    max_kernel: int = setting(Odd(1, 253), 9, "hole filling: side of the largest kernel, odd; 1 "
        "leaves all holes", "voxels")  # fmt: skip
    compounding: str = setting(Choice(*COMPOUNDINGS), "mean", "how pixels of one voxel combine")
    hole_weights: str = setting(Choice(*HOLE_WEIGHTS), "normalized", "hole filling: weights, "
        "normalized or as printed in the source")  # fmt: skip
    max_distance: float | None = setting(Number(0.0), None, "hole filling: largest distance of a "
        "voxel from any pixel", "mm",
        usual="no limit; frames: half of five usual steps between frames")  # fmt: skip
    extrapolate: bool = setting(Switch(), False, "also fill holes that do not lie between data",
        usual="only holes between data")  # fmt: skip

    def __post_init__(self) -> None:
        for name, value in check_all(self).items():
            object.__setattr__(self, name, value)
        if self.method != "pvn-om" and self.compounding != "mean":
            expected = f"expected mean for method {self.method}"
            raise ValueError(f"compounding: {expected}, got {self.compounding!r}")

    def max_gap(self, spacing: float) -> float | None:
        """Farthest that two frames may be apart with values between them, voxels; None: default."""
        return None if self.max_distance is None else 2 * self.max_distance / spacing

    def reach(self, spacing: float) -> int:
        """Largest radius of a hole's kernel, voxels."""
        reach = (self.max_kernel - 1) // 2
        if self.max_distance is not None:
            reach = min(reach, math.floor(self.max_distance / spacing + 1e-9))
        return reach
