"""Cameras that move: key frames with smooth interpolation, and the turntable."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.checks import shown, whole
from .._base.structured import parse_json, parse_toml, read_text
from .camera import Camera

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

FIELDS = ("frame", "time", "eye", "look_at", "up", "fov")
MOST_FRAMES = 1_000_000  # of a movie
LEAST_GAP = 1e-6  # frames between two keys


class CameraPath:
    """A camera for every frame, through key frames.

    A smooth path is a centripetal Catmull-Rom curve (Yuksel et al. 2011: no cusps and no loops
    between keys). The camera moves along the path forwards only, at a speed without jumps. Two keys
    with the same eye hold the eye still. A linear path has corners at its keys. Before the first
    key and after the last, the camera stands still.

    Args:
        keys: mappings with `frame` (a number, from 0) or `time` (seconds), rising; `eye` and
            `look_at`, (3,) world; `up`, (3,), default (0, 1, 0); `fov`, vertical degrees, default
            40. Values that a later key omits stay.
        fps: frames per second, for keys with `time`.
        interpolation: "smooth" or "linear".

    Raises:
        ValueError: naming the key (the first is key 1), the field, the expected and the given
            value.
    """

    def __init__(self, keys: Sequence[dict[str, Any]], fps: float = 30.0, interpolation: str = "smooth"):
        if interpolation not in ("smooth", "linear"):
            raise ValueError(f"interpolation: expected smooth or linear, got {interpolation!r}")
        frames, cameras = _checked(keys, fps)
        self.frames = np.array(frames)
        smooth = interpolation == "smooth"
        self._tracks = {
            name: _Track(self.frames, np.array([getattr(c, name) for c in cameras]), smooth)
            for name in ("eye", "look_at", "up", "fov")
        }

    @classmethod
    def load(cls, path: str | os.PathLike[str], fps: float = 30.0) -> CameraPath:
        """A path from a TOML or JSON file: a list `key` of key frames, and `interpolation`.

        Args:
            path: ending in .toml or .json.
            fps: frames per second, for keys with `time`.

        Raises OSError, and ValueError naming the file and the key.
        """
        try:
            facts = _parsed(path)
            unknown = set(facts) - {"key", "interpolation"}
            if unknown:
                name = sorted(unknown)[0][:60]
                raise ValueError(f"{name}: expected key and interpolation, got another name")
            return cls(facts.get("key", []), fps, facts.get("interpolation", "smooth"))
        except ValueError as error:
            raise ValueError(f"{os.fspath(path)}: {error}") from error

    @property
    def n_frames(self) -> int:
        """Number of frames up to and including the last key."""
        return math.floor(self.frames[-1] + 1e-6) + 1

    def __call__(self, frame: float) -> Camera:
        """The camera of a frame, counted from 0; fractions of frames too."""
        at = {name: track(frame) for name, track in self._tracks.items()}
        return Camera(at["eye"], at["look_at"], at["up"], float(at["fov"]))


def orbit(camera: Camera, turns: float = 1.0, n: int = 120) -> list[Camera]:
    """The turntable: `n` cameras on a circle around `look_at`, about the `up` axis.

    The first camera is `camera` itself. One more step after the last camera completes the turns: a
    whole number of turns loops without a jump.

    Args:
        camera: where the circle begins.
        turns: full circles; positive turns run anticlockwise as seen from above.
        n: number of cameras, at least 1.
    """
    whole("n", n, 1, 2**31)
    axis = np.asarray(camera.up) / np.linalg.norm(camera.up)
    middle, arm = np.asarray(camera.look_at), np.subtract(camera.eye, camera.look_at)
    along = (arm @ axis) * axis
    across = arm - along
    side = np.cross(axis, across)
    angles = 2 * np.pi * turns * np.arange(n) / n
    eyes = middle + along + np.outer(np.cos(angles), across) + np.outer(np.sin(angles), side)
    return [Camera(eye, camera.look_at, camera.up, camera.fov, camera.height) for eye in eyes]


def round_camera(camera: Camera, middle: ArrayLike) -> Camera:
    """The camera with the point of its line of sight as `look_at` that is nearest to the axis
    `up` through `middle` (3,), world: `orbit` then turns it about this axis."""
    eye, up = np.asarray(camera.eye), np.asarray(camera.up) / np.linalg.norm(camera.up)
    ahead = np.subtract(camera.look_at, eye)
    flat = ahead - (ahead @ up) * up
    away = np.subtract(middle, eye)
    share = (away @ flat) / (flat @ flat) if flat @ flat > 1e-12 * (ahead @ ahead) else 1.0
    return replace(camera, look_at=tuple((eye + share * ahead).tolist())) if share > 0 else camera


class _Track:
    """One quantity over the frames: values (K,) or (K, 3) at rising frames (K,)."""

    def __init__(self, frames: np.ndarray, values: np.ndarray, smooth: bool):
        from scipy.interpolate import CubicHermiteSpline, PchipInterpolator, make_interp_spline

        points = values.reshape(len(frames), -1)
        self.shape = values.shape[1:]
        self.frames = frames
        # Arc parameter: the root of the distance makes the curve centripetal.
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1) ** (0.5 if smooth else 1.0)
        arc = np.concatenate([[0.0], np.cumsum(gaps)])
        moved = np.concatenate([[True], gaps > 0])  # a key at the same place adds no knot
        knots, points = arc[moved], points[moved]
        self.along: Any = partial(np.interp, xp=frames, fp=arc)
        if len(knots) == 1:
            self.curve: Any = lambda _: points[0]
        elif smooth:
            # Never falls, with a slope of 0 beside a level stretch.
            self.along = PchipInterpolator(frames, arc)
            self.curve = CubicHermiteSpline(knots, points, _catmull_rom_slopes(knots, points))
        else:
            self.curve = make_interp_spline(knots, points, k=1)

    def __call__(self, frame: float) -> np.ndarray:
        frame = min(max(frame, self.frames[0]), self.frames[-1])
        return np.reshape(self.curve(self.along(frame)), self.shape)


def _catmull_rom_slopes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Slopes (K, C) of the parabola through each point and its neighbors; at the ends of the
    chord."""
    h, chord = np.diff(x)[:, None], np.diff(y, axis=0) / np.diff(x)[:, None]
    inner = (h[1:] * chord[:-1] + h[:-1] * chord[1:]) / (h[1:] + h[:-1])
    return np.concatenate([chord[:1], inner, chord[-1:]])


