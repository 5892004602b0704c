"""PySPH's .npz: pickled dictionaries, of which only numbers and arrays are taken."""

import io
import os
import pickle
import zipfile

import globule as gb
import numpy as np
import pytest
from globule.formats import FormatError, read_contents

N = 30
RNG = np.random.default_rng(4)
X, V, H = RNG.random((N, 3)), RNG.normal(size=(N, 3)), 0.1 + RNG.random(N)


def group(n: int) -> dict:
    arrays = {name: X[:n, k] for k, name in enumerate("xyz")}
    arrays |= {name: V[:n, k] for k, name in enumerate("uvw")}
    arrays |= {"h": H[:n], "rho": np.full(n, 2.0), "m": np.full(n, 0.5), "au": np.zeros(0)}
    arrays["gid"] = np.arange(n, dtype=np.uint32)
    properties = {name: {"name": name, "type": "double", "default": 0.0} for name in arrays}
    return {"arrays": arrays, "properties": properties, "constants": {"c0": np.array([10.0])},
            "output_property_arrays": ["x", "y", "z"]}  # fmt: skip


def written(path, particles=None, compressed=False):
    save = np.savez_compressed if compressed else np.savez
    particles = {"wall": group(5), "fluid": group(N)} if particles is None else particles
    solver = {"t": 0.5, "dt": np.float64(1e-3), "count": 10}
    save(path, version=2, particles=particles, solver_data=solver)
    return path


@pytest.mark.parametrize("compressed", [False, True])
def test_pysph(tmp_path, compressed):
    path = written(tmp_path / "drop_10.npz", compressed=compressed)
    got = read_contents(path)
    assert (got.time, got.species) == (0.5, ("wall", "fluid"))
    p = got.particles
    assert np.array_equal(p.positions, X.astype(np.float32))
    assert np.allclose(p.support, 2 * H)
    assert np.array_equal(p.attributes["velocity"], V)
    assert np.array_equal(p.attributes["gid"], np.arange(N))
    assert set(p.attributes) == {"velocity", "h", "mass", "density", "gid"}
    assert len(gb.read(path, species="wall")) == 5
    with pytest.raises(ValueError, match=r"species: expected one of wall, fluid for .*, got 'air'"):
        gb.read(path, species="air")


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_every_protocol(tmp_path, protocol):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name, value in (("particles", {"fluid": group(N)}), ("solver_data", {"t": 1.0})):
            file, array = io.BytesIO(), np.empty((), object)
            array[()] = value
            np.lib.format.write_array(file, array, allow_pickle=True)
            header = file.getvalue()[: file.getvalue().index(b"\n") + 1]
            archive.writestr(f"{name}.npy", header + pickle.dumps(array, protocol))
    assert np.array_equal(gb.read(path).positions, X.astype(np.float32))


class Runs:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_nothing_else_is_made(tmp_path):
    ran = tmp_path / "ran"
    for particles in (Runs(ran), {"fluid": Runs(ran)}, {"fluid": {"arrays": {"x": Runs(ran)}}}):
        path = written(tmp_path / "a.npz", particles)
        with pytest.raises(FormatError, match=r"a\.npz: particles: expected .* got .*mkdir"):
            gb.read(path)
    assert not ran.exists()


@pytest.mark.parametrize(("particles", "words"), [
    ({}, "expected groups of arrays"), (np.array([{}, {}], object), "expected a dictionary of arrays"),
    ({"fluid": {"arrays": {"x": np.zeros(3)}}}, "expected arrays x, y and z of one length"),
    ({"fluid": {"arrays": {a: np.zeros((3, 2)) for a in "xyz"}}}, "x, y and z of one length"),
    ({"fluid": {"arrays": {a: np.array([None] * 3) for a in "xyz"}}}, "numbers of type O8"),
])  # fmt: skip
def test_refusals(tmp_path, particles, words):
    with pytest.raises(FormatError, match=words):
        gb.read(written(tmp_path / "a.npz", particles))
