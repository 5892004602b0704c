#!/usr/bin/env python3
"""Light against POV-Ray 3.7: the same blob, camera and lights, mirrored, refracted and shadowed.

    python bench/peers/light.py [--scenes ball,cluster,splash] [--size 480x360] [-o OUT]

Each scene is drawn with several looks, each of which leaves to POV-Ray nothing to interpret:

    clay      matte, one sun, ambient light, its shadow on a checkered ground
    mirror    reflection 0.6 that grows to 1 by Schlick's rule: `reflection { 0.6, 1 falloff 5 }`
    glass     index 1.5: `reflection { 0, 1 fresnel on } conserve_energy`, pigment transmit 1
    beer      the same with absorption: `fade_power 1001`, which is exp(-a d); POV-Ray leaves it out
              on the ways between internal reflections, we do not
    straight  index 1 with absorption: no ray bends, so that only lengths count
    both      glass over a mirroring checkered ground with the sun's shadow

The sky tells directions, (d + 1) / 2 as linear color; `background` is never seen. Both follow rays
to the same weight. POV-Ray starts secondary rays 0.001 units on, so lengths are scaled until that
is little; its pictures are linear, 16 bits, one ray a pixel.

A table is printed: mean absolute differences in levels of 255, linear and as sRGB, the largest of
the three colors counting: of all pixels; `away` from silhouettes, where the 3 x 3 pixels around
show one surface; and of the `steady` share of these, whose color in our own picture stays within a
level when the eye moves by 1e-4 supports. Light that is bent or mirrored several times is chaotic:
there the last digit of a root decides where a ray ends, in either program. `over_2`: the share of
steady pixels that differ by more than two levels. With --out, ours, POV-Ray's, and 16 times the
difference.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent)]
import globule as gb  # noqa: E402
import povray  # noqa: E402
from globule._demo.data import splash  # noqa: E402
from globule.render.frame import save_png  # noqa: E402

SUN = np.array([0.45, 1.0, 0.35]) / math.sqrt(0.45**2 + 1 + 0.35**2)
SUN_LIGHT, AMBIENT = 0.6, 0.15
COLOR = (0.8, 0.55, 0.3)
ABSORPTION = (0.25, 0.6, 1.2)  # per support
TAU = 0.6
DEPTH, CUTOFF = 24, 1e-4
LOOKS = ("clay", "mirror", "glass", "beer", "straight", "both")


@dataclass
class Blob:
    positions: np.ndarray
    support: float
    color: np.ndarray | None = None


def blob(name: str) -> Blob:
    """A scene whose support is 50 units: POV-Ray's 0.001 is then 2e-5 of it."""
    rng = np.random.default_rng(1)
    if name == "ball":
        return Blob(np.zeros((1, 3), np.float32), 50.0)
    if name == "cluster":  # a ball of lattice points, a little out of place
        x = np.arange(-5, 6)
        p = np.stack(np.meshgrid(x, x, x), -1).reshape(-1, 3).astype(float)
        p = p[np.linalg.norm(p, axis=1) < 5.2] + rng.uniform(-0.2, 0.2, 3)
        p = p + rng.uniform(-0.25, 0.25, p.shape)
        color = rng.uniform(0.2, 1, p.shape).astype(np.float32)
        return Blob((25 * p).astype(np.float32), 50.0, color)
    if name == "splash":
        p, _, spacing = splash(2000)
        return Blob((p * (25 / spacing)).astype(np.float32), 50.0)
    raise ValueError(f"scenes: expected ball, cluster or splash, got {name!r}")


def direction_sky(rows: int = 512) -> gb.Environment:
    """Radiance (d + 1) / 2 from direction d."""
    up, east = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    tilt = (np.arange(rows) + 0.5)[:, None, None] / rows * np.pi
    turn = ((np.arange(2 * rows) + 0.5)[None, :, None] / (2 * rows) - 0.5) * 2 * np.pi
    level = east * np.cos(turn) + np.cross(up, east) * np.sin(turn)
    return gb.Environment((1 + up * np.cos(tilt) + level * np.sin(tilt)) / 2, up=up)


def on_ground(look: str) -> bool:
    return look in ("clay", "both")


