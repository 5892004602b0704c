#!/usr/bin/env python3
"""POV-Ray's blob as an independent judge: the same particles, camera and threshold, its picture and
its time.

    python bench/peers/povray.py particles.npz --support 0.04 --threshold 0.6 -o out/
    python bench/peers/povray.py particles.npz --depth-npy ours.npy --compare

POV-Ray 3.7's `blob` sums strength * (1 - (r/R)^2)^2 over its spheres and finds the exact first root
of that sum minus a threshold: our murakami kernel, weight for strength, support for R. What this
file takes care of:

- Camera. The scene states `right`, `up` and `direction` outright, as unit vectors of our
  right-handed world times the picture's extent, so POV-Ray's left-handed habits never enter and the
  picture is not mirrored.
- Pixels. The ray of column i, row j crosses the picture at ((i + 1/2)/W, (j + 1/2)/H) from the top
  left corner: POV-Ray's own rule without antialiasing, checked with a sphere's silhouette in
  `--self-test`.
- Depth. A pigment function gives each hit the distance from the eye, mapped to (0, 1) between
  `near` and `far`. Red holds it in 16 bits, green holds the fraction of 256 times it, so depth
  comes back in about 24 bits; blue is 1 where something was hit. The file is a linear 16-bit PPM,
  which needs no decoder.

Needs NumPy; Pillow only to save PNG. Lengths are the particles' own.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

MODES = ("depth", "normal", "shaded")


def find_povray() -> str | None:
    """Path of the `povray` program, or None where it is not installed."""
    return shutil.which("povray")


def fit_camera(positions: np.ndarray, fov: float = 40.0, direction=(0.6, 0.45, 1.0)) -> dict[str, Any]:
    """Camera whose vertical field of view just holds the bounding sphere of the positions' box."""
    lo, hi = positions.min(0).astype(float), positions.max(0).astype(float)
    center, radius = (lo + hi) / 2, float(np.linalg.norm(hi - lo)) / 2
    d = np.asarray(direction, float)
    d /= np.linalg.norm(d)
    eye = center + d * (max(radius, 1e-9) / math.sin(math.radians(fov) / 2))
    return {"eye": eye.tolist(), "look_at": center.tolist(), "up": (0.0, 1.0, 0.0), "fov": fov}


