"""A PLUS toolkit configuration, as far as it steers volume reconstruction."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...formats.asciinum import numbers_of_words
from ...formats.errors import FormatError, bad, shown
from ...formats.xml import parse_xml

INTERPOLATIONS = ("NEAREST_NEIGHBOR", "LINEAR")
OPTIMIZATIONS = ("NONE", "PARTIAL", "FULL")
COMPOUNDINGS = ("LATEST", "MAXIMUM", "MEAN", "IMPORTANCE_MASK")
FILLERS = ("GAUSSIAN", "GAUSSIAN_ACCUMULATION", "DISTANCE_WEIGHT_INVERSE", "NEAREST_NEIGHBOR", "STICK")

LEAST_SPACING, MOST_SPACING = 1e-6, 1e6  # mm, of voxels


@dataclass
class Filler:
    """One HoleFillingElement; `size` is the kernel's edge or the longest stick, in voxels."""

    type: str
    size: int
    n_sticks: int = 1
    deviation: float = 0.0
    least_ratio: float = 0.0

    def weights(self) -> np.ndarray:
        """The kernel (size, size, size) float32, as PLUS computes it; empty where there is none."""
        n = self.size
        if self.type in ("STICK", "NEAREST_NEIGHBOR"):
            return np.empty(0, np.float32)
        offset = np.arange(n, dtype=np.float64) - np.float32((n - 1) / 2)
        if self.type == "DISTANCE_WEIGHT_INVERSE":
            o = offset.astype(np.float32) ** 2
            distance = np.sqrt(o[None, None, :] + o[None, :, None] + o[:, None, None])
            with np.errstate(divide="ignore"):
                inverse = np.float32(1) / distance
            return np.where(distance > 0, inverse, np.float32(0)).astype(np.float32)
        deviation = np.float32(self.deviation)
        divisor = float(np.float32(float(deviation * deviation) * 2.0))
        term = np.float32((2 * np.pi) ** 1.5 * float(deviation) ** 3)
        e = offset**2 / divisor
        exponent = -((e[None, None, :] + e[None, :, None]) + e[:, None, None])
        return (float(np.float32(1) / term) * np.exp(exponent)).astype(np.float32)


@dataclass
class PlusConfig:
    """The VolumeReconstruction element; lengths are pixels but for the spacing, mm."""

    spacing: tuple[float, float, float]
    interpolation: str = "NEAREST_NEIGHBOR"
    optimization: str = "FULL"
    compounding: str = "MEAN"
    clip_origin: tuple[int, int] = (0, 0)
    clip_size: tuple[int, int] = (0, 0)
    fan_angles: tuple[float, float] = (0.0, 0.0)
    fan_origin: tuple[float, float] = (0.0, 0.0)
    fan_start: float = 0.0
    fan_stop: float = 500.0
    detect_fan: bool = False
    detect_brightness: float = 30.0
    detect_radius: int = 10
    rejection: float | None = None
    skip: int = 1
    recompute_spacing: bool = False
    fill_holes: bool = False
    fillers: list[Filler] = field(default_factory=list)
    importance_file: str | None = None