def ours(b: Blob, look: str, camera: gb.Camera, size: tuple[int, int], device: str) -> gb.Frame:
    color = COLOR if b.color is None else b.color
    scene = gb.Scene(gb.Particles(b.positions, support=b.support, color=color), threshold=TAU, device=device)
    absorption = tuple(a / b.support for a in ABSORPTION)
    material = {
        "clay": gb.Material(0.0, 0.0),
        "mirror": gb.Material(0.6, 0.0, color=0.0),
        "glass": gb.Material(0.0, 1.0, 1.5, absorption=0.0),
        "beer": gb.Material(0.0, 1.0, 1.5, absorption=absorption),
        "straight": gb.Material(0.0, 1.0, 1.0, absorption=absorption),
        "both": gb.Material(0.0, 1.0, 1.5, absorption=0.0),
    }[look]
    settings = gb.RenderSettings(
        lights=[gb.DirectionalLight(SUN, (SUN_LIGHT,) * 3)],
        ambient=AMBIENT,
        specular=0.0,
        material=material,
        shadows=True,
        sky=direction_sky(),
        ground=ground(b, look),
        bounces=DEPTH,
        cutoff=CUTOFF,
    )
    return gb.render(scene, camera, size, settings)


def ground(b: Blob, look: str) -> gb.Ground | None:
    if not on_ground(look):
        return None
    height = float(b.positions[:, 1].min()) - b.support
    return gb.Ground(height, color=0.9, other=0.3, check=2 * b.support, reflection=0.25 if look == "both" else 0)


def theirs(b: Blob, look: str, camera: gb.Camera, size: tuple[int, int], folder: Path) -> np.ndarray:
    """Linear picture (H, W, 3), 0 to 1."""
    num, vec = povray._num, povray._vec
    view = {"eye": camera.eye, "look_at": camera.look_at, "up": camera.up, "fov": camera.fov}
    eye, right, up, forward = povray.frame_vectors(view)
    t = math.tan(math.radians(camera.fov) / 2)
    far = 1e4 * b.support
    sky = " ".join(
        f"[1 function {{ ({axis}+1)/2 }} color_map {{ [0 rgb 0] [1 rgb {vec(3 * np.eye(3)[k])}] }}]"
        for k, axis in enumerate("xyz")
    )
    lines = [
        "#version 3.7;",
        f"global_settings {{ assumed_gamma 1 ambient_light 1 max_trace_level {DEPTH + 2} adc_bailout {num(CUTOFF)} }}",
        f"camera {{ perspective location {vec(eye)} direction {vec(forward)}"
        f" right {vec(right * (2 * t * size[0] / size[1]))} up {vec(up * (2 * t))} }}",
        f"light_source {{ {vec(SUN * far)} rgb {SUN_LIGHT} parallel point_at 0 }}",
        f"sky_sphere {{ pigment {{ average pigment_map {{ {sky} }} }} }}",
    ]
    g = ground(b, look)
    if g:
        mirror = f"reflection {{ {g.reflection} }}" if g.reflection else ""
        share = 1 - g.reflection  # we take the mirror's share from the matte one
        lines += [
            # Our fields are floor(x) + floor(-z), of the other parity than floor(x) + floor(z).
            f"plane {{ y, {num(g.height)} pigment {{ checker rgb {g.other} rgb {g.color}"
            f" scale {num(g.check)} translate y*{num(g.height - g.check / 2)} }}"
            f" finish {{ ambient {AMBIENT * share} diffuse {share} {mirror} }} }}"
        ]
    glass = "finish { ambient 0 diffuse 0 reflection { 0, 1 fresnel on } conserve_energy }"
    a = np.array(ABSORPTION) / b.support
    fade = f"fade_power 1001 fade_distance {num(1 / a.max())} fade_color {vec(1 - a / a.max())}"
    texture, interior = {
        "clay": ("pigment { rgb 0 }", ""),  # each component has its own
        "mirror": ("pigment { rgb 0 } finish { ambient 0 diffuse 0 reflection { 0.6, 1 falloff 5 } }", ""),
        "glass": (f"pigment {{ rgb 1 transmit 1 }} {glass}", "interior { ior 1.5 }"),
        "beer": (f"pigment {{ rgb 1 transmit 1 }} {glass}", f"interior {{ ior 1.5 {fade} }}"),
        "straight": ("pigment { rgb 1 transmit 1 } finish { ambient 0 diffuse 0 }", f"interior {{ ior 1 {fade} }}"),
        "both": (f"pigment {{ rgb 1 transmit 1 }} {glass}", "interior { ior 1.5 }"),
    }[look]
    rows = []
    for k, p in enumerate(b.positions.astype(float)):
        tint = COLOR if b.color is None else b.color[k]
        own = (
            f" texture {{ pigment {{ rgb {vec(np.asarray(tint, float))} }} finish {{ ambient {AMBIENT} diffuse 1 }} }}"
        )
        rows.append(f"sphere {{ {vec(p)}, {num(b.support)}, 1{own if look == 'clay' else ''} }}")
    lines += [f"blob {{ threshold {TAU}", *rows, f"texture {{ {texture} }} {interior} }}"]
    path = folder / f"{look}.pov"
    path.write_text("\n".join(lines), encoding="ascii")
    return povray.run(path, size)[0] / 65535.0


