"""A volume's iso-surface through metaballs lies where the volume says."""

from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.cli import main
from globule.volumes.iso_surface import extract_iso_surface
from globule.volumes.volume import Volume
from PIL import Image


def ball(spacing=(0.5, 0.5, 0.5), radius: float = 6.0, slope: float = 12.0) -> Volume:
    """Values that fall linearly through 100 at `radius` mm around (3, -2, 10)."""
    place, n = np.diag([*spacing, 1.0]), [int(20 / s) for s in spacing]
    place[:3, 3] = np.array([3, -2, 10]) - np.array(spacing) * (np.array(n) - 1) / 2
    z, y, x = np.meshgrid(*(np.arange(k) for k in n[::-1]), indexing="ij")
    world = np.stack([x, y, z], axis=-1) * spacing + place[:3, 3]
    distance = np.linalg.norm(world - [3, -2, 10], axis=-1)
    return Volume(np.clip(100 + slope * (radius - distance), 0, 255).astype(np.float32), place)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["murakami", "wyvill", "cubic_spline"])
def test_the_surface_lies_at_the_level(kernel):
    for level, radius, spacing in ((100.0, 6.0, (0.5, 0.5, 0.5)), (130.0, 3.5, (0.3, 0.5, 0.6))):
        surface = extract_iso_surface(ball(spacing), level, kernel)
        scene = gb.Scene(surface.particles, kernel, surface.threshold, device="cpu")
        frame = gb.render(scene, gb.Camera((3, -2, 60), (3, -2, 10), height=20), (80, 80))
        distance = np.linalg.norm(frame.position[frame.mask] - [3, -2, 10], axis=1)
        assert np.median(distance) == pytest.approx(radius, abs=0.12)
        assert np.abs(distance - radius).max() < 0.4


@pytest.mark.parametrize(("kernel", "most"), [("murakami", 16), ("wyvill", 10), ("nishimura", 4), ("cubic_spline", 2)])
def test_the_lattice_hardly_shows(kernel, most):
    """Normals where values change by 6 % of the level a voxel: degrees, root mean square."""
    surface = extract_iso_surface(ball(), 100.0, kernel)
    scene = gb.Scene(surface.particles, kernel, surface.threshold, device="cpu")
    frame = gb.render(scene, gb.Camera((30, -40, 60), (3, -2, 10), height=14), (90, 90))
    outward = frame.position[frame.mask] - [3, -2, 10]
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    cosine = np.einsum("ij,ij->i", frame.normal[frame.mask], outward)
    assert np.sqrt(np.square(np.degrees(np.arccos(np.minimum(cosine, 1)))).mean()) < most


def test_what_has_no_surface_is_refused():
    shifted = ball()
    shifted.values -= 500
    nothing = Volume(np.zeros((3, 3, 3), np.uint8), np.eye(4))
    for what, said in (
        ((ball(), 300.0), "level"), ((nothing,), "level"), ((shifted, -500.5), "level"),
        ((ball(), 10.0, "magic"), "kernel"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=said):
            extract_iso_surface(*what)


def test_render_of_other_volumes(folder, capsys):
    """VTK files, sparse ones, several at once; tomographies where labels are asked for."""
    for name in ("a.vti", "b.sparse.npz", "c.mha"):
        gb.volumes.write_volume(name, ball())
    machine = ["--size", "60x50", "--device", "cpu"]
    words = ["render", "a.vti", "b.sparse.npz", "c.mha", "-o", "{}.png", *machine]
    assert main(["render", "a.vti", "-o", "a.png", *machine]) == 0
    assert "surface at" in capsys.readouterr().err
    for wrong in (["--threshold", "1"], ["--level", "999"]):
        assert main(["render", "a.vti", "-o", "n.png", *machine, *wrong]) == 2
    assert capsys.readouterr().err.count("globule: error") == 2
    assert (main([*words, "--level", "100"]), capsys.readouterr().err) == (0, "")
    assert np.array_equal(*[np.asarray(Image.open(f"{name}.png")) for name in "abc" if name != "b"])
    assert main([*words, "--support", "1"]) == 2
    assert capsys.readouterr().err.count("globule: error: --support") == 1
    assert main(["render", "nowhere.vti", "-o", "n.png", *machine]) == 2
    gb.ultrasound.write_sweep("sweep.igs.mha", gb.ultrasound.phantoms.cylinders(n_frames=4, size=(9, 8), spacing=4.0))
    capsys.readouterr()
    assert main(["render", "sweep.igs.mha", "-o", "n.png", *machine]) == 2
    assert "got a sweep" in capsys.readouterr().err
    Path("d.vti").write_bytes(Path("a.vti").read_bytes()[:600])
    assert main(["render", "d.vti", "-o", "n.png", *machine]) == 2
    assert not Path("n.png").exists()


@pytest.mark.parametrize("edge", [1e30, 1e-30, np.nan, 0.0, 6.0])
def test_voxels_of_any_shape(edge):
    volume = ball()
    volume.world_from_voxel[2, 2] = edge
    if edge == 6.0:
        assert len(extract_iso_surface(volume).particles)
        return
    with pytest.raises(ValueError, match="spacing: expected edges within"):
        extract_iso_surface(volume)
