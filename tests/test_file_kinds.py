"""Files as programs of many origins write them: counts, bounds, volume, frames, box and units."""

from __future__ import annotations

import warnings

import globule as gb
import numpy as np
import pytest
from file_kinds import KINDS, Kind
from globule.formats import read_contents
from globule.formats.frames import FrameOf
from globule.measure.track import facts
from globule.pieces.shown import shown_scene


@pytest.fixture(params=KINDS, ids=[kind.name for kind in KINDS])
def kind(request, tmp_path, monkeypatch) -> Kind:
    """A kind whose file is in the folder where the test runs."""
    if request.param.package:
        pytest.importorskip(request.param.package)
    monkeypatch.chdir(tmp_path)
    request.param.make(tmp_path / request.param.file)
    return request.param


def test_what_is_read(kind):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        contents = read_contents(kind.file)
    particles = contents.particles
    assert len(particles) == kind.n
    assert np.allclose(particles.bounds(), (kind.places.min(0), kind.places.max(0)), atol=2e-3)
    assert contents.n_frames == kind.frames
    assert contents.units.get("positions", "") == kind.unit
    box = contents.box
    assert (box and "".join(np.array([*"xyz"])[list(box.periodic)])) == kind.periodic
    assert {*kind.names} <= {*particles.attributes}
    if kind.frames > 1:
        second = gb.read(FrameOf(kind.file, 1))
        assert np.allclose(second.bounds()[0] - particles.bounds()[0], (1, 0, 0), atol=2e-3)
    if kind.volume is not None:
        scene = shown_scene(particles, device="cpu")
        volume = facts(scene, gb.measure.mesh_surface(scene))["volume"]
        assert volume == pytest.approx(kind.volume, rel=0.03)


def test_there_are_enough():
    assert len(KINDS) >= 60
    assert len({kind.name for kind in KINDS}) == len(KINDS)
