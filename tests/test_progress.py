"""Long calls say how far they are, and what they make is the same; objects say what they hold."""

import copy
import functools
import os

import globule as gb
import numpy as np
import pytest
from globule.formats import inflate
from globule.formats.volumes import raw
from globule.volumes.volume import Volume


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(raw, "PIECE", 1000)
    monkeypatch.setattr(inflate, "PIECE", 1000)


@functools.cache
def phantom() -> gb.ultrasound.Sweep:
    return gb.ultrasound.phantoms.cylinders(n_frames=40, size=(12, 9), spacing=3.0)


def sweep() -> gb.ultrasound.Sweep:
    return copy.deepcopy(phantom())


def followed(work):
    """What a call returns, and what it reported."""
    calls: list[tuple[int, int]] = []
    return work(lambda *call: calls.append(call)), calls


def heard(calls: list[tuple[int, int]], least: int) -> None:
    done, totals = zip(*calls, strict=True)
    assert len(calls) >= least
    assert (len(set(totals)), list(done), done[-1]) == (1, sorted(done), totals[0])


def written_and_read(write, read, name, made, least):
    for work in (lambda report: write(name, made, progress=report), lambda report: read(name, progress=report)):
        result, calls = followed(work)
        heard(calls, least)
    return result


@pytest.mark.parametrize(("name", "least"), [("a.igs.mha", 4), ("a.igs.nrrd", 4), ("a.npz", 1), ("frames", 40)])
def test_sweep_files(name, least):
    result = written_and_read(gb.ultrasound.write_sweep, gb.ultrasound.read_sweep, name, sweep(), least)
    assert np.array_equal(result.frames, sweep().frames)


@pytest.mark.parametrize(("name", "least"), [("a.mha", 8), ("a.nrrd", 8), ("a.nii.gz", 1), ("a.vti", 1), ("a.npz", 1)])
def test_volume_files(name, least):
    volume = Volume(np.arange(20 * 21 * 20, dtype=np.uint16).reshape(20, 21, 20), np.eye(4))
    result = written_and_read(gb.volumes.write_volume, gb.volumes.read_volume, name, volume, least)
    assert np.array_equal(result.values, volume.values)


@pytest.mark.parametrize("compounding", ["mean", "maximum", "latest", "first", "median"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_reconstruction(compounding, dtype):
    """In pieces it has the bits that it has at once, maps included."""
    made = sweep()
    made.frames = made.frames.astype(dtype)
    options = {"spacing": 4.0, "compounding": compounding, "device": "cpu"}
    found, calls = followed(lambda report: gb.ultrasound.reconstruct(made, **options, progress=report))
    heard(calls, 1 if compounding == "median" else 20)
    expected = gb.ultrasound.reconstruct(made, **options)
    assert np.array_equal(found.values, expected.values)
    assert np.array_equal(found.radius, expected.radius)


def test_stopped_from_progress_and_what_objects_hold():

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gb.ultrasound.reconstruct(sweep(), spacing=4.0, device="cpu", progress=stop)
    for name in ("a.igs.mha", "frames"):
        with pytest.raises(KeyboardInterrupt):
            gb.ultrasound.write_sweep(name, sweep(), progress=stop)
    assert os.listdir() == []
    volume = Volume(np.zeros((3, 4, 5), np.uint16), np.diag([0.5, 0.5, 2, 1]), space="RAS")
    assert repr(volume) == "Volume(5 x 4 x 3 uint16, 0.5 x 0.5 x 2 mm, RAS, 60 measured, 0 filled, 0 empty)"
    made, live = sweep(), gb.ultrasound.Reconstructor(4.0, device="cpu")
    assert repr(made) == "Sweep(40 frames, 12 x 9 uint8, 3 x 3 mm, 40 valid, Reference, LPS)"
    made.valid[:] = False
    assert "no spacing, 0 valid" in repr(made)
    assert repr(live).startswith("Reconstructor(no frames yet, 4 mm, LPS, cpu")
