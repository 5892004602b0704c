"""What `globule calibrate` prints."""

from __future__ import annotations

from typing import Any

import numpy as np

from .shared import count


def lines_of(report: dict[str, Any]) -> list[str]:
    """What the command prints."""
    lines = []
    if "rms" in report:
        lengths = report["residuals"]
        u, v = report["spacing"]
        target = " ".join(f"{x:.2f}" for x in report["target"])
        lines += [
            f"{count(len(lengths), 'mark')}: rms {report['rms']:.3f} mm, median "
            f"{np.median(lengths):.3f}, largest {lengths.max():.3f} mm (mark "
            f"{int(lengths.argmax()) + 1})",
            f"  pixels of {u:.5f} x {v:.5f} mm, target at {target} mm",
            f"  expected error at the image's corners {report['corner_errors'].max():.2f} mm at "
            f"most (1 sigma); marks left out of the fit are off by "
            f"{np.median(report['held_out']):.2f} mm (median)",
            "  residuals: " + " ".join(f"{x:.2f}" for x in lengths),
        ]
    lines += _line_of_stylus(report) + _lines_of_registration(report) + _lines_of_wires(report)
    if "temporal_offset" in report and report["temporal_offset"]["method"] != "given":
        found = report["temporal_offset"]
        apart = found["uncertainty"]
        within = f"± {apart:.4f}" if np.isfinite(apart) else "(of unknown accuracy)"
        line = f"temporal offset {found['offset']:+.4f} s {within} from the {found['method']}"
        if "correlation" in found:
            line += f", correlation {found['correlation']:.2f}, reached by chance in "
            line += f"{100 * found['chance']:.0f} %"
        lines.append(line)
        lines.append("  an image at time t takes the pose at t + offset; in PLUS, add the offset to "
                     "LocalTimeOffsetSec of the images' Device")  # fmt: skip
        if found["skew"] is not None:
            lines.append(f"  last column of the echo {found['skew']:+.3f} s beside the first")
        if found.get("beat_extent") is not None:
            lines.append(
                f"  the offset varies by {found['beat_extent']:.3f} s in a sawtooth of "
                f"{found['beat_period']:.1f} s: images are recorded at another rate than the "
                "scanner makes them"
            )
    lines += _lines_of_verdict(report)
    if report["output"]:
        lines.append(f"{report['output']}: written")
    return lines


def _line_of_stylus(report: dict[str, Any]) -> list[str]:
    if "stylus" not in report:
        return []
    found = report["stylus"]
    tip = " ".join(f"{x:.3f}" for x in found["tip"])
    return [
        f"tip of the stylus at {tip} mm, ± {found['error']:.2f} mm (1 sigma)",
        f"  {count(found['poses'], 'pose')} over {found['turn']:.0f} degrees, "
        f"{found['left_out']:,} left out, rms {found['rms']:.3f} mm",
    ]


def _lines_of_registration(report: dict[str, Any]) -> list[str]:
    if "registration" not in report:
        return []
    found = report["registration"]
    residuals = ", ".join(f"{name} {size:.2f}" for name, size in zip(found["names"], found["residuals"], strict=True))
    return [
        f"{count(len(found['names']), 'landmark')}: rms {found['rms']:.3f} mm, expected error at "
        f"the wires {found['error']:.2f} mm (1 sigma), below {found['bound']:.2f} mm in 95 % of such registrations",
        f"  residuals: {residuals} mm",
    ]


def _lines_of_wires(report: dict[str, Any]) -> list[str]:
    if "calibration" not in report:
        return []
    lines = []
    for name in ("calibration", "validation"):
        if name in report:
            of = report[name]
            lines.append(
                f"{name}: {of['found']:,} of {count(of['images'], 'image')} show all wires{_unused(of)}; 3-D "
                f"error {of['mean_of_95']:.3f} ± {of['deviation_of_95']:.3f} mm (best 95 %, as "
                f"PLUS), {of['mean']:.3f} ± {of['deviation']:.3f} mm (all), "
                f"{of['rms_pixels']:.2f} pixels rms"
            )
    u, v = report["spacing"]
    return [
        *lines,
        f"  pixels of {u:.5f} x {v:.5f} mm; in 95 % of such calibrations, errors stay below "
        f"{report['center_error']:.2f} mm in the middle of the wires and "
        f"{report['corner_errors'].max():.2f} mm at the image's corners",
    ]


def _unused(of: dict[str, Any]) -> str:
    n = of["without_pose"]
    return f" ({n:,} without a pose at their time + offset, not used)" if n else ""


def _lines_of_verdict(report: dict[str, Any]) -> list[str]:
    if "verdict" not in report:
        return []
    verdict = report["verdict"]
    return [
        f"verdict: {verdict['result']}",
        *(f"  {line}" for line in verdict["lines"]),
        f"{report['report']}: written",
    ]