def frame_vectors(camera: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Eye and the unit vectors right, up and forward of a right-handed camera."""
    eye = np.asarray(camera["eye"], float)
    forward = np.asarray(camera["look_at"], float) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(camera.get("up", (0, 1, 0)), float))
    right /= np.linalg.norm(right)
    return eye, right, np.cross(right, forward), forward


def pixel_rays(camera: dict[str, Any], size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Eye (3,) and unit directions (H, W, 3) of the rays through the pixel centers, row 0 on
    top."""
    width, height = size
    eye, right, up, forward = frame_vectors(camera)
    t = math.tan(math.radians(camera.get("fov", 40.0)) / 2)
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * t * width / height
    y = (1 - (np.arange(height) + 0.5) / height * 2) * t
    d = forward + x[None, :, None] * right + y[:, None, None] * up
    return eye, d / np.linalg.norm(d, axis=-1, keepdims=True)


def depth_range(positions: np.ndarray, support: np.ndarray | float, camera: dict[str, Any]) -> tuple[float, float]:
    """`near` and `far` distances from the eye that hold every support, with a margin of 1 %."""
    distance = np.linalg.norm(positions.astype(float) - np.asarray(camera["eye"], float), axis=1)
    near, far = float((distance - support).min()), float((distance + support).max())
    margin = 0.01 * (far - near)
    return max(near - margin, 0.0), far + margin


def write_scene(
    path: str | Path,
    positions: np.ndarray,
    support: np.ndarray | float,
    weight: np.ndarray | float,
    threshold: float,
    camera: dict[str, Any],
    mode: str = "depth",
    size: tuple[int, int] = (1024, 782),
    color: np.ndarray | None = None,
) -> tuple[float, float]:
    """Write a scene of one blob and return the `near` and `far` that its depth picture is mapped
    between.

    positions (N, 3); support and weight scalar or (N,); color (N, 3) in [0, 1], blended by POV-Ray
    as we do, only in mode "shaded"; camera: eye, look_at, up, fov (vertical, degrees); size (W, H)
    fixes the aspect ratio.
    """
    if mode not in MODES:
        raise ValueError(f"mode: expected one of {MODES}, got {mode!r}")
    positions = np.asarray(positions, np.float64).reshape(-1, 3)
    n = len(positions)
    support = np.broadcast_to(np.asarray(support, float), (n,))
    weight = np.broadcast_to(np.asarray(weight, float), (n,))
    near, far = depth_range(positions, support, camera)
    eye, right, up, forward = frame_vectors(camera)
    width, height = size
    t = math.tan(math.radians(camera.get("fov", 40.0)) / 2)
    lines = [
        "#version 3.7;",
        "global_settings { assumed_gamma 1 }",
        f"camera {{ perspective location {_vec(eye)} direction {_vec(forward)}"
        f" right {_vec(right * (2 * t * width / height))} up {_vec(up * (2 * t))} }}",
    ]
    if mode == "depth":
        offset = "+".join(f"({axis}-({_num(e)}))*({axis}-({_num(e)}))" for axis, e in zip("xyz", eye, strict=True))
        lines += [
            "background { rgb 0 }",
            f"#declare D = function(x,y,z) {{ (sqrt({offset})-{_num(near)})/{_num(far - near)} }}",
            "#declare Look = texture { pigment { average pigment_map {",
            " [1 function { D(x,y,z) } color_map { [0 rgb <0,0,2>] [1 rgb <2,0,2>] }]",
            " [1 function { mod(256*D(x,y,z),1) } color_map { [0 rgb 0] [1 rgb <0,2,0>] }] } }",
            " finish { ambient 0 diffuse 0 emission 1 } }",
        ]
    elif mode == "normal":
        axes = ("<1,0,0>", "<0,1,0>", "<0,0,1>")
        ends = ("<3,0,0>", "<0,3,0>", "<0,0,3>")
        lines += [
            "background { rgb 0 }",
            "#declare Look = texture { pigment { average pigment_map {",
            *(
                f" [1 slope {{ {axis} }} color_map {{ [0 rgb 0] [1 rgb {end}] }}]"
                for axis, end in zip(axes, ends, strict=True)
            ),
            " } } finish { ambient 0 diffuse 0 emission 1 } }",
        ]
    else:
        sun = right * -0.45 + up * 0.75 - forward * 0.5
        lines += [
            "background { rgb <0.93,0.95,0.97> }",
            f"light_source {{ {_vec(eye + sun * 1e4)} rgb 0.85",
            f" parallel point_at {_vec(eye)} shadowless }}",
            "#declare Look = texture { pigment { rgb <0.35,0.6,0.85> }",
            " finish { ambient 0.25 diffuse 0.75 specular 0.3 roughness 0.02 } }",
        ]
    with open(path, "w", encoding="ascii") as file:
        file.write("\n".join(lines) + f"\nblob {{ threshold {_num(threshold)}\n")
        plain = "sphere{{<{:.9g},{:.9g},{:.9g}>,{:.9g},{:.9g}}}\n"
        painted = plain[:-3] + " pigment{{rgb<{:.3f},{:.3f},{:.3f}>}}}}\n"
        paint = mode == "shaded" and color is not None
        for k in range(0, n, 65536):  # in blocks: a scene of millions stays out of memory
            s = slice(k, k + 65536)
            rows = np.column_stack([positions[s], support[s], weight[s]]).tolist()
            if paint:
                tints = np.asarray(color[s], float).tolist()
                file.writelines(painted.format(*r, *c) for r, c in zip(rows, tints, strict=True))
            else:
                file.writelines(plain.format(*r) for r in rows)
        file.write("texture { Look } }\n")
    return near, far


def run(scene: str | Path, size: tuple[int, int] = (1024, 782), threads: int = 1) -> tuple[np.ndarray, float, float]:
    """Render `scene`: the picture (H, W, 3) uint16, linear, CPU seconds (user + system) and wall
    seconds.

    CPU seconds are the child process's own, parsing included; `run.log` keeps POV-Ray's last
    messages, from which `render_seconds` reads the tracing alone.
    """
    program = find_povray()
    if program is None:
        raise FileNotFoundError("povray: not installed (Debian: apt-get install povray)")
    width, height = size
    scene = Path(scene).resolve()
    picture = scene.with_suffix(".ppm")
    command = [
        program, f"+I{scene}", f"+O{picture}", f"+W{width}", f"+H{height}", f"+WT{threads}",
        "+FP16", "File_Gamma=1", "Dither=off", "-A", "-D", "-P", "-V",
    ]  # fmt: skip
    with tempfile.TemporaryFile() as log:
        start = time.perf_counter()
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=scene.parent)
        _, status, usage = os.wait4(child.pid, 0)
        wall = time.perf_counter() - start
        child.returncode = os.waitstatus_to_exitcode(status)
        log.seek(0)
        run.log = log.read().decode(errors="replace")  # type: ignore[attr-defined]
    if child.returncode != 0:
        raise RuntimeError(f"povray: exit status {child.returncode} for {scene}\n{run.log[-2000:]}")  # type: ignore[attr-defined]
    return read_ppm16(picture), usage.ru_utime + usage.ru_stime, wall


