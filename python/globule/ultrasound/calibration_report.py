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
_APART = 3.0  # deviations between the offsets of both sweeps
_WORSE = 2.0  # times the calibration's 3-D error


class Session(NamedTuple):
    """What was done: names of the phantom, the sweep and the validation; the calibration with a
    fitted offset; the validation's errors and its own calibration, if there are."""

    phantom: str
    sweep: str
    validated: str | None
    found: NWireCalibration
    errors: WireErrors | None
    other: NWireCalibration | None


def verdict(session: Session) -> list[str]:
    """What is wrong and what to do about it, a sentence each; none if nothing is."""
    found, other, said = session.found, session.other, []
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
        if size > _WORSE * own:
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


def write_report(path: Any, session: Session, frames: np.ndarray, phantom: Any) -> list[str]:
    """Write the page; returns the verdict. Needs matplotlib."""
    said = verdict(session)
    good = f"Use this calibration. {_bound(session.found)}"
    with tempfile.TemporaryDirectory() as folder:
        draw_wires(Path(folder) / "wires.png", frames, session.found, phantom, session.errors)
        draw_before_and_after(Path(folder) / "delay.png", session.found)
        pictures = [
            base64.b64encode((Path(folder) / f"{name}.png").read_bytes()).decode() for name in ("wires", "delay")
        ]
    rows = "".join(f"<tr><th>{html.escape(a)}<td>{html.escape(b)}" for a, b in _rows(session))
    verdicts = "".join(f"<li>{html.escape(line)}" for line in said or [good])
    page = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>N-wire calibration</title>'
        "<style>body{font:16px sans-serif;max-width:72em;margin:2em auto;padding:0 1em}img{width:100%}"
        "th,td{text-align:left;vertical-align:top;padding:.2em 2em .2em 0}</style>"
        f"<h1>N-wire calibration: {'repeat' if said else 'use it'}</h1><ul>{verdicts}</ul><table>{rows}</table>"
        "<h2>Dots, and residuals along the sweep</h2>"
        f'<img alt="dots on images, and errors" src="data:image/png;base64,{pictures[0]}">'
        "<h2>Before and after the temporal offset</h2>"
        f'<img alt="errors at both offsets" src="data:image/png;base64,{pictures[1]}">'
    )
    with atomic_write(path, "w") as file:
        file.write(page + "\n")
    return said or [good]


def _bound(found: NWireCalibration) -> str:
    return (
        f"In 95 % of such calibrations, errors stay below {found.center:.2f} mm in the middle of the wires and "
        f"{found.corners.max():.2f} mm at the image's corners."
    )


def _rows(session: Session) -> list[tuple[str, str]]:
    found = session.found
    rows = [("phantom", session.phantom), ("sweep", session.sweep), ("stated errors", _bound(found))]
    for name, of in (("calibration", found), (session.validated or "", session.other)):
        if of is not None and of.offset_uncertainty is not None:
            offset = f"{of.calibration.temporal_offset:+.4f} ± {of.offset_uncertainty:.4f} s"
            rows.append((f"temporal offset, {name}", offset))
    errors = [("before the offset", found.by_offset[0]), ("calibration", found.errors)]
    if session.errors is not None:
        errors.append((f"validation, {session.validated}", session.errors))
    for name, one in errors:
        size = one.summary()
        text = f"{size['mean_of_95']:.3f} ± {size['deviation_of_95']:.3f} mm (best 95 %)"
        text += f", {size['rms_pixels']:.2f} pixels rms"
        rows.append((f"3-D error and distances, {name}", text))
    matrix = found.calibration.probe_from_image
    rows.append(("probe_from_image", "; ".join(" ".join(f"{x:.6g}" for x in row) for row in matrix)))
    return rows
