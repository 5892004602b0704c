"""A page (.html) about an N-wire session: what was found, pictures, and what to do."""

from __future__ import annotations

import base64
import html
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._base.files import atomic_write
from .calibration_plots import draw_before_and_after, draw_wires
from .n_wires import NWireCalibration, WireErrors

_LARGE = 1.5  # mm, at the corners
WRONG = 3.0  # mm; larger 3-D errors (median) are no inaccuracy of dots
_APART = 3.0  # deviations between the offsets of both sweeps
WORSE = 2.0  # times the calibration's 3-D error
USE, REPEAT, OPEN = "use it", "repeat", "not validated"


class Session(NamedTuple):
    """What was done: names of the phantom, the sweep and the validation; the calibration with a
    fitted offset; the validation's errors and its own calibration, if there are."""

    phantom: str
    sweep: str
    validated: str | None
    found: NWireCalibration
    errors: WireErrors | None
    other: NWireCalibration | None


def verdict(session: Session) -> dict[str, Any]:
    """result: "use it", "repeat" or "not validated"; passed: whether it is the first; lines: what is wrong
    and what to do about it, a sentence each, or the stated errors; limits: what the result follows from."""
    lines = _faults(session)
    result = REPEAT if lines else USE
    if session.validated is None:
        result = result if lines else OPEN
        lines.append("Not validated: give another recording of the phantom by --validate.")
    lines = lines if result != USE else [_bound(session.found)]
    limits = {"corner_mm": _LARGE, "median_3d_mm": WRONG, "validation_ratio": WORSE, "offset_deviations": _APART}
    return {"result": result, "passed": result == USE, "lines": lines, "limits": limits}


def _faults(session: Session) -> list[str]:
    found, other, said = session.found, session.other, []
    for name, of in ((session.sweep, found), (session.validated, other)):
        if of is not None and of.slip:
            said.append(f"{name}: {of.slip}. Fasten it, register the phantom again, and repeat both sweeps.")
    for name, of in ((session.sweep, found), (session.validated, other)):
        if of is not None and of.misplaced:
            said.append(
                f"{name}: {of.misplaced}. Register {session.phantom} again (--landmarks), and check that the "
                "reference neither has moved nor drifts on the phantom."
            )
            break
    if found.errors.summary()["median"] > WRONG:
        said.append(
            f"3-D errors of {found.errors.summary()['median']:.1f} mm in {session.sweep}: check that "
            f"{session.phantom} is this phantom, that it is registered, and that poses are in mm."
        )
    if found.offset_doubt:
        said.append(
            f"The temporal offset of {session.sweep} is not certain: {found.offset_doubt}. "
            "Repeat the sweep at a changing, slower pace."
        )
    if found.corners.max() > _LARGE:
        said.append(
            f"Errors at the image's corners may reach {found.corners.max():.1f} mm: turn and tilt the probe "
            f"more, and move the dots through the whole image, in {session.sweep}."
        )
    if session.errors is not None:
        size, own = (of.summary()["mean_of_95"] for of in (session.errors, found.errors))
        if size > WORSE * own:
            said.append(
                f"{session.validated} disagrees: its 3-D error is {size:.2f} mm, that of {session.sweep} "
                f"{own:.2f} mm. Repeat {session.validated} slower; if it stays, the reference has moved on the phantom."
            )
    if session.validated and other is None:
        said.append(
            f"{session.validated} gives no calibration of its own: record 30 images or more that show all wires."
        )
    if other is not None and other.offset_doubt:
        said.append(f"{session.validated} disagrees: {other.offset_doubt}. Repeat {session.validated} slower.")
    elif other is not None and found.offset_uncertainty is not None and other.offset_uncertainty is not None:
        offsets = [of.calibration.temporal_offset for of in (found, other)]
        apart = np.hypot(found.offset_uncertainty, other.offset_uncertainty)
        if abs(offsets[0] - offsets[1]) > _APART * apart:
            said.append(
                f"{session.validated} disagrees: its temporal offset is {offsets[1]:+.3f} s, that of {session.sweep} "
                f"{offsets[0]:+.3f} s. Repeat {session.validated} slower; if both stay, the clocks drift."
            )
    return said


