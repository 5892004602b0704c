"""Print the contents of a file of particles, a tracked sweep or a volume.

`globule info` prints the number of particles, frames or voxels, their bounds and spacing, and the
range of every field, and for particles the camera that shows all of them, in flags of
`globule render`. A mesh is described as particles, and so is a volume with --level or --label."""

from __future__ import annotations

import argparse
import os
from typing import Any

import numpy as np

from .._base.arrays import box_corners
from .._base.terminal import place_text, plain_number
from ..data.particles import SCALAR_FIELDS, Particles
from ..data.spacing import n_coincident
from ..fluids.likeness import RADII, suitable_surface
from ..formats import READABLE
from ..formats.contents import Contents
from ..formats.kind import kind_of
from ..formats.packed import plain_name
from ..formats.registry import formats
from ..formats.triangles import has_faces
from ..pieces.scene import Scene
from ..pieces.shown import shown_scene
from ..render.camera import Camera
from ..render.fit import fitted
from . import camera_facts, flags, medical
from . import medical as medical_files
from .parser import Parser
from .shared import check_input, count, mistakes, print_json, read_file, reading

SUMMARY = "the contents of a file"
USAGE = "FILE"
EXAMPLES = """\
  globule info splash.npz
  globule info sweep.igs.mha --json
  globule info head.nii.gz --level 90"""

