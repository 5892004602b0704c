"""Render particles, meshes or volumes to images of their smooth surface.

The surface is where the summed field of the particles equals the threshold. By default the image
shows all particles, and support and threshold follow from the particles' spacing.

Flags win over the settings of --state and of --preset. --preset thesis traces as the source thesis
does, with supports of half a leaf if the file has no supports. --color-by shows the length of a
vector; NAME:0 shows its first component.

Each input file gives one image. For several files, -o is a folder, a movie.mp4, or a name with {}
or %04d. The input's name replaces {}, the number of the file, from 0, replaces %04d.
Finished images stay when a later file turns out to be broken.

Several files, or a quoted pattern ('frame_*.vtk', frame_%04d.vtk; in numeric order), are one
sequence: support, camera and colors are the same in all images. Without --eye the camera shows the
particles of all files, and --color-by covers the values of all files. For both, `globule render`
reads every file once more beforehand; --eye and --range avoid this. A movie needs PyAV:
pip install "globule[video]" (its wheel contains FFmpeg with x264, under the GPL).

`mpiexec -n 4 globule render huge.h5 -o huge.png` makes one image on four ranks; several files are
dealt to the ranks one by one. It needs pip install "globule[mpi]".

--camera-path reads key frames in TOML:
  [[key]]
  time = 0                # seconds; or frame = 0
  eye = [3, 1, 0]
  look_at = [0, 0, 0]
  [[key]]                 # look_at, up and fov stay unless given again
  time = 2.5
  eye = [0, 1, 3]"""

from __future__ import annotations

import argparse
import functools
import os
import re
import time
from typing import Any

import numpy as np

from ..fluids.likeness import shows_flat
from ..pieces.scene import Scene
from ..render.camera import Camera, first_direction, view_axes
from ..render.camera_path import round_camera
from ..render.fit import fitted
from ..render.settings import RenderSettings
from ..render.views import view_cameras
from ..scene.mesh import Mesh
from . import annotation, flags, light, look, meshes, pieces, ranks, sequence, state, surfaces, tracing
from .arguments import pixel
from .image import picture
from .parser import Parser
from .shared import (
    Progress,
    UserError,
    check_device,
    check_input,
    check_output,
    count,
    frame_number,
    mistakes,
    print_json,
    reading,
    say,
    stem,
)
from .volumes import check_surface, is_surface

SUMMARY = "particles, meshes and volumes to images and movies"
USAGE = "FILE [FILE ...] -o PATH"
EXAMPLES = """\
  globule render splash.npz -o splash.png
  globule render splash.npz -o water.png --preset water --size 512x391
  globule render splash.npz -o above.png --eye 0,4,0.1 --look-at 0,0,0 --color-by y --json
  globule render splash.npz -o small.png --size 512x391 --pick 256,195
  globule render splash.npz -o again.png --state view.toml
  globule render head.nii.gz -o head.png --level 90 --resample 2 --up 0,0,1
  globule render head.nii.gz -o cut.png --level 90 --preset tissue --up 0,0,1 --clip 1,0,0,5
  globule render frame_0.ply frame_1.ply -o picture_%04d.png
  globule render splash.npz -o splash.png --memory 8G"""
ESSENTIAL = ("--output", "--size", "--eye", "--look-at", "--up", "--preset", "--color-by",
             "--surface", "--legend", "--samples", "--level", "--clip", "--state",
             "--device")  # fmt: skip