def read_plus_config(path: str | os.PathLike[str]) -> PlusConfig:
    """Read the VolumeReconstruction element of a PLUS configuration (.xml).

    Raises:
        FormatError: naming the line: the file is not XML, has declarations in a DOCTYPE, lacks the
            element, or a value has a wrong form.
        OSError: the file cannot be read.
    """
    path = Path(path)
    root = parse_xml(path, path.read_bytes())
    found = [e for e in root.iter() if e.tag.lower() == "volumereconstruction"]
    if not found:
        raise bad(path, f"line {root.line}", "expected an element VolumeReconstruction, got none")
    read = _Attributes(path, found[0])
    spacing = read.numbers("OutputSpacing", 3)
    if spacing is None:
        raise read.bad("VolumeReconstruction", "expected OutputSpacing, got none")
    if not all(LEAST_SPACING <= s <= MOST_SPACING for s in spacing):
        expected = f"expected {LEAST_SPACING:g} to {MOST_SPACING:g} mm"
        raise read.bad("OutputSpacing", f"{expected}, got {' '.join(f'{s:g}' for s in spacing)}")
    config = PlusConfig(spacing)
    read.into(config, "interpolation", read.choice("Interpolation", INTERPOLATIONS))
    read.into(config, "optimization", read.choice("Optimization", OPTIMIZATIONS))
    config.compounding = _compounding(read)
    for name, attribute in (("clip_origin", "ClipRectangleOrigin"), ("clip_size", "ClipRectangleSize")):
        value = read.numbers(attribute, 2)
        read.into(config, name, value and tuple(int(v) for v in value))
    read.into(config, "fan_angles", read.numbers("FanAngles", 2))
    read.into(config, "fan_angles", read.numbers("FanAnglesDeg", 2))
    read.into(config, "fan_origin", read.numbers("FanOrigin", 2))
    read.into(config, "fan_origin", read.numbers("FanOriginPixel", 2))
    read.into(config, "fan_stop", read.number("FanDepth"))
    read.into(config, "fan_start", read.number("FanRadiusStartPixel"))
    read.into(config, "fan_stop", read.number("FanRadiusStopPixel"))
    read.into(config, "detect_fan", read.flag("EnableFanAnglesAutoDetect", "TRUE", "FALSE"))
    read.into(config, "detect_brightness", read.number("FanAnglesAutoDetectBrightnessThreshold"))
    read.into(config, "detect_radius", read.integer("FanAnglesAutoDetectFilterRadiusPixel"))
    read.into(config, "rejection", read.number("PixelRejectionThreshold"))
    config.skip = max(read.integer("SkipInterval") or 1, 1)
    read.into(config, "recompute_spacing", read.flag("RecomputeOutputSpacing", "TRUE", "FALSE"))
    read.into(config, "fill_holes", read.flag("FillHoles", "ON", "OFF"))
    if config.fill_holes:
        config.fillers = [_filler(path, e) for e in found[0].iter() if e.tag.lower() == "holefillingelement"]
        if not config.fillers:
            raise read.bad("FillHoles", "expected a HoleFillingElement for ON, got none")
    name = found[0].get("ImportanceMaskFilename")
    if name:
        config.importance_file = str(path.parent / name)
    return config


class _Attributes:
    """Attributes of one element, checked."""

    def __init__(self, path: Path, element: Any):
        self.path, self.element = path, element

    def bad(self, name: str, problem: str) -> FormatError:
        return bad(self.path, f"line {self.element.line}, {name}", problem)

    @staticmethod
    def into(target: object, name: str, value: object) -> None:
        if value is not None:
            setattr(target, name, value)

    def numbers(self, name: str, n: int) -> tuple | None:
        text = self.element.get(name)
        if text is None:
            return None
        values = tuple(numbers_of_words(text.split()).tolist())
        if len(values) != n or not np.isfinite(values).all():
            raise self.bad(name, f"expected {n} numbers, got {shown(text)}")
        return values

    def number(self, name: str) -> float | None:
        values = self.numbers(name, 1)
        return None if values is None else values[0]

    def integer(self, name: str) -> int | None:
        value = self.number(name)
        if value is not None and value != int(value):
            raise self.bad(name, f"expected a whole number, got {value:g}")
        return None if value is None else int(value)

    def choice(self, name: str, names: tuple[str, ...]) -> str | None:
        text = self.element.get(name)
        if text is None:
            return None
        if text.upper() not in names:
            raise self.bad(name, f"expected {' or '.join(names)}, got {shown(text)}")
        return text.upper()

    def flag(self, name: str, yes: str, no: str) -> bool | None:
        text = self.choice(name, (yes, no))
        return None if text is None else text == yes


def _compounding(read: _Attributes) -> str:
    """CompoundingMode, or what the attributes that it replaced say."""
    mode = read.choice("CompoundingMode", COMPOUNDINGS)
    if mode is not None:
        return mode
    if read.choice("Calculation", ("WEIGHTED_AVERAGE", "MAXIMUM")) == "MAXIMUM":
        return "MAXIMUM"
    return "LATEST" if read.choice("Compounding", ("ON", "OFF")) == "OFF" else "MEAN"


def _filler(path: Path, element: Any) -> Filler:
    read = _Attributes(path, element)
    kind = read.choice("Type", FILLERS)
    if kind is None:
        raise read.bad("HoleFillingElement", "expected Type, got none")

    def needed(name: str, get: Callable[[str], Any]) -> Any:
        value = get(name)
        if value is None:
            raise read.bad(f"HoleFillingElement {kind}", f"expected {name}, got none")
        return value

    if kind == "STICK":
        size = needed("StickLengthLimit", read.integer)
        filler = Filler(kind, size, needed("NumberOfSticksToUse", read.integer))
    else:
        filler = Filler(kind, needed("Size", read.integer))
        filler.least_ratio = needed("MinimumKnownVoxelsRatio", read.number)
        if kind.startswith("GAUSSIAN"):
            filler.deviation = needed("Stdev", read.number)
    if not 1 <= filler.size <= 255:
        problem = f"expected a size of 1 to 255, got {filler.size}"
        raise read.bad(f"HoleFillingElement {kind}", problem)
    return filler
