"""`--frame` and `--species`: files that hold several frames or groups of particles."""

from __future__ import annotations

import numpy as np
import pytest
from cli_helpers import refused, run_json
from globule.cli import main


@pytest.fixture(autouse=True)
def files(folder):
    rows = [f"O {i % 3} {i // 3 % 3} {i // 9}\n" for i in range(27)]
    head = '27\nProperties=species:S:1:pos:R:3 Lattice="9 0 0 0 9 0 0 0 9"\n'
    moved = [f"O {i % 3 + 5} {i // 3 % 3} {i // 9}\n" for i in range(27)]
    (folder / "run.extxyz").write_text(head + "".join(rows) + head + "".join(moved))


def bounds(capsys, *words) -> list:
    return run_json(capsys, "info", *words)["bounds"]["lo"]


def test_frame_of_info_convert_and_render(folder, capsys):
    assert bounds(capsys, "run.extxyz")[0] == 0
    assert bounds(capsys, "run.extxyz", "--frame", "-1")[0] == 5
    assert main(["convert", "run.extxyz", "last.npz", "--frame", "1"]) == 0
    assert np.load("last.npz")["positions"][:, 0].min() == 5
    words = ["render", "run.extxyz", "--size", "32x24", "--device", "cpu", "-o", "a.png"]
    assert main([*words, "--frame", "1"]) == 0
    assert (folder / "a.png").exists()


def test_species_of_hdf5(folder, capsys):
    h5py = pytest.importorskip("h5py")
    with h5py.File("a.hdf5", "w") as file:
        file.create_group("Header").attrs["BoxSize"] = 9.0
        for kind, shift in (("PartType0", 0.0), ("PartType1", 7.0)):
            file[f"{kind}/Coordinates"] = np.random.default_rng(1).random((20, 3)) + shift
    assert bounds(capsys, "a.hdf5")[0] < 1
    assert bounds(capsys, "a.hdf5", "--species", "PartType1")[0] > 6
    error = refused(capsys, "info", "a.hdf5", "--species", "gas")
    assert "species: expected one of PartType0, PartType1" in error


def test_refused_in_one_line(folder, capsys):
    np.save("a.npy", np.random.default_rng(0).random((9, 3)))
    for words, said in (
        (["a.npy", "--frame", "1"], "--frame: expected a file of table, "),
        (["run.extxyz", "--species", "O"], "--species: expected a file of NumPy archive, HDF5"),
        (["run.extxyz", "--frame", "2"], "frame: expected -2 to 1"),
    ):
        assert said in refused(capsys, "info", *words)
