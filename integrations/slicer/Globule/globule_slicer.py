"""The module's work, without Slicer: install words, the live command, volumes from files and
frames, calibration.

Slicer's coordinates are RAS; matrices that enter and leave this file are RAS.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

EXTRAS = "live,medical,measure,figures"
DEVICES = ("Volume", "Trust", "Slice", "Surface", "LiveImageToReference", "Counts")


def installed() -> bool:
    """Whether globule can be imported."""
    return importlib.util.find_spec("globule") is not None


def requirement(wheel: str = "") -> str:
    """What pip installs: a wheel's file with globule's extras, or the released package.

    Raises FileNotFoundError for a wheel that does not exist, ValueError for another kind of file.
    """
    if not wheel:
        return f"globule[{EXTRAS}]"
    path = os.path.abspath(os.path.expanduser(wheel))
    name = os.path.basename(path)
    if not (name.startswith("globule-") and name.endswith(".whl")):
        raise ValueError(f"wheel: expected globule-….whl, got {name}")
    if not os.path.isfile(path):
        raise FileNotFoundError(2, "expected a file", path)
    return f"{path}[{EXTRAS}]"


@dataclass
class LiveSettings:
    """The settings of a live reconstruction.

    images       igtl://host:port of the server that sends images
    tracker      the same of the tracker's server; "": the server of the images
    voxel_size   mm
    calibration  .toml or .xml file; "": poses are those of the images
    port         at which Slicer gets volumes
    record       folder that keeps every frame; "": none
    output       file of the last volume
    idle         s of silence that end the run
    """

    images: str = "igtl://localhost:18944"
    tracker: str = ""
    voxel_size: float = 0.5
    calibration: str = ""
    port: int = 18945
    record: str = ""
    output: str = "live.nrrd"
    idle: float = 3600.0

    def command(self, python: str) -> list[str]:
        """The words that run it. Raises ValueError for settings that cannot work."""
        if not self.voxel_size > 0:
            raise ValueError(f"voxel size: expected a positive number, got {self.voxel_size}")
        for name in ("images", "tracker"):
            address = getattr(self, name)
            if not address.startswith("igtl://") and (address or name == "images"):
                raise ValueError(f"{name}: expected igtl://host:port, got {address!r}")
        words = [
            python, "-m", "globule", "reconstruct", "--live", self.images,
            "--voxel-size", f"{self.voxel_size:g}", "--serve", str(self.port),
            # Slicer takes the transforms of all senders as RAS.
            "--space", "RAS", "--idle", f"{self.idle:g}", "--wait", f"{self.idle:g}",
            "-o", self.output,
        ]  # fmt: skip
        for name in ("tracker", "calibration", "record"):
            if getattr(self, name):
                words += [f"--{name}", getattr(self, name)]
        return words


class LiveRun:
    """A live reconstruction in a process of its own, so that Slicer stays responsive."""

    def __init__(self, settings: LiveSettings, python: str = sys.executable):
        groups: dict[str, Any] = {}
        if os.name == "nt":
            groups["creationflags"] = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
        self.process = subprocess.Popen(
            settings.command(python), stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL, text=True, **groups,
        )  # fmt: skip

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    def stop(self, patience: float = 60.0) -> str:
        """End the run; the last volume is written. Returns what the command printed.

        On Windows a process ends at once: the frames are in the folder `record`.
        """
        if self.running:
            # Not Ctrl-C's signal, which is ignored where a shell started Slicer with &.
            self.process.terminate()
        try:
            return self.process.communicate(timeout=patience)[0]
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.communicate()[0]


class Calibrated(NamedTuple):
    """A calibration by an N-wire phantom.

    calibration  file for the other sections; "" where none was written
    report       page with verdict, numbers and pictures
    passed       whether the verdict is to use it
    text         what the command printed
    """

    calibration: str
    report: str
    passed: bool
    text: str


def calibrate(phantom: str, sweep: str, validate: str, folder: str, python: str = sys.executable) -> Calibrated:
    """Calibrate by a recording of an N-wire phantom; another one, `validate`, may be "".

    Raises ValueError for files that are not given, RuntimeError with what `globule calibrate` says.
    """
    for name, path in (("phantom", phantom), ("sweep", sweep)):
        if not path:
            raise ValueError(f"{name}: expected a file, got none")
    made = {name: os.path.join(folder, f"globule_{name}") for name in ("probe.toml", "report.html")}
    for path in made.values():
        if os.path.exists(path):
            os.remove(path)
    words = [python, "-m", "globule", "calibrate", "--n-wire", phantom, "--sweep", sweep, "--delay",
             "-o", made["probe.toml"], "--report", made["report.html"]]  # fmt: skip
    words += ["--validate", validate] if validate else []
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    there = {name: path if os.path.isfile(path) else "" for name, path in made.items()}
    if done.returncode not in (0, 1) or not there["report.html"]:
        raise RuntimeError(done.stdout.strip() or f"globule calibrate ended with {done.returncode}")
    return Calibrated(there["probe.toml"], there["report.html"], done.returncode == 0, done.stdout)


class Shown(NamedTuple):
    """A volume for Slicer: values and trust (Z, Y, X), and RAS from voxel (x, y, z, 1), (4, 4).

    trust   0 empty, 1 measured, 2 filled, 3 extrapolated
    text    what to tell the user
    """

    values: np.ndarray
    trust: np.ndarray
    ras_from_voxel: np.ndarray
    text: str


def reconstruct_file(
    path: str, voxel_size: float, calibration: str = "", poses: str = "", method: str = "frames"
) -> Shown:
    """The volume of a tracked sweep's file. Raises as `globule.ultrasound.read_sweep` and
    `globule.ultrasound.reconstruct` do."""
    import globule as gb

    if not path:
        raise ValueError("sweep: expected a file, got none")
    sweep = gb.ultrasound.read_sweep(path, calibration=calibration or None, poses=poses or None)
    return _shown(gb.ultrasound.reconstruct(sweep, spacing=voxel_size, method=method), sweep)


def reconstruct_frames(
    frames: Sequence[np.ndarray], ras_from_image: Sequence[np.ndarray], voxel_size: float,
    times: Sequence[float] | None = None, method: str = "frames",
) -> Shown:  # fmt: skip
    """The volume of frames (H, W), such as those of a sequence browser, and their poses (F, 4, 4).

    Raises ValueError for none, and for frames of several sizes or of colors.
    """
    import globule as gb

    sizes = {np.shape(frame) for frame in frames}
    if len(sizes) != 1:
        raise ValueError(f"sequence: expected images of one size, got {', '.join(map(str, sorted(sizes))) or 'none'}")
    sweep = gb.ultrasound.Sweep(np.stack(frames), np.asarray(ras_from_image, float), times, space="RAS")
    return _shown(gb.ultrasound.reconstruct(sweep, spacing=voxel_size, method=method), sweep)


def _shown(volume: Any, sweep: Any) -> Shown:
    from globule.volumes.volume import origin_of

    volume = volume.in_space("RAS")
    x, y, z = volume.values.shape[::-1]
    text = f"{sweep.n_valid} of {len(sweep)} frames, {x} x {y} x {z} voxels"
    if "left_out_rms" in volume.info:
        rms = volume.info["left_out_rms"]
        text += f"; frames left out are predicted to {rms:.1f} gray levels (rms)"
    return Shown(volume.values, origin_of(volume.radius), volume.world_from_voxel, text)


def slicer_python(home: str) -> str:
    """The program that runs Python with Slicer's packages, in Slicer's home folder.

    Raises FileNotFoundError for another folder.
    """
    for name in ("PythonSlicer", "PythonSlicer.exe"):
        path = os.path.join(home, "bin", name)
        if os.path.isfile(path):
            return path
    raise FileNotFoundError(2, "expected bin/PythonSlicer", home)
