"""Particles with radii: spheres of that size, unless they overlap as a fluid's."""

import json
import time
import warnings

import globule as gb
import numpy as np
import pytest
from cli_helpers import run_json
from globule.cli import main
from globule.data.radii import find_radii
from globule.fluids.likeness import are_spheres
from globule.measure.mesh import measured
from globule.measure.spheres import sampled_union, union_of_spheres
from globule.measure.track import track_surface
from globule.scene.capsules import Spheres

SMALL = ("--size", "64x48", "--device", "cpu")


def grains(n: int, low: float, high: float, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Spheres of random radii at random places, none in another: the largest come first."""
    rng = np.random.default_rng(seed)
    radii = np.sort(rng.uniform(low, high, n))[::-1]
    places: list[np.ndarray] = []
    while len(places) < n:
        p, held = rng.random(3), np.array(places).reshape(-1, 3)
        apart = np.linalg.norm(held - p, axis=1)
        if (apart >= radii[: len(held)] + radii[len(held)]).all():
            places.append(p)
    return np.array(places), radii


def volume_of(radii: np.ndarray) -> float:
    return float(4 / 3 * np.pi * np.sum(radii**3))


def csv(path, places, radii, name="radius"):
    rows = (",".join(f"{v:.9g}" for v in (*p, r)) for p, r in zip(places, radii, strict=True))
    path.write_text("\n".join([f"x,y,z,{name}", *rows, ""]))
    return str(path)


def silhouette(scene, center, height) -> tuple[float, float]:
    """The least and the largest x of what a camera along z sees, to a pixel of height / 200."""
    camera = gb.Camera((*center[:2], 9.0), center, height=height)
    xs = np.flatnonzero(gb.render(scene, camera, (200, 200), {"samples": 1}).mask.any(axis=0))
    return center[0] + height * (xs[0] / 200 - 0.5), center[0] + height * ((xs[-1] + 1) / 200 - 0.5)


@pytest.mark.parametrize(("low", "high"), [(0.03, 0.03), (0.01, 0.06)])
def test_volume_and_area_of_random_spheres(folder, capsys, low, high):
    places, radii = grains(300, low, high)
    csv(folder / "grains.csv", places, radii)
    assert main(["track", "grains.csv", "--sample-spacing", "0.05", "--json"]) == 0
    out = capsys.readouterr()
    assert "note: the particles are spheres of the file's radii" in out.err
    report = json.loads(out.out)
    assert report["area"][0] == pytest.approx(4 * np.pi * np.sum(radii**2), rel=1e-5)
    assert report["volume"][0] == pytest.approx(volume_of(radii), rel=1e-5)
    assert report["x_max"][0] == pytest.approx((places[:, 0] + radii).max(), rel=1e-5)
    assert report["z_min"][0] == pytest.approx((places[:, 2] - radii).min(), rel=1e-4, abs=1e-6)


def test_few_spheres_are_drawn_in_their_size_also_from_diameters(folder, capsys):
    places, radii = np.array([[0, 0, 0], [0.7, 0, 0], [0.95, 0, 0]]), np.array([0.5, 0.2, 0.05])
    dump = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n3\nITEM: BOX BOUNDS ff ff ff\n-1 2\n-1 1\n-1 1\n"
    rows = "\n".join(f"{i} 1 {words(p)} {r}" for i, (p, r) in enumerate(zip(places, radii, strict=True)))
    (folder / "d.dump").write_text(f"{dump}ITEM: ATOMS id type x y z radius\n{rows}\n")
    for scene in ("d.dump", gb.Scene("d.dump", surface="spheres")):
        assert silhouette(scene, (0.25, 0, 0), 1.6) == pytest.approx((-0.5, 1), abs=0.009)
    assert gb.fluids.choose_surface(gb.read("d.dump")) == "spheres"
    csv(folder / "d.csv", places, 2 * radii, "Diameter")
    assert silhouette("d.csv", (0.25, 0, 0), 1.6) == pytest.approx((-0.5, 1), abs=0.009)
    given = gb.Scene("d.dump", surface="spheres", spacing=0.2)  # asked for: half a spacing
    assert silhouette(given, (0, 0, 0), 0.4) == pytest.approx((-0.1, 0.1), abs=0.003)
    places, radii = grains(120, 0.03, 0.06)
    csv(folder / "a.csv", places, radii)
    csv(folder / "b.csv", places, 2 * radii)
    halved = gb.read("b.csv", radius_is="diameter")
    np.testing.assert_allclose(find_radii(halved), radii, rtol=1e-6)
    np.testing.assert_allclose(halved.support, 4 * radii, rtol=1e-6)
    report = run_json(capsys, "track", "b.csv", "--radius-is", "diameter")
    assert report["volume"][0] == pytest.approx(volume_of(radii), rel=1e-5)
    with pytest.raises(ValueError, match="radius_is: expected radius or diameter, got 'width'"):
        gb.read("b.csv", radius_is="width")


def words(values) -> str:
    return " ".join(f"{v:g}" for v in values)


def test_a_packing_is_not_a_fluid_and_spheres_beside_have_their_radii(folder, capsys, monkeypatch):
    g = np.stack(np.meshgrid(*[np.arange(6.0)] * 3), -1).reshape(-1, 3)
    for radius in (0.5, 0.52):
        csv(folder / "p.csv", g, np.full(len(g), radius))
        assert run_json(capsys, "info", "p.csv")["surface"] == "spheres"
        lens = np.pi * (2 * radius - 1) ** 2 * (1 + 4 * radius) / 12
        expected = 216 * volume_of(np.array([radius])) - 3 * 6 * 6 * 5 * lens
        assert gb.measure.measure_surface("p.csv").volume == pytest.approx(expected, rel=1e-6)
    csv(folder / "f.csv", g, np.full(len(g), 0.6))  # a fluid's particles overlap
    assert run_json(capsys, "info", "f.csv")["surface"] == "smooth"
    assert not are_spheres(gb.read("f.csv"))
    assert not are_spheres(gb.Particles(g))
    assert find_radii(gb.Particles(g, attributes={"radius": -np.arange(len(g))})) is None
    # Nor are atoms, though bonds overlap.
    water = np.array([[0, 0, 0], [0.96, 0, 0], [-0.24, 0.93, 0]])
    radius = np.array([1.52, 1.2, 1.2])
    atoms = gb.Particles(water, attributes={"radius": radius, "atomic_number": np.array([8, 1, 1])})
    assert are_spheres(atoms)
    assert not are_spheres(gb.Particles(0.5 * water, attributes=atoms.attributes))
    del atoms.attributes["atomic_number"]
    assert not are_spheres(atoms)
    from globule.cli import meshes

    made = []
    monkeypatch.setattr(meshes, "Spheres", lambda *a, **k: made.append(a) or Spheres(*a, **k))
    places, radii = grains(20, 0.02, 0.1)
    csv(folder / "g.csv", places, radii)
    gb.write("fluid.npz", gb.Particles(places))
    words = ("render", "fluid.npz", "-o", "a.png", *SMALL)
    run_json(capsys, *words, "--spheres", "g.csv")
    np.testing.assert_allclose(made[0][1], radii, rtol=1e-6)
    run_json(capsys, *words, "--spheres", "g.csv", "--radius-is", "diameter")
    np.testing.assert_allclose(made[1][1], radii / 2, rtol=1e-6)
    run_json(capsys, *words, "--spheres", "g.csv:0.3")
    assert made[2][1] == 0.3


def test_union_of_two_spheres_and_more():
    """Two that meet, one inside another, three with a common point."""
    x, r = np.array([[0, 0, 0], [1, 0, 0], [0.1, 0, 0]]), np.array([1, 1, 0.2])
    expected = (8 / 3 * np.pi - 5 * np.pi / 12, 8 * np.pi - 2 * np.pi)
    assert union_of_spheres(x[:2], r[:2]) == pytest.approx(expected)
    assert union_of_spheres(x, r) == pytest.approx(expected)
    assert union_of_spheres(x + [[0, 0, 0], [0, 0, 0], [0.4, 0.5, 0]], r * [1, 1, 4]) is None
    assert union_of_spheres(x[:0], r[:0]) == (0, 0)


def test_spheres_of_radius_0_are_taken_out(folder, capsys):
    """As grains that a run has removed: they are not seen, and the others stay spheres."""
    places = np.stack(np.mgrid[:4, :3, :2], -1).reshape(-1, 3) * 1.0
    radii = np.where(np.arange(24) % 4, 0, 0.4)
    gb.write("a.vtp", gb.Particles(places, attributes={"radius": radii}))
    found = gb.measure.measure_surface(gb.read("a.vtp"))
    assert found.volume == pytest.approx(6 * 4 / 3 * np.pi * 0.4**3, rel=1e-5)
    assert main(["render", "a.vtp", "-o", "a.png", "--size", "40x30", "--spheres", "a.vtp"]) == 0
    assert "warning" not in capsys.readouterr().err
    assert find_radii(gb.Particles(places, attributes={"radius": 0 * radii})) is None


def test_names_of_programs_for_sizes(folder):
    """MFIX, PFC, Rocky, EDEM, Yade, OpenFOAM, LIGGGHTS; short words where their values may be sizes."""
    g = np.stack(np.mgrid[:3, :3, :3], -1).reshape(-1, 3) * 1.0
    size = 0.3 + 0.001 * np.arange(27)

    def radii(name: str, values: np.ndarray = size, more: str = "", x: np.ndarray = g) -> np.ndarray | None:
        cells = np.column_stack([x, values, *[values] * bool(more)])
        np.savetxt("a.csv", cells, "%.6f", ",", header=f"x,y,z,{name}{more}", comments="")
        return find_radii(gb.read("a.csv"))

    for name in ("Radius", "ball_radius", "Rad", "rad", "R", "r", "r_p", "particle_rad", "Equivalent Radius"):
        np.testing.assert_allclose(radii(name), size, rtol=1e-6)
    for name in ("Diameter", "d_p", "Dp", "D_p", "particle_diameter", "Equivalent Diameter [m]", "diam"):
        np.testing.assert_allclose(radii(name), size / 2, rtol=1e-6)
    assert radii("r", np.linalg.norm(g, axis=1)) is None  # the distance from the middle
    assert radii("R", 287.0 + size) is None  # the gas constant
    assert radii("r", -size) is None
    assert radii("r", more=",phi") is None
    assert radii("dp", more=",h") is None
    np.testing.assert_allclose(radii("rad", more=",Radius"), size, rtol=1e-6)
    text = (folder / "a.csv").read_text().replace("rad,Radius", "d,origProcId")
    (folder / "a.csv").write_text(text)
    scaled = gb.read("a.csv", scale=2)
    np.testing.assert_allclose(scaled.attributes["d"], 2 * size, rtol=1e-6)
    np.testing.assert_allclose(scaled.support, 4 * size, rtol=1e-6)


def test_union_of_any_spheres_by_points():
    """Against closed forms, the mesh of three that meet, and scattered disks in a plane."""
    g = np.stack(np.mgrid[:6, :6, :6], -1).reshape(-1, 3) * 1.0
    for centers, radii in ((g, np.full(len(g), 0.55)), (np.zeros((5, 3)), np.ones(5)), (g[:2], np.array([0.7, 0.4]))):
        volume, wide, area, off = sampled_union(centers, radii)
        exact = union_of_spheres(centers, radii)
        assert abs(volume - exact[0]) <= 2 * wide + 1e-9
        assert abs(area - exact[1]) <= 2 * off + 1e-9
        assert wide < 3e-4 * volume
    three = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0.8, 0]])
    scene = gb.Scene(gb.Particles(three, attributes={"radius": np.full(3, 0.7)}), surface="spheres", device="cpu")
    found = gb.measure.measure_surface(scene)
    by_mesh = measured(scene, gb.measure.mesh_surface(scene, 0.02))
    assert found.volume == pytest.approx(by_mesh.volume, rel=1e-3)
    assert found.area == pytest.approx(by_mesh.area, rel=1e-2)  # the mesh rounds the creases
    places = np.random.default_rng(0).random((10_000, 3)) * (1, 1, 0)
    start = time.process_time()
    volume, wide, _, _ = sampled_union(places, np.full(10_000, 0.005))
    assert time.process_time() - start < 5
    assert abs(volume - 0.00391322) < 3 * wide  # with 60 million points


@pytest.mark.parametrize("bad", ["", "nan", "-0.5", "inf"])
@pytest.mark.parametrize(("name", "factor"), [("radius", 1), ("diameter", 2)])
def test_only_a_particle_without_a_radius_is_left_out(folder, capsys, bad, name, factor):
    places, radii = grains(60, 0.03, 0.03)
    lines = (folder / csv(folder / "grains.csv", places, factor * radii, name)).read_text().split("\n")
    lines[11] = ",".join([*lines[11].split(",")[:3], bad])
    (folder / "grains.csv").write_text("\n".join(lines))
    (folder / "first.csv").write_text(f"x,y,z,{name}\n")
    with pytest.warns(UserWarning, match="1 of 60 particles has no radius, or a negative one: left out"):
        particles = gb.read("grains.csv")
    assert list(np.flatnonzero(find_radii(particles) == 0)) == [10]
    assert find_radii(particles)[11] == pytest.approx(0.03)
    assert track_surface([particles])["volume"][0] == pytest.approx(volume_of(radii[1:]), rel=1e-5)
    for files in ["grains.csv"], ["first.csv", "grains.csv"]:
        assert main(["track", *files, "--json"]) == 0
        out = capsys.readouterr()
        assert out.err.count("has no radius") == 1
        assert json.loads(out.out)["volume"][-1] == pytest.approx(volume_of(radii[1:]), rel=1e-5)


def test_radii_in_another_unit_are_said(folder):
    places, radii = grains(60, 0.03, 0.03)
    csv(folder / "grains.csv", places, 1000 * radii, "radius_mm")
    with pytest.warns(UserWarning, match="radii of 30, but all particles lie within .*: in another unit?"):
        gb.read("grains.csv")
    csv(folder / "grains.csv", places, radii)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gb.read("grains.csv")


@pytest.mark.parametrize("where", [[], ["--where", "radius > 1"]])
def test_no_particles_with_radii_are_a_row_of_zeros(folder, capsys, where):
    csv(folder / "grains.csv", *(grains(8, 0.03, 0.03) if where else ([], [])))
    assert main(["track", "grains.csv", "--json", *where]) == 0
    out = capsys.readouterr()
    table = json.loads(out.out)
    assert [table[name] for name in ("particles", "volume", "area", "particle_volume")] == [[0]] * 4
    assert ("no particle meets" if where else "holds no particles") in out.err
    assert main(["gauge", "grains.csv", "--at", "0,0", *where]) == 0
