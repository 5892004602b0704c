"""Particle files, one module per format.

`read` chooses the format by the file's content, `write` by the name's ending, whatever its case.
The table `FORMATS` in `registry.py` has one line for each format; `docs/reference/formats.md` says
what each of them holds.

Which array of a file becomes which field of Particles is the same for all of them; see
`globule.formats.fields`.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from .._base.checks import choice, flag
from ..data.components import without_small_components
from ..data.particles import UP, Z_UP, Particles
from ..data.radii import with_halved_radii
from ..data.scale import lengths_of, scaled
from ..data.where import where
from .contents import Box, Contents
from .errors import FormatError, bad
from .fields import check_names, given_from, say_radii
from .frames import FrameOf, said, tells_frames
from .kind import Kind, kind_of, wrong_kind
from .packed import unpacked
from .registry import FORMATS, Format, format_named, formats, function_of
from .units import scaled_units

__all__ = ["EXTENSIONS", "READABLE", "WRITABLE", "Box", "Contents", "Format", "FormatError",
           "Kind", "kind_of", "read", "read_contents", "up_of", "write"]  # fmt: skip

_TABLES = ("csv", "tsv", "xyz")  # formats whose rows may be those of several frames
# Read and written; by globule alone, and by all that is installed.
EXTENSIONS = tuple(e for f in FORMATS if f.writes and not f.package for e in f.endings)
WRITABLE = (*EXTENSIONS, *(e for f in FORMATS if f.writes and f.package for e in f.endings))
READABLE = (*WRITABLE, *(e for f in FORMATS if not f.writes for e in f.endings))


def read(path: str | os.PathLike[str], **options: Any) -> Particles:
    """Read particles, or a mesh as particles, from a file with any extension.

    Args:
        path: of the file; one packed by gzip, bzip2, xz or zstd is unpacked.
        spacing: world units, for meshes only; see `globule.sample_mesh`.
        frame: which frame of a file with several; negative counts from the end. Default 0, with a
            warning where there are more.
        species: which group of particles of a file with several, by its name in the file.
        columns: field or attribute -> name of a column or data set in the file; "x", "y" and "z",
            or "positions", name the position. Everything that is not named is left out.
        origin: (x, y, z) float64, world, from which the positions are given; "auto": one near the
            particles where float32 would not keep the file's coordinates, else 0, 0, 0.
        where: a condition on the particles, such as "type == 1 and speed > 0.2"; see
            `globule.data.where`. After `scale`: lengths in it are scaled.
        scale: factor of all lengths, such as 0.001 for a file in mm; see `globule.data.scale`.
        min_component: number of particles; components of fewer are left out, with a warning that
            says how many; see `globule.data.components`. After `where` and `center`.
        center: whether particles that lie across periodic faces of the file's box are moved, by
            whole periods, so that they are whole and in its middle; see `Box.center`.
        radius_is: "radius", or "diameter" where the file's array `radius` holds diameters.

    Returns:
        Particles; positions (N, 3) float32 in the file's units. `read_contents` returns the box,
        the units and the time of the file, too.

    Raises FormatError (a ValueError) if the file has an unknown format, holds another kind of data
    (the message names the function that reads the file) or is damaged; ValueError for an option
    that the format does not have; MissingPackageError for a format whose library is not installed;
    FileNotFoundError and other OSErrors pass unchanged. Warns where no particle meets `where`.
    """
    contents = read_contents(path, **options)
    if contents.n_frames > 1 and "frame" not in options and not isinstance(path, FrameOf):
        what = f"{os.fspath(path)} has {contents.n_frames:,} frames, and this is the first"
        warnings.warn(f"{what}: read(path, frame=…) takes another, globule.sequence all", stacklevel=2)
    if not len(contents.particles) and options.get("where") is not None:
        warnings.warn(f"{said(path)}: no particle meets {options['where']!r}", stacklevel=2)
    return contents.particles


def read_contents(path: str | os.PathLike[str], **options: Any) -> Contents:
    """Read particles as `read` does, with the box, the units and the time of the file.

    Args, errors: as those of `read`.
    """
    condition = options.pop("where", None)
    origin, scale = options.pop("origin", "auto"), options.pop("scale", 1.0)
    center = flag("center", options.pop("center", False))
    least = options.pop("min_component", 1)
    radius_is = choice("radius_is", options.pop("radius_is", "radius"), ("radius", "diameter"))
    kind = kind_of(path, "particles")
    if kind.kind not in ("particles", "mesh"):
        raise wrong_kind(path, "particles or a mesh", kind)
    form = format_named(kind.format)
    if isinstance(path, FrameOf):
        options = {"frame": path.frame, **options}
    elif form.name in _TABLES and condition is not None and any(map(tells_frames, re.findall(r"\w+", condition))):
        options = {"frame": None, **options}  # the condition chooses of all rows
    for name in options:
        if name not in form.options:
            raise ValueError(f"{name}: expected no such option for {os.fspath(path)}, "
                             f"which holds {kind.kind} ({kind.format}), got one")  # fmt: skip
    columns = options.get("columns")
    if columns is not None and not isinstance(columns, Mapping):
        raise TypeError(f"columns: expected names by name, a dict, got {type(columns).__name__}")
    with unpacked(path, form.name == "bgeo") as plain:
        found = function_of(form)(plain, **options) if form in FORMATS else _by_others(form, plain, options)
    contents = found if isinstance(found, Contents) else Contents(found)
    if form.up == "z":
        contents.particles.up = Z_UP
    if radius_is == "diameter":
        contents = replace(contents, particles=with_halved_radii(contents.particles))
    if scale != 1:
        box = contents.box and contents.box.scaled(scale)
        found = contents.particles
        units = scaled_units(contents.units, {"positions", "support", *lengths_of(found)}, scale)
        contents = replace(contents, particles=scaled(found, scale), box=box, units=units)
    contents = replace(contents, particles=given_from(contents.particles, origin, path))
    if condition is not None:
        contents = replace(contents, particles=where(contents.particles, condition))
    say_radii(said(path), contents.particles)
    contents = _centered(contents) if center else contents
    if least != 1:
        kept, left = without_small_components(contents.particles, least)
        contents = replace(contents, particles=kept)
        if left:
            warnings.warn(f"{os.fspath(path)}: {left}", stacklevel=3)
    return contents


def _centered(contents: Contents) -> Contents:
    """With the particles in the middle of their periodic box."""
    particles, box = contents.particles, contents.box
    if box is None or not any(box.periodic):
        got = "one without" if box else "no box"
        raise ValueError(f"center: expected a file with a box and periodic faces, got {got}")
    moved = box.center(particles.world_positions()) - particles.origin
    return replace(contents, particles=replace(particles, positions=moved.astype(np.float32)))


def up_of(path: str | os.PathLike[str]) -> tuple[tuple[float, float, float], str]:
    """What a file of particles has upwards, (x, y, z) of unit length, and why: a few words.

    Raises FormatError and OSErrors as `read` does.
    """
    kind = kind_of(path, "particles")
    form = format_named(kind.format) if kind.kind in ("particles", "mesh") else None
    if form is not None and form.name in ("usd", "npz"):
        up = function_of(form, "read_up")(path)
        return up, "the default" if form.name == "npz" and up == UP else "the file says so"
    if form is None or form.up != "z":
        return UP, "the default"
    return Z_UP, f"as usual in this format ({form.about})"


def _by_others(form: Format, path: Any, options: dict[str, Any]) -> Contents | Particles:
    """What the reader of another package returns; whatever it raises is a FormatError."""
    where = f"reader {form.name!r} ({form.module})"
    try:
        found = function_of(form)(path, **options)
    except (FormatError, OSError, MemoryError):
        raise
    except Exception as error:
        raise bad(path, where, f"{type(error).__name__}: {error}") from error
    if not isinstance(found, (Contents, Particles)):
        raise bad(path, where, f"expected Particles or Contents, got {type(found).__name__}")
    return found


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write particles to a file, which appears whole or not at all.

    The writer repeats a number that applies to all particles for each particle, except in .npz.
    Raises FormatError if the extension is unknown, ValueError if the format cannot hold an
    attribute.
    """
    form = _writer(path)
    if not isinstance(particles, Particles):
        raise TypeError(f"particles: expected Particles, got {type(particles).__name__}")
    check_names(particles.attributes)
    function_of(form, "write")(path, particles)


def _writer(path: str | os.PathLike[str]) -> Format:
    name = os.path.basename(os.fspath(path)).lower()
    for form in formats():
        if form.writes and name.endswith(form.endings):
            return form
    raise FormatError(f"{path}: expected one of the extensions {' '.join(WRITABLE)}")
