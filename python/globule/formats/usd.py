"""Universal Scene Description: `UsdGeomPoints` and `UsdGeomPointInstancer`, read and written by
usd-core.

Only the layer itself is read: references, payloads, sublayers and value clips, which name other
files, are not followed. Points get the transform of their prim at the frame's time. A width is a
diameter, so that the support is twice the width. Times are time codes over
`timeCodesPerSecond`. Prims and instances that are invisible at that time are left out; lengths are
in the layer's units of `metersPerUnit`, and its `upAxis` is what particles have upwards.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .._base.checks import missing
from .._base.files import atomic_write
from ..data.particles import UP, Z_UP, Particles
from .contents import Contents, frame_index
from .errors import bad, shown
from .fields import kept_positions, particles_from, per_particle
from .guarded import decode, need

_OWN = {"displayColor": "color", "velocities": "velocity", "ids": "id", "widths": "width"}


def read(path: str | os.PathLike[str], frame: int = 0, species: str | None = None) -> Contents:
    """Read a frame of the points of a layer.

    Args:
        path: .usd, .usda or .usdc.
        frame: number of a time sample of the points; negative counts from the end.
        species: path of a prim, "/World/fluid", visible or not; None: all visible points of the
            layer, with the arrays that all of them have.

    Raises FormatError, ValueError for a frame or species that the file does not have,
    MissingPackageError without usd-core.
    """
    need("pxr", "usd-core", "usd")
    about: dict[str, Any] = {}

    def choose(claim: dict) -> tuple[float, Any]:
        about.update(claim)
        prims = claim["prims"]
        if not prims:
            raise bad(path, "", "expected prims of type Points or PointInstancer, got none")
        if species is not None and species not in prims:
            raise ValueError(f"species: expected one of {shown(', '.join(prims))} for {path}, got {species!r}")
        times = claim["times"]
        wanted = times[frame_index(path, frame, len(times))] if times else None
        if not times:
            frame_index(path, frame, 1)
        about["time"] = wanted
        return 0.0, [[species], wanted, False] if species is not None else [prims, wanted, True]

    facts, sent = decode("usd", path, "a USD layer", choose=choose)
    parts: list[dict[str, np.ndarray]] = [{} for _ in facts["names"]]
    coming = iter(sent)
    for part, names in zip(parts, facts["names"], strict=True):
        part.update({name: next(coming) for name in names})
    arrays = _joined(path, parts)
    positions = arrays.pop("points")
    if "support" in arrays:
        arrays.pop("widths", None)
    arrays = {_OWN.get(name, name): array for name, array in arrays.items()}
    if "width" in arrays:
        arrays["radius"] = 0.5 * arrays.pop("width")
    time, rate = about["time"], about["rate"]
    unit = about["unit"]
    particles = particles_from(path, positions, arrays)
    particles.up = Z_UP if about["up"] == "Z" else UP
    return Contents(
        particles,
        units={"positions": "m" if unit == 1 else f"{unit:g} m"},
        time=None if time is None else time / rate,
        n_frames=max(len(about["times"]), 1),
        species=tuple(about["prims"]),
    )


def read_up(path: str | os.PathLike[str]) -> tuple[float, float, float]:
    """The direction of a layer's `upAxis`."""
    need("pxr", "usd-core", "usd")
    about: dict[str, Any] = {}

    def choose(claim: dict) -> tuple[float, Any]:
        about.update(claim)
        return 0.0, [[], None, False]

    decode("usd", path, "a USD layer", choose=choose)
    return Z_UP if about["up"] == "Z" else UP


def _joined(path: Any, parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays that all parts have, one after the other; no points where there are no parts."""
    if not parts:
        return {"points": np.empty((0, 3), np.float32)}
    for part in parts:
        n = len(part["points"])
        for name in list(part):
            if len(part[name]) != n:  # of one value for all, or of faces
                del part[name]
    names = [n for n in parts[0] if all(n in p and p[n].shape[1:] == parts[0][n].shape[1:]
                                        for p in parts)]  # fmt: skip
    if "points" not in names:
        raise bad(path, "points", "expected shape (N, 3)")
    if len(parts) == 1:
        return parts[0]
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write the prim `/particles` of type Points: ASCII for .usda, else binary.

    Fields and attributes are primvars, so that globule reads back what it wrote; `widths`,
    `velocities`, `ids` and the color `displayColor` are where other programs look for them.

    Raises ValueError for an attribute's name that USD does not allow, MissingPackageError.
    """
    try:
        from pxr import Sdf, Usd, UsdGeom, Vt
    except ImportError:
        raise missing("usd-core", "usd") from None
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Z" if particles.up == Z_UP else "Y")
    points = UsdGeom.Points.Define(stage, "/particles")
    stage.SetDefaultPrim(points.GetPrim())
    x = kept_positions(particles, path)
    points.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(x))
    variables = UsdGeom.PrimvarsAPI(points)
    arrays = per_particle(particles)
    if "support" in arrays:
        points.CreateWidthsAttr(Vt.FloatArray.FromNumpy(np.float32(0.5) * arrays["support"]))
        points.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
    known = {"f4": ("Float", Vt.FloatArray), "f8": ("Double", Vt.DoubleArray),
             "i4": ("Int", Vt.IntArray), "i8": ("Int64", Vt.Int64Array),
             "u1": ("UChar", Vt.UCharArray), "u4": ("UInt", Vt.UIntArray),
             "u8": ("UInt64", Vt.UInt64Array)}  # fmt: skip
    wider = {"b1": "u1", "i1": "i4", "i2": "i4", "u2": "u4", "f2": "f4"}
    for name, array in arrays.items():
        if name == "color":
            colors = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array, np.float32))
            points.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(colors)
            continue
        kind = array.dtype.str[1:]
        if name == "velocity" and kind == "f4" and array.shape[1:] == (3,):
            points.CreateVelocitiesAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array)))
            continue
        if name == "id" and kind == "i8" and array.ndim == 1:
            points.CreateIdsAttr(Vt.Int64Array.FromNumpy(np.ascontiguousarray(array)))
            continue
        if not Sdf.Path.IsValidNamespacedIdentifier(name):
            raise ValueError(f"attributes[{name!r}]: expected a name that USD allows: letters, "
                             "digits and _, not a digit first")  # fmt: skip
        kind = wider.get(kind, kind)
        word, vector = known[kind]
        values = np.ascontiguousarray(array.astype(kind).ravel())
        variable = variables.CreatePrimvar(
            name, getattr(Sdf.ValueTypeNames, f"{word}Array"), UsdGeom.Tokens.vertex,
            array.shape[1] if array.ndim == 2 else -1,
        )  # fmt: skip
        variable.Set(vector.FromNumpy(values))
    text = os.fspath(path).lower().endswith(".usda")
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / ("a.usda" if text else "a.usdc")
        stage.GetRootLayer().Export(str(made))
        with atomic_write(path) as file:
            file.write(made.read_bytes())
