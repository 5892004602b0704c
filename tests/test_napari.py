"""The reader for napari, without napari: what it gives for volumes, sweeps and other files."""

from importlib import util
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.napari import get_reader, sweep_layers, volume_layers
from sweep_helpers import small_sweep


def test_volumes_and_sweeps_are_read_and_other_files_left_to_others(tmp_path):
    values = np.random.default_rng(0).integers(0, 99, (4, 5, 6)).astype(np.uint8)
    turn = np.array([[0, 0, 0.5, 7], [0.25, 0, 0, 8], [0, 2.0, 0, 9], [0, 0, 0, 1]])
    gb.volumes.write_volume(tmp_path / "a.nrrd", gb.volumes.Volume(values, turn))
    (data, about, kind), *_ = get_reader(str(tmp_path / "a.nrrd"))(str(tmp_path / "a.nrrd"))
    assert kind == "image"
    assert np.array_equal(data, values)
    x, y, z = 3, 1, 2
    assert np.allclose((about["affine"] @ [z, y, x, 1])[:3], (turn @ [x, y, z, 1])[:3][::-1])
    assert about["metadata"]["space"] == "LPS"
    # The origin of voxels is a layer of labels.
    radius = np.array([0, 3, 130, 255], np.uint8).reshape(1, 1, 4)
    volume = gb.volumes.Volume(np.ones((1, 1, 4), np.uint8), np.eye(4), radius)
    _, (labels, about, kind) = volume_layers(volume, "v")
    assert (kind, labels.ravel().tolist()) == ("labels", [1, 2, 3, 0])
    assert not about["visible"]
    assert len(volume_layers(gb.volumes.Volume(np.ones((1, 1, 4), np.uint8), np.eye(4)))) == 1
    sweep, path = small_sweep(), str(tmp_path / "a.igs.mha")
    gb.ultrasound.write_sweep(path, sweep)
    (data, about, kind), = get_reader(path)(path)  # fmt: skip
    assert kind == "image"
    assert np.array_equal(data, sweep.frames)
    first = sweep.world_from_image[0]
    expected = (1, np.linalg.norm(first[:3, 1]), np.linalg.norm(first[:3, 0]))
    assert np.allclose(about["scale"], expected, rtol=1e-5)
    assert np.allclose(about["metadata"]["world_from_image"], sweep.world_from_image, atol=1e-5)
    assert sweep_layers(sweep)[0][1]["name"] == "sweep"
    gb.write(tmp_path / "p.ply", gb.Particles(np.eye(3)))
    (tmp_path / "notes.md").write_text("no data")
    for name in ("p.ply", "notes.md", "not there.nii"):
        assert get_reader(str(tmp_path / name)) is None
    assert get_reader([str(tmp_path / "p.ply")]) is None


def test_manifest():
    npe2, folder = pytest.importorskip("npe2"), Path(util.find_spec("globule").origin).parent
    manifest = npe2.PluginManifest.from_file(folder / "napari.yaml")
    (reader,) = manifest.contributions.readers
    (command,) = manifest.contributions.commands
    assert reader.command == command.id
    manifest.validate_imports()
    for name in ("a.nrrd", "a.igs.mha"):
        assert any(Path(name).match(pattern) for pattern in reader.filename_patterns)
