"""Objects of other packages in the place of particles."""

import subprocess
import sys

import globule as gb
import numpy as np
import pytest
from globule._base.colormaps import to_linear
from globule.formats.elements import of_elements

N = 20
POSITIONS = np.random.default_rng(5).random((N, 3))
H = np.full(N, 0.2, np.float32)
pytestmark = pytest.mark.interop


def assert_positions(value: object, expected: np.ndarray = POSITIONS) -> gb.Particles:
    particles = gb.Scene(value, device="cpu", threads=1).particles
    assert np.allclose(particles.positions, expected, atol=1e-5)
    return particles


@pytest.mark.parametrize("kind", ["PolyData", "UnstructuredGrid"])
def test_vtk_and_pyvista(kind):
    pyvista = pytest.importorskip("pyvista")
    cloud = pyvista.PolyData(POSITIONS)
    cloud["h"], cloud["velocity"] = H, POSITIONS
    cloud["rgb"] = np.full((N, 3), 255, np.uint8)
    cloud["name"] = ["a"] * N  # texts are left out
    if kind == "UnstructuredGrid":
        cloud = cloud.cast_to_unstructured_grid()
    particles = assert_positions(cloud)
    assert np.array_equal(particles.support, 2 * H)
    assert np.array_equal(particles.attributes["velocity"], POSITIONS)
    assert np.array_equal(particles.color, np.ones((N, 3)))
    plain = pytest.importorskip("vtk").vtkPolyData()
    assert len(gb.Scene(plain, device="cpu").particles) == 0
    with pytest.raises(TypeError, match="got ImageData") as refused:
        gb.Scene(pyvista.ImageData(dimensions=(2, 2, 2)), device="cpu")
    assert "\n" not in str(refused.value)
    if kind == "PolyData":
        plain.ShallowCopy(cloud)
        assert_positions(plain)


def test_ase():
    particles = assert_positions(pytest.importorskip("ase").Atoms("CH" * (N // 2), positions=POSITIONS))
    assert np.allclose(particles.support[:2], [4 * 1.70, 4 * 1.20])
    assert np.allclose(particles.attributes["mass"][:2], [12.011, 1.008])


def test_the_elements_are_those_of_ase():
    """Numbers, van der Waals radii (Bondi's, else Alvarez') and Jmol's colors of 96 elements."""
    data = pytest.importorskip("ase.data")
    colors = pytest.importorskip("ase.data.colors").jmol_colors
    others = pytest.importorskip("ase.data.vdw_alvarez").vdw_radii
    got = of_elements(data.chemical_symbols[1:97])
    assert got["atomic_number"].tolist() == [*range(1, 97)]
    bondi = data.vdw_radii[1:97]
    expected = np.where(np.isfinite(bondi), bondi, others[1:97])
    known = np.isfinite(expected)
    assert np.allclose(got["radius"][known], expected[known], atol=0.006)
    assert np.isfinite(got["radius"]).all()
    assert np.allclose(got["color"], to_linear(colors[1:97]), atol=0.005)


def test_mdanalysis():
    universe = pytest.importorskip("MDAnalysis").Universe.empty(N, trajectory=True)
    universe.add_TopologyAttr("masses", np.arange(N) + 1.0)
    universe.add_TopologyAttr("elements", ["O"] * N)
    universe.atoms.positions = POSITIONS.astype(np.float32)
    particles = assert_positions(universe)
    assert np.array_equal(particles.attributes["mass"], np.arange(N) + 1.0)
    assert np.allclose(particles.support, 4 * 1.52)
    assert len(gb.Scene(universe.atoms[:7], device="cpu").particles) == 7


def test_pynbody():
    snapshot = pytest.importorskip("pynbody").new(dm=4, gas=N)
    snapshot.gas["pos"], snapshot.gas["smooth"] = POSITIONS, H
    assert np.allclose(assert_positions(snapshot).support, 2 * H)


def test_yt():
    yt = pytest.importorskip("yt")
    yt.set_log_level(50)
    data = {f"particle_position_{a}": POSITIONS[:, k] for k, a in enumerate("xyz")}
    data["particle_mass"] = np.arange(N) + 1.0
    box = np.array([[0.0, 1.0]] * 3)
    loaded = yt.load_particles(data, length_unit=3.0, mass_unit=2.0, bbox=box)
    for value in (loaded, loaded.all_data()):
        particles = gb.Scene(value, device="cpu", threads=1).particles
        mass = particles.attributes["mass"]
        order = np.argsort(mass)
        assert np.allclose(mass[order], np.arange(N) + 1.0)
        assert np.allclose(particles.positions[order], POSITIONS, atol=1e-6)


def test_tables():
    pandas = pytest.importorskip("pandas")
    columns = dict(zip("xyz", POSITIONS.T, strict=True)) | {"h": H, "name": ["a"] * N}
    assert np.array_equal(assert_positions(pandas.DataFrame(columns)).support, 2 * H)
    plane = assert_positions(pandas.DataFrame({"x": POSITIONS[:, 0], "y": POSITIONS[:, 1]}),
                             POSITIONS * [1, 1, 0])  # fmt: skip
    assert len(plane) == N
    with pytest.raises(ValueError, match="DataFrame: expected columns x, y and z, got a"):
        gb.Scene(pandas.DataFrame({"a": [1.0]}))
    texts = pandas.DataFrame(POSITIONS.astype(str), columns=list("xyz"))
    with pytest.raises(ValueError, match=r"got x \(no numbers\), y \(no numbers\), z"):
        gb.Scene(texts)


def test_xarray_and_arrow():
    xarray = pytest.importorskip("xarray")
    data = xarray.Dataset({a: ("n", POSITIONS[:, k]) for k, a in enumerate("xyz")} | {"h": ("n", H)})
    assert np.array_equal(assert_positions(data).support, 2 * H)
    assert_positions(xarray.DataArray(POSITIONS))
    axes = {a: np.arange(3.0) for a in "xyz"}  # of a grid, not three particles
    with pytest.raises(ValueError, match="got the axes of a grid"):
        gb.Scene(xarray.Dataset({"t": (("x", "y", "z"), np.zeros((3, 3, 3)))}, coords=axes))
    arrow = pytest.importorskip("pyarrow")
    assert_positions(arrow.table(dict(zip("xyz", POSITIONS.T, strict=True))))
    lists = arrow.FixedSizeListArray.from_arrays(arrow.array(POSITIONS.ravel()), 3)
    assert_positions(arrow.table({"positions": lists}).slice(2), POSITIONS[2:])


def test_none_of_them_is_imported():
    names = "vtk pyvista ase MDAnalysis yt pynbody pandas xarray h5py pyarrow"
    code = (
        "import sys, numpy as np, globule as gb, globule.formats.objects as o\n"
        "assert o.particles_of(object()) is None\n"
        f"print([n for n in {names.split()!r} if n in sys.modules])"
    )
    got = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert got.stdout.strip() == "[]"