def render_seconds() -> float | None:
    """CPU seconds of tracing alone in the last `run`, without parsing, as POV-Ray reports them."""
    found = re.search(r"Trace Time:.*?\n.*?using \d+ thread\(s\) with ([\d.]+) CPU-seconds", getattr(run, "log", ""))
    return float(found.group(1)) if found else None


def read_ppm16(path: str | Path) -> np.ndarray:
    """A binary PPM with 16 bits a channel as (H, W, 3) uint16."""
    data = Path(path).read_bytes()
    head = re.match(rb"P6\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)\s+(\d+)\s", data)
    if head is None or head.group(3) != b"65535":
        raise ValueError(f"{path}: expected a binary PPM with maximum 65535, got {data[:20]!r}")
    width, height = int(head.group(1)), int(head.group(2))
    return (
        np.frombuffer(data, ">u2", offset=head.end(), count=width * height * 3).reshape(height, width, 3).astype("u2")
    )


def hit_mask_and_depth(image: np.ndarray, near: float, far: float) -> tuple[np.ndarray, np.ndarray]:
    """Mask (H, W) bool and distance along the ray (H, W) float64, inf where missed, of a depth
    picture."""
    mask = image[..., 2] > 32767
    coarse = image[..., 0] / 65535 * 256  # known to 1/512, so it settles which of 256 steps green divides
    fine = image[..., 1] / 65535
    value = (np.round(coarse - fine) + fine) / 256
    return mask, np.where(mask, near + value * (far - near), np.inf)


def normals(image: np.ndarray) -> np.ndarray:
    """Unit normals (H, W, 3) float64 of a picture of mode "normal", 0 where missed.

    POV-Ray's pattern `slope` is 1 - angle / 180 degrees, of the angle between normal and axis.
    """
    n = np.where(image.any(axis=-1, keepdims=True), -np.cos(np.pi * (image / 65535.0)), 0)
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    return np.divide(n, length, out=np.zeros_like(n), where=length > 0)


def compare(mask: np.ndarray, depth: np.ndarray, ours: np.ndarray) -> dict[str, Any]:
    """How our depth (H, W), inf where missed, differs from POV-Ray's."""
    both = mask & np.isfinite(ours)
    error = np.abs(ours[both] - depth[both])
    return {
        "pixels": int(mask.size),
        "hit_povray": int(mask.sum()),
        "hit_ours": int(np.isfinite(ours).sum()),
        "mask_differs": int((mask != np.isfinite(ours)).sum()),
        "depth_median": float(np.median(error)) if error.size else 0.0,
        "depth_p99": float(np.quantile(error, 0.99)) if error.size else 0.0,
        "depth_max": float(error.max()) if error.size else 0.0,
    }


def save_png(path: str | Path, image: np.ndarray) -> None:
    """A linear 16-bit picture as an 8-bit sRGB PNG."""
    from PIL import Image

    v = image / 65535
    srgb = np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.power(v, 1 / 2.4) - 0.055)
    Image.fromarray(np.round(srgb * 255).astype(np.uint8)).save(path)


