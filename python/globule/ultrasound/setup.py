"""The user's facts about a probe: calibration, PLUS configuration, region."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..formats.errors import FormatError, bad
from ..formats.sweeps.transforms import Edges, Transform
from .calibration import Calibration, read_calibration
from .plus_setup import read_plus
from .region import checked_clip, checked_fan, region_mask


class Setup:
    """Calibration (or its .toml), PLUS configuration (.xml) and region, as `read_sweep` takes them.

    edges              transforms that do not change from frame to frame
    calibration        the calibration, or None
    image              name of the images' frame
    world              name of the world's frame, if the configuration says one
    """

    def __init__(
        self, calibration: Any = None, plus: Any = None, clip: Any = None, fan: Any = None,
        mask: Any = None,
    ):  # fmt: skip
        self._source = plus  # of the region, for messages
        if calibration is not None and not isinstance(calibration, Calibration):
            self._source = calibration
            calibration = read_calibration(calibration)
        config = read_plus(plus) if plus is not None else None
        self.calibration: Calibration | None = calibration
        self.edges: Edges = dict(config.edges) if config else {}
        if calibration is not None:
            self.edges["Image", "Probe"] = Transform(calibration.probe_from_image, np.array(True))
        self.image = config.image if config else "Image"
        self.world = config.world if config else None
        self._clip = checked_clip(clip) if clip is not None else None
        self._fan = checked_fan(fan) if fan is not None else None
        self._mask = mask
        for source in (calibration, config):
            if source is not None:
                self._clip = self._clip or source.clip
                self._fan = self._fan or source.fan

    @property
    def calibrated(self) -> bool:
        """Whether the place of the image on the probe is known."""
        return (self.image, "Probe") in self.edges

    @property
    def temporal_offset(self) -> float:
        """s, of the calibration."""
        return self.calibration.temporal_offset if self.calibration else 0.0

    def mask(self, shape: tuple[int, int], default: Any = None) -> np.ndarray | None:
        """The pixels that show tissue, (H, W) bool, None for all; `default` if no mask is given."""
        try:
            return region_mask(shape, self._clip, self._fan, default if self._mask is None else self._mask)
        except ValueError as error:
            if self._source is None or isinstance(error, FormatError):
                raise
            raise bad(self._source, "", str(error)) from None