FOV = 40.0  # degrees
DEFAULT_VIEW = Camera((1.2, 0.9, 2.0), (0, 0, 0))  # where there is nothing to fit


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule render`."""
    add = parser.add_argument
    add("particles", nargs="+", metavar="FILE", help="particles, mesh or volume, or a folder with a DICOM series")
    flags.add(parser, "--output", "image.png or movie.mp4", required=True)
    flags.add(parser, "--size", "default: 1024x782", default=(1024, 782))
    flags.add(parser, "--state", "default: none")
    flags.own(parser, "--aov FILE.npz", "also write the arrays color, distance, position, normal, "
        "albedo and mask")  # fmt: skip
    flags.own(parser, "--pick COLUMN,ROW", "print position, particle and attributes behind a pixel, "
        "counted from the top left corner", pixel)  # fmt: skip
    flags.add(parser, "--json")
    add_look(parser)
    annotation.add_arguments(parser)
    flags.add_reading(parser)
    sequence.add_arguments(parser)
    machine = parser.add_argument_group("machine")
    flags.add_device(machine)
    flags.own(machine, "--ranks NAME", "what each rank of mpiexec has of one image: replicate (all "
        "particles, and some of the pixels) or pieces (a part of the particles; rays of light go "
        "from rank to rank)", ranks.MODES,
        usual="pieces, or replicate where light turns and all particles fit")  # fmt: skip
    flags.own(machine, "--memory SIZE", "number of bytes that the command may take, such as 8G: "
        "particles that need more are read, built and traced in pieces (HDF5, raw .vtu; .npy, .npz "
        "and .bgeo without compression)", pieces.memory, usual="what is free")  # fmt: skip
    parser.set_defaults(prepare=functools.partial(state.defaults, parser))


def add_look(parser: Parser) -> None:
    """The flags of camera, surface, colors, light, cuts and meshes, which `figure` has too."""
    camera = parser.add_argument_group("camera")
    flags.own(camera, "--fit", "show all particles (the default)")
    flags.add(camera, "--eye", "default: all is visible; 2-D along the normal")
    flags.add(camera, "--look-at", "default: the middle of the particles")
    flags.add(camera, "--up", "default: by format")
    flags.add(camera, "--fov", "default: 40")
    flags.add(camera, "--ortho", "default: none, a perspective camera")
    annotation.add_views(camera)
    surfaces.add_arguments(parser)
    tree = parser.add_argument_group("octree")
    flags.own(tree, "--octree NAME", "kind of octree: sparse or dense", ("sparse", "dense"),
        usual="sparse; dense with --root march or bezier")  # fmt: skip
    flags.own(tree, "--octree-level N", "deepest level of the octree, number of halvings", int,
        usual="from the particles", dest="depth")  # fmt: skip
    flags.own(tree, "--key-bits N", "length of a Morton key, bits: 32 or 64", int, 32,
        choices=(32, 64))  # fmt: skip
    tracing.add_arguments(parser)
    colors = parser.add_argument_group("color and light; radiances are linear, 1 is white")
    flags.add(colors, "--color-by", "default: the particles' color")
    flags.add(colors, "--colormap", "default: auto", default="auto")
    flags.add(colors, "--range", "default: the lowest and the highest value")
    colors.add_argument(
        "--flat",
        dest="preset",
        action=look.OneLook,
        nargs=0,
        const="flat",
        help="no light: a pixel has exactly the color of its value; the same as --preset flat",
    )
    flags.own(colors, "--light LIGHT", "light source: head (at the eye), dir:X,Y,Z[,ANGLE] "
        "(towards the light, with an angular diameter in degrees) or point:X,Y,Z[,RADIUS] (world "
        "units); ANGLE and RADIUS make soft shadows; may be repeated up to 8 times, and all share "
        "a radiance of 1", look.light, usual="head and a sun", action="append")  # fmt: skip
    flags.add_settings(colors, RenderSettings, "ambient", "background", note=", or the preset's")
    flags.own(colors, "--transparent", "no background: the images are RGBA, with smooth edges from "
        "2 --samples on")  # fmt: skip
    light.add_arguments(parser)
    meshes.add_arguments(parser)


def run(options: argparse.Namespace) -> None:
    """Run `globule render`."""
    comm = ranks.communicator()
    with ranks.together(comm):
        _run(options, comm)


def _run(options: argparse.Namespace, comm: Any) -> None:
    start = time.perf_counter()
    check_camera(options)
    notes = annotation.Notes(options)
    series = sequence.Series(options, comm)
    with mistakes():
        # Mistakes in everything but the particles show before any work.
        lit = light.Light(options)
        thesis = tracing.settle(options)
        camera(options, None, notes)
    images, arrays = outputs(options, series.images())
    if comm is not None:
        if options.memory is not None:
            raise UserError(
                f"--memory: expected none on several ranks, got {options.memory / 1e6:,g} MB; "
                "start more ranks for less memory on each"
            )
        ranks.settle(options, comm)
    check_device(options)
    together = comm if len(images) == 1 else None  # on one image, not on images of their own
    split = together is not None and not ranks.replicates(options, lit)
    if split or (comm is None and pieces.wanted(options)):
        towards = _towards(options, None)
        pieces.run(options, lit, notes, images[0], arrays[0], comm, towards)
        return
    reports = []
    with series, Progress(4 * len(images)) as progress:
        series.survey(progress)
        for i, path, image, aov in series.pictures(images, arrays):
            look_at = functools.partial(cameras, options, lit, notes)
            job = options, lit, notes, thesis, progress, series
            report = picture(*job, i, path, image, aov, look_at, together)
            reports += [report] if report else []
        if comm is not None and not together:
            reports = sequence.of_all_ranks(comm, reports)
        if comm is not None and comm.rank:
            return
        series.finish(progress)
    if series.movie or not reports:
        series.report(images, reports, time.perf_counter() - start)
        return
    if options.json:
        print_json(reports[0] if len(images) == 1 else _together(reports))
        return
    for report in reports:
        times, counts = report["times"], report["counts"]
        print(
            f"{report['images'][0]}: {_content(counts)}, "
            f"built in {1e3 * times['build']:.1f} ms, traced in {1e3 * times['trace']:.1f} ms, "
            f"{times['total']:.2f} s in all on {report['device']}"
        )
        if options.pick:
            print(light.say_picked(options, report["picked"]))


def check_camera(options: argparse.Namespace) -> None:
    """Refuse flags of the camera that contradict each other."""
    if options.fit and (options.eye or options.look_at):
        raise UserError("--fit: expected no --eye and no --look-at beside --fit")
    if options.look_at and not options.eye:
        raise UserError("--look-at: expected --eye beside --look-at, got none")


def check_inputs(options: argparse.Namespace) -> None:
    """Refuse input files that cannot be read as the options say, before any work."""
    for path in options.particles:
        if is_surface(path, options):
            check_surface(path, options)
        elif meshes.is_mesh(path, options):
            check_input(path, list(reading(options)))
            meshes.check_mesh(path, options)
        else:
            check_input(path, list(reading(options)))


def outputs(options: argparse.Namespace, images: list[str] | None) -> tuple[list[str], list[str | None]]:
    """The files to write, one image and perhaps one .npz per input, all checked to be writable.
    images: those of a movie."""
    check_inputs(options)
    images = images or _names("-o", options.output, options.particles, ".png", options.frame)
    arrays: list[str | None] = [None] * len(images)
    if options.aov:
        arrays = list(_names("--aov", options.aov, options.particles, ".npz", options.frame))
    inputs = {os.path.realpath(path) for path in options.particles}
    for path in arrays:
        if path and os.path.realpath(path) in inputs:
            raise UserError(f"--aov: expected another file than the particles, got {path}")
    return images, arrays


def _names(option: str, pattern: str, inputs: list[str], extension: str, frame: int | None) -> list[str]:
    folder = os.path.isdir(pattern) or pattern.endswith("/")
    name = "{}" if len({str(path) for path in inputs}) == len(inputs) else "{}_%04d"
    full = os.path.join(pattern, name + extension) if folder else pattern
    if option == "-o" and not full.lower().endswith(extension):
        expected = f"a name ending in {extension} (images) or .mp4 (a movie), or a folder that exists"
        raise UserError(f"-o: expected {expected}, got {pattern}")
    number = re.search(r"%(0?\d?)d", os.path.basename(full))
    if len(inputs) > 1 and not number and "{}" not in os.path.basename(full):
        message = f"a folder or a name with {{}} or %d for {len(inputs)} files"
        raise UserError(f"{option}: expected {message}, got {pattern}")
    names = []
    for i, path in enumerate(inputs):
        head, name = os.path.split(full)
        if number:
            name = name.replace(number[0], number[0] % (i if len(inputs) > 1 else frame_number(path, frame)))
        name = name.replace("{}", stem(path))
        names.append(os.path.join(head, name))
        check_output(option, names[-1], [extension])
        if names[-1] in names[:-1]:
            raise UserError(f"{option}: expected one file per picture, got {names[-1]} twice")
    return names


def camera(
    options: argparse.Namespace, scene: Scene | Mesh | None, notes: annotation.Pictures, around: Any = None
) -> Camera:
    """The camera that the options ask for; without a scene, only the options are checked.

    around: (M, 3) points to show, world units; default: the scene's particles.
    """
    nothing = scene is None or (around is None and isinstance(scene, Scene) and scene.octree.n_inside == 0)
    fov = options.fov or FOV
    if not options.eye:
        base = DEFAULT_VIEW
        if scene is not None and not nothing:
            around = _all_around(options, scene, around) if options.turntable else around
            base = fitted(scene, notes.size, notes.annotation, around, **_towards(options, scene))
            if shows_flat(scene) and not options.turntable:
                return base
            if options.turntable:
                base = round_camera(base, np.mean(around, axis=0))
        return Camera(base.eye, base.look_at, options.up, fov, options.ortho)
    middle = options.look_at
    if not middle:
        middle = np.zeros(3)
        if scene is not None and not nothing:
            box = scene.particles if isinstance(scene, Scene) else scene
            middle = np.mean(box.bounds() if around is None else around, axis=0)
        if scene is None or np.array_equal(middle, options.eye):
            middle = np.add(options.eye, (0, 0, -1))
    return Camera(options.eye, middle, options.up, fov, options.ortho)


def cameras(
    options: argparse.Namespace, lit: light.Light, notes: annotation.Pictures, scene: Scene | Mesh, around: Any
) -> list[Camera]:
    """The cameras of all views of an image."""
    around = lit.around(scene, around)
    if options.said_up and (options.turntable or not shows_flat(scene)):
        say(options.said_up)
        options.said_up = ""
    if not options.views:
        return [camera(options, scene, notes, around)]
    fov = options.fov or FOV
    return view_cameras(scene, options.views, notes.size, options.up, fov, around, notes.annotation)


def _all_around(options: argparse.Namespace, scene: Scene | Mesh, around: Any) -> np.ndarray:
    """The corners of the points' box, or the particles', turned about --up through its middle."""
    box = scene.particles if isinstance(scene, Scene) else scene
    ends = box.bounds() if around is None else (around.min(axis=0), around.max(axis=0))
    corners = np.array([np.where(c, ends[1], ends[0]) for c in np.ndindex(2, 2, 2)])
    middle = corners.mean(axis=0)
    right, above, front = view_axes(options.up)
    x, y, z = ((corners - middle) @ axis for axis in (right, above, front))
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)[:, None]
    reach = np.hypot(x, z).max()
    ring = [np.cos(angles) * right + np.sin(angles) * front]
    return np.concatenate([middle + reach * ring[0] + h * above for h in (y.min(), y.max())])


def _towards(options: argparse.Namespace, scene: Scene | Mesh | None) -> dict[str, Any]:
    """How the fitted camera looks."""
    if shows_flat(scene) and not options.turntable:
        return {"fov": options.fov or FOV}
    return {
        "direction": first_direction(options.up), "up": options.up, "fov": options.fov or FOV,
        "orthographic": options.ortho is not None,
    }  # fmt: skip


def _content(counts: dict[str, int]) -> str:
    """ "1,000 particles" or "1,280 triangles"."""
    noun = "triangle" if "triangles" in counts else "particle"
    return count(counts[f"{noun}s"], noun)


def _together(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """The reports of several images as one: common facts, sums, and each report."""
    times = {key: sum(report["times"][key] for report in reports) for key in reports[0]["times"]}
    known = dict.fromkeys(key for report in reports for key in report["counts"])
    counts = {key: sum(report["counts"].get(key, 0) for report in reports) for key in known}
    return {
        "images": [report["images"][0] for report in reports],
        "device": reports[0]["device"],
        "size": reports[0]["size"],
        "kernel": reports[0].get("kernel"),
        "threshold": reports[0].get("threshold"),
        "times": times,
        "memory": {"octree": max(r.get("memory", {"octree": 0})["octree"] for r in reports)},
        "counts": counts,
        "frames": reports,
    }