def self_test(out: Path) -> None:
    """Answers known by analysis: pixel centers, silhouette, depth and orientation. Raises
    AssertionError."""
    size, radius, strength, tau = (160, 120), 1.0, 1.0, 0.36
    d_m = radius * math.sqrt(1 - math.sqrt(tau / strength))  # where one metaball's field is the threshold
    for fov in (30.0, 17.3):
        camera = {"eye": (0.3, -0.2, 4.0), "look_at": (0.11, 0.07, 0.0), "up": (0, 1, 0), "fov": fov}
        range_ = write_scene(out / "self.pov", np.zeros((1, 3)), radius, strength, tau, camera, "depth", size)
        mask, depth = hit_mask_and_depth(run(out / "self.pov", size)[0], *range_)
        eye, ray = pixel_rays(camera, size)
        middle = -(ray @ eye)
        square = d_m**2 - (eye @ eye - middle**2)
        assert np.array_equal(mask, square > 0), f"silhouette: {(mask != (square > 0)).sum()} pixels differ"
        truth = middle - np.sqrt(np.maximum(square, 0))
        error = float(np.abs(depth - truth)[mask].max())
        # Half a pixel would shift depth by two orders more than the 24-bit mapping's own step.
        assert error < 2e-5, f"depth: {error}"
        print(f"self-test, fov {fov}: {mask.sum()} pixels hit, none wrong, depth within {error:.1e}")
    centers = np.array([[0.0, 0, 0], [1.2, 0, 0], [0, 0.8, 0]])
    camera = {"eye": (0, 0, 6.0), "look_at": (0, 0, 0), "up": (0, 1, 0), "fov": 40.0}
    range_ = write_scene(out / "self.pov", centers, 0.5, 1.0, tau, camera, "depth", size)
    mask, _ = hit_mask_and_depth(run(out / "self.pov", size)[0], *range_)
    assert mask[:, 100:].any(), "x must grow to the right"
    assert not mask[:, :60].any(), "x must grow to the right"
    assert mask[:50].any(), "y must grow upwards"
    assert not mask[80:].any(), "y must grow upwards"
    print("self-test, orientation: x to the right, y up, row 0 on top")


def _num(value: float) -> str:
    return f"{float(value):.12g}"


def _vec(v: np.ndarray) -> str:
    return "<" + ",".join(_num(c) for c in v) + ">"


def _triple(text: str) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in text.split(","))
    return x, y, z


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Render particles with POV-Ray's blob and compare.")
    parser.add_argument("particles", nargs="?", help=".npz with positions, and support and weight if it has them")
    parser.add_argument("--size", default="1024x782")
    parser.add_argument("--support", type=float)
    parser.add_argument("--threshold", type=float, default=0.6)
    parser.add_argument("--eye", type=_triple)
    parser.add_argument("--look-at", type=_triple)
    parser.add_argument("--fov", type=float, default=40.0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--mode", choices=(*MODES, "both"), default="both")
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--depth-npy", type=Path, help="our depth, (H, W), inf where missed")
    parser.add_argument("--compare", action="store_true", help="compare --depth-npy with POV-Ray's depth")
    parser.add_argument("--self-test", action="store_true", help="check against analysis and leave")
    options = parser.parse_args(arguments)
    if find_povray() is None:
        print("povray: not installed, skipped (Debian: apt-get install povray)")
        return 0
    out = options.out or Path(tempfile.mkdtemp(prefix="povray-"))
    out.mkdir(parents=True, exist_ok=True)
    if options.self_test:
        self_test(out)
        return 0
    if options.particles is None:
        parser.error("PARTICLES is needed unless --self-test is given")
    if options.compare and options.depth_npy is None:
        parser.error("--compare needs --depth-npy")
    width, height = (int(v) for v in options.size.split("x"))
    data = np.load(options.particles)
    positions = data["positions"]
    support = options.support if options.support is not None else data.get("support", None)
    if support is None:
        parser.error("--support is needed: the file has none")
    weight = data.get("weight", 1.0)
    color = data.get("color", None)
    camera = fit_camera(positions, options.fov)
    if options.eye is not None:
        camera["eye"] = options.eye
    if options.look_at is not None:
        camera["look_at"] = options.look_at
    report: dict[str, Any] = {"particles": len(positions), "rays": width * height, "threads": options.threads}
    modes = MODES if options.mode == "both" else (options.mode,)
    if options.compare and "depth" not in modes:
        modes = (*modes, "depth")
    for mode in modes:
        scene = out / f"{mode}.pov"
        range_ = write_scene(scene, positions, support, weight, options.threshold, camera, mode, (width, height), color)
        image, cpu, wall = run(scene, (width, height), options.threads)
        report[mode] = {"cpu_s": round(cpu, 3), "wall_s": round(wall, 3), "trace_cpu_s": render_seconds()}
        if mode == "depth":
            mask, depth = hit_mask_and_depth(image, *range_)
            report["hit"] = int(mask.sum())
            np.savez_compressed(out / "povray.npz", mask=mask, depth=depth)
            if options.compare:
                report["compare"] = compare(mask, depth, np.load(options.depth_npy))
        else:
            try:
                save_png(out / "shaded.png", image)
            except ImportError:
                print("shaded.png: not saved, Pillow is not installed", file=sys.stderr)
    print(json.dumps({**report, "out": str(out)}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
