"""Pictures of calibrations: what was found, and what is left over."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.plot import BLUE, GRAY, GREEN, INK, ORANGE, RED, Figure

_DPI = 100


def draw_offset(path: Any, found: Any) -> None:
    """The motion of image and probe, brought together, and their correlation at each offset."""
    curves = found.curves
    with Figure(path, 9, 5, _DPI) as figure:
        above, below = figure.subplots(2)
        times = curves.times - curves.times[0]
        above.plot(times, curves.image, color=BLUE, lw=1.2, label=f"image ({found.method})")
        above.plot(times, curves.probe, color=ORANGE, lw=1.2, label="probe, moved by the offset")
        top = float(np.abs(curves.image).max())
        above.set(xlabel="time, s", ylabel="motion, normalized", ylim=(-1.1 * top, 1.6 * top))
        above.legend(loc="upper right", ncols=2)
        below.plot(curves.lags, curves.scores, color=INK, lw=1.2)
        below.axvline(found.offset, color=RED, lw=1)
        if np.isfinite(found.uncertainty):
            low, high = (found.offset + s * 2 * found.uncertainty for s in (-1, 1))
            below.axvspan(low, high, color=RED, alpha=0.15, lw=0)
        below.set(xlabel="offset, s (band: two standard deviations)", ylabel="correlation")
        doubt = f", uncertain: {found.doubt}" if found.doubt else ""
        above.set_title(f"temporal offset {found.offset:+.4f} ± {found.uncertainty:.4f} s{doubt}")


def draw_wires(path: Any, frames: np.ndarray, found: Any, phantom: Any, validation: Any = None) -> None:
    """Dots and where the wires should be, in three images; errors over the images."""
    errors, points = found.errors, found.points.points
    shown = errors.frames[np.linspace(0, len(errors.frames) - 1, 3).astype(int)]
    seen = points[errors.frames].reshape(-1, 2)
    low, high = seen.min(axis=0) - 40, seen.max(axis=0) + 40
    with Figure(path, 11, 6.4, _DPI) as figure:
        axes = figure.subplots(2, 3)
        for ax, i in zip(axes[0], shown, strict=True):
            at = int(np.flatnonzero(errors.frames == i)[0])
            bright = np.sqrt(frames[i] / max(float(frames[i].max()), 1.0))
            ax.imshow(bright, cmap="gray", interpolation="nearest")
            expected = points[i] - errors.two_d[at]
            ax.scatter(*points[i].T, s=60, facecolors="none", edgecolors=ORANGE, lw=1)
            ax.scatter(*expected.T, s=22, marker="+", color=GREEN, lw=1)
            for name, (column, row) in zip(phantom.names, points[i], strict=True):
                ax.text(column + 8, row - 8, name.split(":")[0], color="white", fontsize=7)
            ax.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), title=f"image {i}")
            ax.axis("off")
        ax = axes[1, 0]
        ax.plot(errors.frames, errors.three_d.mean(axis=1), color=BLUE, lw=1, label="calibration")
        if validation is not None:
            values = validation.three_d.mean(axis=1)
            ax.plot(validation.frames, values, color=RED, lw=1, label="validation")
            ax.legend()
        ax.set(xlabel="image", ylabel="mean 3-D error, mm", ylim=(0, None))
        colors = {"calibration": (errors, BLUE), "validation": (validation, RED)}
        for ax, which in zip(axes[1, 1:], colors, strict=True):
            of, color = colors[which]
            if of is None:
                ax.axis("off")
                continue
            ax.scatter(*of.two_d.reshape(-1, 2).T, s=3, color=color, alpha=0.4, lw=0)
            ax.axhline(0, color=GRAY, lw=0.6)
            ax.axvline(0, color=GRAY, lw=0.6)
            rms = of.summary()["rms_pixels"]
            ax.set(xlabel="columns", ylabel="rows", title=f"{which}: {rms:.1f} pixels rms")
            ax.set_aspect("equal", "datalim")
        figure.suptitle("orange: dot found   green: wire by the calibration", fontsize=10)


def draw_before_and_after(path: Any, found: Any) -> None:
    """3-D errors over the images, at the given offset and at the fitted one."""
    with Figure(path, 11, 3.2, _DPI) as figure:
        ax = figure.subplots()
        for errors, color, label in zip(found.by_offset, (GRAY, BLUE), ("given offset", "fitted offset"), strict=True):
            mean = errors.summary()["mean_of_95"]
            ax.plot(errors.frames, errors.three_d.mean(axis=1), color=color, lw=1, label=f"{label}: {mean:.3f} mm")
        ax.set(xlabel="image", ylabel="mean 3-D error, mm", ylim=(0, None))
        ax.legend()


def draw_residuals(path: Any, lengths: Any, weights: Any, what: str, held_out: Any = None) -> None:
    """A bar for each observation, mm; those that do not count in red."""
    lengths, weights = np.asarray(lengths), np.asarray(weights)
    with Figure(path, 8, 3.4, _DPI) as figure:
        ax = figure.subplots()
        numbers = np.arange(1, len(lengths) + 1)
        colors = np.where(weights > 0, BLUE, RED)
        ax.bar(numbers, lengths, color=colors, width=0.8)
        if held_out is not None:
            ax.plot(numbers, held_out, "o", color=ORANGE, ms=4, label="by a fit without it")
            ax.legend()
        kept = lengths[weights > 0]
        rms = float(np.sqrt(np.mean(kept**2))) if len(kept) else 0.0
        top = 1.15 * max(float(np.percentile(lengths, 95)), 3 * rms, 1e-9)
        ax.set(xlabel=what, ylabel="residual, mm", ylim=(0, min(top, 1.15 * lengths.max())))
        left = int((weights == 0).sum())
        ax.set_title(f"rms {rms:.3f} mm; outliers (red): {left}")