def write_report(path: Any, session: Session, frames: np.ndarray, phantom: Any) -> dict[str, Any]:
    """Write the page; returns the verdict. Needs matplotlib."""
    found = verdict(session)
    with tempfile.TemporaryDirectory() as folder:
        draw_wires(Path(folder) / "wires.png", frames, session.found, phantom, session.errors)
        draw_before_and_after(Path(folder) / "delay.png", session.found)
        pictures = [
            base64.b64encode((Path(folder) / f"{name}.png").read_bytes()).decode() for name in ("wires", "delay")
        ]
    rows = "".join(f"<tr><th>{html.escape(a)}<td>{html.escape(b)}" for a, b in _rows(session))
    verdicts = "".join(f"<li>{html.escape(line)}" for line in found["lines"])
    page = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>N-wire calibration</title>'
        '<meta name="viewport" content="width=device-width">'
        "<style>body{font:16px sans-serif;max-width:72em;margin:2em auto;padding:0 1em}img{width:100%}"
        "body{overflow-wrap:anywhere}table{width:100%}th{width:30%}td{white-space:pre-line}"
        "th,td{text-align:left;vertical-align:top;padding:.2em 1em .2em 0}</style>"
        f"<h1>N-wire calibration: {found['result']}</h1><ul>{verdicts}</ul><p>{_LIMITS}</p><table>{rows}</table>"
        "<h2>Dots, and residuals along the sweep</h2>"
        f'<img alt="dots on images, and errors" src="data:image/png;base64,{pictures[0]}">'
        "<h2>Before and after the temporal offset</h2>"
        f'<img alt="errors at both offsets" src="data:image/png;base64,{pictures[1]}">'
    )
    with atomic_write(path, "w") as file:
        file.write(page + "\n")
    return found


_LIMITS = (
    f"Limits of the verdict: stated errors at the image's corners up to {_LARGE:g} mm, 3-D errors (median) up to "
    f"{WRONG:g} mm, the validation's 3-D error up to {WORSE:g} times the calibration's, temporal offsets of both "
    f"sweeps within {_APART:g} standard deviations, no doubt about an offset, no slip of the reference, and a phantom "
    "that lies where it is registered."
)


def _bound(found: NWireCalibration) -> str:
    return (
        f"In 95 % of such calibrations, errors stay below {found.center:.2f} mm in the middle of the wires and "
        f"{found.corners.max():.2f} mm at the image's corners."
    )


def _rows(session: Session) -> list[tuple[str, str]]:
    found = session.found
    rows = [
        ("phantom", session.phantom), ("sweep", session.sweep), ("validation", session.validated or "none"),
        ("stated errors", _bound(found)),
    ]  # fmt: skip
    for name, of in (("calibration", found), ("validation", session.other)):
        if of is not None and of.offset_uncertainty is not None:
            offset = f"{of.calibration.temporal_offset:+.4f} ± {of.offset_uncertainty:.4f} s"
            rows.append((f"temporal offset, {name}", offset))
    advice = "An image at time t takes the pose at t + offset. In PLUS, add the offset to LocalTimeOffsetSec of the "
    rows.append(("what the offset means", advice + "images' Device."))
    n_found, n_used = int(found.points.found.sum()), len(found.errors.frames)
    if n_used < n_found:
        left = f"{n_found - n_used:,} of {n_found:,}: no pose at their time + offset"
        rows.append(("images that are not used", left))
    errors = [("before the offset", found.by_offset[0]), ("calibration", found.errors)]
    if session.errors is not None:
        errors.append(("validation", session.errors))
    for name, one in errors:
        size = one.summary()
        text = f"{size['mean_of_95']:.3f} ± {size['deviation_of_95']:.3f} mm (best 95 %)"
        text += f", {size['rms_pixels']:.2f} pixels rms, {len(one.frames):,} images"
        rows.append((f"3-D error and distances, {name}", text))
    matrix = found.calibration.probe_from_image
    rows.append(("probe_from_image", "\n".join(" ".join(f"{x:.6g}" for x in row) for row in matrix)))
    return rows
