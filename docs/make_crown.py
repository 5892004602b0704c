"""The crown of `droplet` in a wider pool, and its radius and height over time beside the laws.

python docs/make_crown.py            # writes docs/images/simulation/crown.png; needs matplotlib
python docs/make_crown.py picture    # writes docs/images/crown.jpg, of the README; a GPU takes 12 s
"""

import io
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import globule as gb
import numpy as np
from make_gallery import pack
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from bench.tables import physics_crown as bench

PICTURE = Path(__file__).resolve().parent / "images/crown.jpg"
TARGET = Path(__file__).resolve().parent / "images/simulation/crown.png"
SHOWN = (1.0, 3.0, 6.0, 10.0)  # tau
SIZE = (420, 315)
SPACINGS = {0.0005: "tab:blue", 0.00075: "tab:cyan", 0.0009: "tab:gray"}
CAMERA = gb.Camera((0.0, -0.1, 0.042), (0, 0, 0.006), (0, 0, 1), 24)


def water(sim: gb.Simulation) -> np.ndarray:
    """An image of the smooth surface, as water."""
    settings = gb.load_preset("water", sim.scene, (0, 0, 1))
    return np.asarray(gb.render(sim, CAMERA, SIZE, settings).image)[..., :3]


def run(spacing: float, images: list[np.ndarray]) -> bench.Crown:
    """The crown up to the last time shown, and images of it."""
    sim = bench.droplet(spacing)
    parts, first = [], 0.8
    for last in SHOWN:
        parts.append(bench.watch(sim, np.arange(first, last + 0.05, 0.1)))
        images.append(water(sim))
        first = last + 0.1
    return bench.Crown(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def picture() -> None:
    """One late crown, of finer particles and many samples."""
    sim = bench.droplet(0.00035, "auto")
    bench.watch(sim, np.array([9.5]))
    settings = replace(gb.load_preset("water", sim.scene, (0, 0, 1)), samples=32)
    shown = Image.fromarray(gb.render(sim, CAMERA, (1200, 640), settings).picture).convert("RGB")
    shown.crop((0, 60, 1200, 620)).save(PICTURE, quality=84, optimize=True, progressive=True)


def plot(crowns: dict[float, bench.Crown], size: tuple[int, int]) -> np.ndarray:
    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
    figure.set_layout_engine("constrained")
    FigureCanvasAgg(figure)
    radius, height = figure.subplots(2, sharex=True)
    for spacing, crown in crowns.items():
        style = {"color": SPACINGS[spacing], "label": f"spacing {spacing * 1000:g} mm"}
        radius.plot(crown.time, crown.radius, **style)
        height.plot(crown.time, crown.height, **style)
    tau = np.linspace(0.8, SHOWN[-1], 100)
    c = bench.yarin_weiss()
    finest = crowns[min(crowns)]
    at = np.interp(3.0, finest.time, finest.radius)
    power = bench.COSSALI_POWER
    radius.plot(tau, c * np.sqrt(tau), "k--", label="Yarin & Weiss 1995, tau0 = 0")
    radius.plot(tau, at * (tau / 3) ** power, "r:", label=f"slope of Cossali 2004, {power:g}")
    radius.set(xscale="log", yscale="log", ylabel="radius of the foot / D")
    radius.set_yticks([1, 1.5, 2, 3], ["1", "1.5", "2", "3"])
    height.set(xlabel="tau = t V / D since contact", ylabel="height of the rim / D", ylim=(0, None))
    height.set_xticks([1, 2, 3, 5, 10], ["1", "2", "3", "5", "10"])
    radius.minorticks_off()
    for axes in (radius, height):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    written = io.BytesIO()
    figure.savefig(written, format="png")
    return np.asarray(Image.open(written).convert("RGB"))


def main() -> None:
    if sys.argv[1:] == ["picture"]:
        return picture()
    crowns, images = {}, {}
    for spacing in SPACINGS:
        images[spacing] = []
        crowns[spacing] = run(spacing, images[spacing])
        print(spacing, bench.spread(crowns[spacing]), crowns[spacing].height.max(), flush=True)
    shown = images[min(SPACINGS)]
    strip = np.vstack([np.hstack(shown[:2]), np.hstack(shown[2:])])
    whole = np.hstack([strip, plot(crowns, (560, strip.shape[0]))])
    with tempfile.TemporaryDirectory() as folder:
        Image.fromarray(whole).save(Path(folder) / "crown.png")
        pack(Path(folder) / "crown.png", TARGET)


if __name__ == "__main__":
    main()