def _checked(keys: Any, fps: float) -> tuple[list[float], list[Camera]]:
    """Frame numbers and cameras of all keys, with what a key leaves out taken from the last."""
    if not isinstance(keys, (list, tuple)) or not keys:
        raise ValueError(f"key: expected a list of key frames, got {shown(keys)}")
    frames: list[float] = []
    cameras: list[Camera] = []
    state = {"up": (0.0, 1.0, 0.0), "fov": 40.0}
    unit = None
    for number, key in enumerate(keys, 1):
        try:
            if not isinstance(key, dict):
                raise ValueError(f"expected names with values, got {shown(key)}")
            unknown = set(key) - set(FIELDS)
            if unknown:
                raise ValueError(f"{sorted(unknown)[0][:60]}: expected one of {', '.join(FIELDS)}")
            given = [name for name in ("frame", "time") if name in key]
            if len(given) != 1 or unit not in (None, given[0]):
                wanted = unit or "frame or time"
                raise ValueError(f"expected {wanted}, got {' and '.join(given) or 'none'}")
            unit = given[0]
            frame = _number(unit, key[unit]) * (fps if unit == "time" else 1)
            if frame < 0 or (frames and frame < frames[-1] + LEAST_GAP):
                least = "at least 0" if not frames else "more than in the key before"
                raise ValueError(f"{unit}: expected {least}, got {shown(key[unit])}")
            if frame >= MOST_FRAMES:
                expected = f"expected at most {MOST_FRAMES:,} frames"
                raise ValueError(f"{unit}: {expected}, got {shown(key[unit])}")
            state.update({name: value for name, value in key.items() if name != unit})
            missing = {"eye", "look_at"} - set(state)
            if missing:
                raise ValueError(f"{sorted(missing)[0]}: expected in the first key, got none")
            cameras.append(
                Camera(
                    _vector("eye", state["eye"]),
                    _vector("look_at", state["look_at"]),
                    _vector("up", state["up"]),
                    _number("fov", state["fov"]),
                )
            )
            frames.append(frame)
        except ValueError as error:
            raise ValueError(f"key {number}: {error}") from None
    return frames, cameras


def _number(name: str, value: Any) -> float:
    real = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    if not (real and abs(value) <= sys.float_info.max):  # also not a whole number beyond it
        raise ValueError(f"{name}: expected a finite number, got {shown(value)}")
    return float(value)


def _vector(name: str, value: Any) -> tuple[float, ...]:
    if isinstance(value, str) or not hasattr(value, "__len__") or len(value) != 3:
        raise ValueError(f"{name}: expected three finite numbers, got {shown(value)}")
    return tuple(_number(name, v) for v in value)


def _parsed(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The file's contents; a JSON file may be the list of keys alone."""
    name = os.fspath(path).lower()
    data = read_text(path)
    if name.endswith(".toml"):
        facts = parse_toml(data)
    elif name.endswith(".json"):
        facts = parse_json(data)
        facts = {"key": facts} if isinstance(facts, list) else facts
    else:
        raise ValueError("expected a name ending in .toml or .json")
    if not isinstance(facts, dict):
        raise ValueError(f"expected names with values, got {type(facts).__name__}")
    return facts