SIZE = (1024, 782)  # of an image of `globule render`
_ENDINGS = {  # by endings that say more than the content's format
    ".bgeo.gz": "Houdini classic geometry, gzipped",
    ".nii": "NIfTI volume",
    ".nii.gz": "NIfTI volume, gzipped",
    ".nrrd": "NRRD volume",
    ".nhdr": "NRRD volume, header alone",
    ".mha": "MetaImage volume",
    ".mhd": "MetaImage volume, header alone",
}


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule info`."""
    parser.add_argument(
        "file",
        metavar="FILE",
        help=f"particles: {' '.join(READABLE)}; sweeps and volumes: {' '.join(medical_files.EXTENSIONS)}",
    )
    flags.add(parser, "--json")
    flags.add_reading(parser)


def run(options: argparse.Namespace) -> None:
    """Run `globule info`."""
    given = reading(options)
    kind = medical.kind_of(options.file)
    if kind and not given:
        facts = medical.describe(options.file, kind)
        if options.json:
            print_json(facts)
        else:
            print("\n".join(medical.lines(facts)))
        return
    check_input(options.file, list(given))
    facts = describe(options.file, read_file(options.file, **given))
    if options.json:
        print_json(facts)
    else:
        print("\n".join(_lines(facts)))


def describe(path: str, contents: Contents) -> dict[str, Any]:
    """All facts about the particles of a file, for JSON."""
    particles, box = contents.particles, contents.box
    finite = np.isfinite(particles.positions).all(axis=1)
    facts: dict[str, Any] = {
        "file": path,
        "format": _format_name(path),
        "bytes": _size(path),
        "particles": len(particles),
        "not_finite": int((~finite).sum()),
        "coincident": n_coincident(particles.positions[finite]),
        "frames": contents.n_frames,
        "time": contents.time,
        "species": list(contents.species),
        "units": dict(contents.units),
        "box": box and {"origin": box.origin.tolist(), "edges": box.edges.tolist(), "periodic": list(box.periodic)},
        "origin": list(particles.origin),
        "bounds": None,
        "spacing": None,
        "default_support": None,
        "surface": "balls",
        "why_surface": "no particles",
        "camera": None,
    }
    if kind_of(path).kind == "volume":
        volume = medical.describe(path, "volume")
        facts["volume"] = {name: volume[name] for name in ("size", "spacing", "dtype", "space")}
    if finite.any():
        with mistakes(path):
            drawn = particles.positions if finite.all() else particles.positions[finite]
            scene = Scene(Particles(drawn, up=particles.up), device="cpu")
            lo, hi = particles.bounds()
        facts["bounds"] = {"lo": lo, "hi": hi}
        facts["surface"], facts["why_surface"] = _surface(path, particles, scene)
        if facts["why_surface"] == RADII:
            scene = shown_scene(particles, device="cpu")
        elif facts["surface"] in ("smooth", "spheres"):
            scene.become(facts["surface"])
        facts["spacing"] = scene.spacing or None
        facts["default_support"] = scene.support
        with mistakes(path):
            camera = _camera(path, particles[finite], scene, facts["surface"])
        facts["camera"] = camera and camera_facts.facts(camera)
    facts["fields"] = {"positions": _range(particles.positions)}
    for name in (*SCALAR_FIELDS, "color"):
        value = getattr(particles, name)
        if value is not None:
            facts["fields"][name] = _range(np.asarray(value, np.float32))
    facts["attributes"] = {name: _range(array) for name, array in particles.attributes.items()}
    return facts


def _surface(path: str, particles: Particles, scene: Scene) -> tuple[str, str]:
    """What `globule render` draws, and why."""
    if kind_of(path).kind == "volume":
        return "balls", "voxels"
    if has_faces(path):
        return "triangles", "faces of the file"
    return suitable_surface(particles, scene)


def _camera(path: str, particles: Particles, scene: Scene, surface: str) -> Camera | None:
    """The camera that `globule render` fits at its default size; None for a volume, whose image
    shows a surface. scene: of the positions alone, with this surface."""
    if kind_of(path).kind == "volume":
        return None
    if has_faces(path):
        return Camera.fit(box_corners(*particles.bounds()))
    own = particles.support is not None or particles.anisotropy is not None
    if own and surface == "balls":
        scene = shown_scene(particles, device="cpu")
    return fitted(scene, SIZE, None)


def _format_name(path: str) -> str:
    """What the content is."""
    found, name = kind_of(path), os.path.basename(path).lower()
    form = next((form for form in formats() if form.name == found.format), None)
    ending = max((ending for ending in _ENDINGS if name.endswith(ending)), key=len, default="")
    if ending and (form is None or form.name == "bgeo"):
        return _ENDINGS[ending]
    about = form.about if form else f"{found.kind} ({found.format})"
    return about + (", packed" if plain_name(name) != name else "")


def _size(path: str) -> int:
    if os.path.isdir(path):
        return sum(entry.stat().st_size for entry in os.scandir(path))
    return os.path.getsize(path)


def _range(array: np.ndarray) -> dict[str, Any]:
    floats = array.dtype.kind == "f"
    known = array[np.isfinite(array)] if floats else array
    as_number = float if floats else int
    return {
        "dtype": str(array.dtype),
        "shape": list(array.shape),
        "min": as_number(known.min()) if known.size else None,
        "max": as_number(known.max()) if known.size else None,
        "nan": int(np.isnan(array).sum()) if floats else 0,
        "inf": int(np.isinf(array).sum()) if floats else 0,
    }


def _contents_lines(facts: dict[str, Any]) -> list[str]:
    """What a file of a simulation program says beside the particles."""
    lines = []
    if facts["frames"] > 1:
        lines.append(f"  frames     {facts['frames']:,}: --frame 0 to {facts['frames'] - 1}")
    if facts["time"] is not None:
        lines.append(f"  time       {facts['time']:.6g}")
    if len(facts["species"]) > 1:
        lines.append(f"  species    {', '.join(facts['species'])}: --species NAME")
    if facts["box"]:
        box = facts["box"]
        edges = "  ".join(" ".join(f"{v:.6g}" for v in edge) for edge in box["edges"])
        origin = " ".join(f"{v:.6g}" for v in box["origin"])
        periodic = "".join(axis for axis, is_so in zip("xyz", box["periodic"], strict=True) if is_so)
        lines.append(f"  box        from {origin}, edges {edges}")
        lines[-1] += f", periodic along {periodic}" if periodic else ""
    return lines


def _lines(facts: dict[str, Any]) -> list[str]:
    lines = [
        f"{facts['file']}: {facts['format']}, {count(facts['bytes'], 'byte')}",
        f"  particles  {facts['particles']:,}",
    ]
    if "volume" in facts:
        volume = facts["volume"]
        size = "x".join(map(str, volume["size"]))
        edges = " ".join(f"{edge:.6g}" for edge in volume["spacing"])
        lines.insert(1, f"  volume     {size} voxels of {edges} mm, {volume['dtype']}")
    if facts["not_finite"]:
        lines[-1] += f", {facts['not_finite']:,} without a finite position"
    if facts["coincident"]:
        lines[-1] += f", {facts['coincident']:,} of them exactly where others are"
    lines += _contents_lines(facts)
    if facts["bounds"]:
        lo, hi = (" ".join(f"{v:.6g}" for v in facts["bounds"][end]) for end in ("lo", "hi"))
        from_there = ""
        if any(facts["origin"]):
            from_there = f"  from {place_text(facts['origin'])}"
        lines.append(f"  bounds     {lo}  to  {hi}{from_there}")
        spacing = facts["spacing"]
        text = f"{spacing:.4g}" if spacing else "unknown (all at one position)"
        lines.append(f"  spacing    {text}")
        lines.append(f"  surface    {facts['surface']} ({facts['why_surface']})")
    if facts["camera"]:
        lines.append(f"  camera     {facts['camera']['flags']}")
    for kind in ("fields", "attributes"):
        for name, about in facts[kind].items():
            shape = "x".join(map(str, about["shape"])) or "one for all"
            unit = facts["units"].get(name, "")
            text = f"  {kind[:-1]:<9}  {name}: {about['dtype']} {shape}"
            if about["min"] is not None:
                text += f", {plain_number(about['min'])} to {plain_number(about['max'])}"
            text += f" [{unit}]" if unit else ""
            for bad in ("nan", "inf"):
                if about[bad]:
                    text += f", {about[bad]:,} {bad}"
            lines.append(text)
    return lines