def srgb(linear: np.ndarray) -> np.ndarray:
    v = np.clip(linear, 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def one_surface(frame: gb.Frame, support: float) -> np.ndarray:
    """Pixels away from silhouettes: the 3 x 3 around them show one surface, or none."""
    depth = np.where(np.isfinite(frame.distance), frame.distance, 1e9)
    p = np.pad(depth, 1, mode="edge")
    h, w = depth.shape
    around = np.stack([p[i : i + h, j : j + w] for i in range(3) for j in range(3)])
    return around.max(0) - around.min(0) < 0.3 * support


def steady(b: Blob, look: str, camera: gb.Camera, picture: np.ndarray, device: str) -> np.ndarray:
    """Pixels whose color stays within a level when the eye moves by 1e-4 supports, which is what
    bent rays make of a difference in the last digits."""
    same = np.ones(picture.shape[:2], bool)
    for way in 1e-4 * b.support * np.concatenate([np.eye(3), -np.eye(3)]):
        moved = dataclasses.replace(camera, eye=np.add(camera.eye, way), look_at=np.add(camera.look_at, way))
        other = ours(b, look, moved, picture.shape[1::-1], device).color
        same &= np.abs(other - picture).max(-1) < 1 / 255
    return same


def compare(name: str, look: str, size: tuple[int, int], device: str, folder: Path) -> dict:
    b = blob(name)
    camera = gb.Camera.fit(b.positions, margin=0.6 * b.support, size=size, direction=(0.5, 0.6, 1))
    frame = ours(b, look, camera, size, device)
    mine = np.clip(frame.color.astype(float), 0, 1)
    other = theirs(b, look, camera, size, folder)
    linear = np.abs(mine - other).max(-1) * 255
    shown = np.abs(srgb(mine) - srgb(other)).max(-1) * 255
    away = one_surface(frame, b.support)
    still = away & steady(b, look, camera, frame.color, device)
    side = np.concatenate([srgb(mine), srgb(other), np.repeat(shown[..., None] / 16, 3, -1)], 1)
    side = (np.clip(side, 0, 1) * 255 + 0.5).astype(np.uint8)
    return {"look": look, "picture": side, "linear": linear.mean(), "srgb": shown.mean(),
            "linear_away": linear[away].mean(), "srgb_away": shown[away].mean(),
            "median": np.median(shown[away]), "steady": (still.sum() / away.sum()),
            "linear_steady": linear[still].mean(), "srgb_steady": shown[still].mean(),
            "over_2": (shown[still] > 2).mean()}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", default="ball,cluster,splash")
    parser.add_argument("--looks", default=",".join(LOOKS))
    parser.add_argument("--size", default="480x360")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("-o", "--out", type=Path, help="folder for pictures")
    options = parser.parse_args()
    if povray.find_povray() is None:
        print("povray: not installed (Debian: apt-get install povray), comparison skipped")
        return
    width, _, height = options.size.partition("x")
    size = (int(width), int(height))
    columns = ("linear", "srgb", "linear_away", "srgb_away", "median", "steady",
               "linear_steady", "srgb_steady", "over_2")  # fmt: skip
    print("mean absolute differences in levels of 255")
    print(f"{'scene':8} {'look':9}" + "".join(f"{c:>14}" for c in columns))
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name in options.scenes.split(","):
            rows = [compare(name, look, size, options.device, folder)
                    for look in options.looks.split(",")]  # fmt: skip
            for row in rows:
                print(f"{name:8} {row['look']:9}" + "".join(f"{row[c]:14.4f}" for c in columns))
            if options.out:
                everything = np.concatenate([row["picture"] for row in rows])
                save_png(folder / f"{name}.png", everything)


if __name__ == "__main__":
    main()
