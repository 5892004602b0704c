"""Particles far from the origin or from each other: what is lost is said."""

import warnings

import globule as gb
import numpy as np
import pytest
from cli_helpers import refused, run_json
from globule.cli import main
from globule.data.spacing import normal_of

pytestmark = pytest.mark.usefixtures("folder")
MACHINE = ["--device", "cpu", "--size", "160x120"]


def lattice(n: int = 10, spacing: float = 0.05) -> np.ndarray:
    return np.stack(np.mgrid[:n, :n, :n], -1).reshape(-1, 3) * spacing


def test_far_coordinates_are_said_with_an_origin_that_helps():
    far = lattice() + (450_000, 5_400_000, 100)
    with pytest.warns(UserWarning, match=r"steps of 0\.5, .* 0\.04\d* apart") as said:
        gb.Particles(far)
    origin = str(said[0].message).split("such as ")[1].split(", from")[0]
    near = far - [float(v) for v in origin.split(",")]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gb.Particles(near)
        gb.Particles(far.astype("f4"))  # lost before
        gb.Particles(lattice(10, 1e-30))
        gb.Particles(lattice() + 1000)  # a thousandth of the spacing
        gb.Particles(np.ones((500, 3)))
        gb.Particles(np.full((500, 3), np.nan))
        sheet = lattice()[:, :2] + 50
        gb.Particles(np.c_[sheet, 1e-9 * np.sin(np.arange(len(sheet)))])
    with pytest.warns(UserWarning, match="steps of 64"):
        gb.Particles(lattice() + 1e9)
    with pytest.warns(UserWarning, match=r"steps of 0\.5"):
        gb.Particles(np.r_[far, [[0, 0, 0]]])  # a stray does not hide it


@pytest.mark.parametrize("name", ["a.npz", "a.npy", "a.csv", "a.txt"])
def test_every_reader_says_it(name, capsys):
    far = lattice() + (450_000, 5_400_000, 100)
    if name == "a.npz":
        np.savez(name, positions=far)
    elif name == "a.npy":
        np.save(name, far)
    elif name == "a.csv":
        np.savetxt(name, far, delimiter=",", header="x,y,z", comments="", fmt="%.9g")
    else:
        rows = np.c_[far, np.full((len(far), 3), 0.5), np.zeros((len(far), 3))]
        np.savetxt(name, rows, header=str(len(far)), comments="", fmt="%.9g")
    assert main(["render", name, "-o", "a.png", *MACHINE]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "float32" in line]
    assert len(said) == 1, said
    assert said[0].startswith(f"globule: warning: {name}: positions are given from 4"), said


@pytest.mark.parametrize("away", [30.0, 300.0, 1e4, 1e6])
def test_a_stray_particle_is_named_and_left_out(away, capsys):
    points = np.r_[lattice(8, 0.1), [[away, 0.3, 0.3]]].astype("f4")
    gb.write("a.npz", gb.Particles(points))
    said = run_json(capsys, "render", "a.npz", "-o", "a.png", *MACHINE)
    (message,) = said["warnings"]
    assert f"spread over {away:.4g}" in message
    assert "99.8" in message
    assert "--fit" not in message
    crop = message.split("try ")[1]
    said = run_json(capsys, "render", "a.npz", "-o", "b.png", *MACHINE, crop)
    assert said["counts"]["hits"] > 0.15 * 160 * 120, said["warnings"]


def test_a_cube_with_a_stray_particle_is_not_flat():
    points = np.r_[lattice(8, 0.1), [[1e6, 0.3, 0.3]]]
    assert normal_of(points.astype("f4")) is None
    sheet = points * (1, 1, 0) + (0, 0, 3)
    assert normal_of(sheet.astype("f4")) is not None


def test_info_of_coordinates_that_are_all_too_far(tmp_path, capsys):
    """Beyond 1e18 no position counts: refused with the file's name."""
    file = tmp_path / "far.csv"
    file.write_text("x,y,z\n1e19,0,0\n2e19,0,0\n")
    assert f"{file}: bounds: expected a finite position, got none in 2" in refused(capsys, "info", str(file))


def test_sizes_that_float32_cannot_square_are_refused(capsys):
    for size, expected in ((1e-30, "1e-18 to 1e18 apart"), (1e30, "coordinates up to 1e+18")):
        gb.write("a.npz", gb.Particles(lattice(8, size)))
        said = refused(capsys, "render", "a.npz", "-o", "a.png", "--device", "cpu")
        assert expected in said
        assert "scale the positions" in said
