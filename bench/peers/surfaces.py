#!/usr/bin/env python3
"""Surfaces of the same particles, seen by the same camera: globule, splashsurf, OVITO, PyVista,
Newton.

    pip install pysplashsurf pyvista ovito newton
    python bench/peers/surfaces.py [--data FOLDER] [--peers globule,splashsurf] [-o picture.png]

Every peer runs in a process of its own. The table has CPU seconds from particles in memory to the
image (without imports), the process's peak memory, the enclosed volume over the particles' volume,
and, on a flat pool, how far the surface lies from the truth, in spacings. A peer that is missing is
skipped with the command that installs it. The picture has all of them side by side.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from surface_peers import PACKAGES, PEERS

SIZE = (1024, 782)
WIDTH = 500  # of an image in the picture
DATA = Path(__file__).parents[3] / "shared" / "data" / "particles"
# File, spacing = cube root of a particle's volume (docs/design/surface.md says how each is known).
FILES = {
    "splash": ("splash_117649.npz", 0.02),
    "dam break": ("dam_break_frame_23_24389_particles.bgeo", 0.05 * 0.8 ** (1 / 3)),
    "torn sheets": ("double_dam_break_frame_26_4732_particles.vtk", 0.05 * 0.8 ** (1 / 3)),
}
POOL = (40, 10, 40)  # a lattice with spacing 1; y is up


def particles_of(case: str, data: Path) -> tuple[np.ndarray, float]:
    import globule as gb

    if case == "pool":
        axes = np.meshgrid(*map(np.arange, POOL), indexing="ij")
        return np.stack(axes, -1).reshape(-1, 3).astype(np.float32), 1.0
    name, spacing = FILES[case]
    return np.asarray(gb.read(data / name).positions, np.float32), spacing


def prepare(case: str, data: Path, folder: Path) -> Path:
    import globule as gb

    positions, spacing = particles_of(case, data)
    camera = gb.Camera.fit(positions, size=SIZE)
    path = folder / f"{case.replace(' ', '-')}.npz"
    view = {"eye": camera.eye, "look_at": camera.look_at, "up": camera.up, "fov": camera.fov}
    np.savez(path, positions=positions, spacing=spacing, size=SIZE, pool=case == "pool", **view)
    return path


def measured(peer: str, case: Path, picture: Path, limit: float) -> dict | None:
    command = [sys.executable, __file__, "--one", peer, str(case), str(picture)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        print(f"{peer}: stopped after {limit:g} s")
        return None
    if done.returncode:
        lines = (done.stderr.strip() or "no message").splitlines()
        print(f"{peer}: {lines[-1]}")
        return None
    return json.loads(done.stdout.strip().splitlines()[-1])


def missing(peer: str) -> list[str]:
    return [name for name in PACKAGES[peer] if importlib.util.find_spec(name) is None]


def row(peer: str, case: str, n: int, found: dict) -> str:
    volume = "" if found["volume"] is None else f"{found['volume']:.3f}"
    gauge = "" if found.get("gauge") is None else "{:+.3f} ({:.3f})".format(*found["gauge"])
    seconds = f"{found['surface']:.2f} | {found['image']:.2f}"
    return f"| {case}, {n} | {peer} | {seconds} | {found['memory']:.0f} | {volume} | {gauge} |"


def side_by_side(pictures: dict[tuple[str, str], Path], out: Path) -> None:
    """A row a case, a column a peer, with names; white margins are cut off."""
    from PIL import Image, ImageChops, ImageDraw, ImageFont

    cases = list(dict.fromkeys(case for case, _ in pictures))
    peers = list(dict.fromkeys(peer for _, peer in pictures))
    head, rows = 44, []
    for case in cases:
        images = {p: Image.open(pictures[case, p]).convert("RGB") for p in peers if (case, p) in pictures}
        white = Image.new("RGB", SIZE, "white")
        boxes = [ImageChops.difference(i, white).getbbox() or (0, 0, *SIZE) for i in images.values()]
        low, high = np.min(boxes, axis=0)[:2] - 8, np.max(boxes, axis=0)[2:] + 8
        height = round(WIDTH * (high[1] - low[1]) / (high[0] - low[0]))
        cut = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        rows.append((height, {p: i.crop(cut).resize((WIDTH, height), 1) for p, i in images.items()}))
    sheet = Image.new("RGB", (WIDTH * len(peers), sum(h for h, _ in rows) + head), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(26)
    for i, peer in enumerate(peers):
        draw.text((WIDTH * i + 12, 6), peer, "black", font=font)
    y = head
    for height, images in rows:
        for peer, image in images.items():
            sheet.paste(image, (WIDTH * peers.index(peer), y))
        y += height
    sheet.save(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the particle files")
    parser.add_argument("--cases", default=",".join([*FILES, "pool"]))
    parser.add_argument("--peers", default=",".join(PEERS))
    parser.add_argument("--limit", type=float, default=600.0, help="seconds for each process")
    parser.add_argument("-o", "--output", type=Path, default=Path("surfaces.png"))
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        peer, case, picture = options.one
        print(json.dumps(PEERS[peer](np.load(case), picture)))
        return
    print("| particles | program | surface, CPU s | image, CPU s | peak MiB | volume | gauge |")
    print("|---|---|---|---|---|---|---|")
    pictures = {}
    peers = []
    for peer in options.peers.split(","):
        if absent := missing(peer):
            print(f"{peer}: skipped; pip install {' '.join(absent)}", file=sys.stderr)
        else:
            peers.append(peer)
    with tempfile.TemporaryDirectory() as folder:
        for case in options.cases.split(","):
            if case in FILES and not (options.data / FILES[case][0]).exists():
                print(f"{case}: skipped; {options.data / FILES[case][0]} is not there", file=sys.stderr)
                continue
            path = prepare(case, options.data, Path(folder))
            n = len(np.load(path)["positions"])
            for peer in peers:
                picture = Path(folder) / f"{path.stem}-{peer}.png"
                if found := measured(peer, path, picture, options.limit):
                    print(row(peer, case, n, found), flush=True)
                    if case != "pool":
                        pictures[case, peer] = picture
        if pictures:
            side_by_side(pictures, options.output)


if __name__ == "__main__":
    main()
