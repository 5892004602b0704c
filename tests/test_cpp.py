"""The C++ interface: built outside of the tree against the installed package, equal to Python's."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import globule as gb
import launcher
import numpy as np
import pytest
from docs_blocks import blocks
from globule._base.device import choose
from globule.render.fit import fit_camera
from globule.scene.scene import KERNELS
from waiting import PATIENCE

BROWSERS = True  # conftest.py: what these tests wait for has a limit of its own
ROOT = Path(__file__).resolve().parents[1]
DRAWN = (160, 120)
PATH = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # cmake or MPI's compiler may be a package's
CMAKE, CTEST = shutil.which("cmake", path=PATH), shutil.which("ctest", path=PATH)


def run(*command, **options):
    return subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=PATIENCE, **options)


@pytest.fixture(scope="module")
def built(tmp_path_factory, pytestconfig):
    """Tests and examples, configured once; each test builds what it needs."""
    if CMAKE is None:
        pytest.skip("cmake is missing: sudo apt-get install cmake")
    if shutil.which(os.environ.get("CXX", "g++")) is None and shutil.which("c++") is None:
        pytest.skip("a C++ compiler is missing: sudo apt-get install g++")
    try:
        config = gb.cmake_dir()
    except FileNotFoundError as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.mktemp("cpp")
    project = "cmake_minimum_required(VERSION 3.22)\nproject(all CXX)\n"
    for name in ("tests", "examples", "integrations"):
        project += f'add_subdirectory("{ROOT / name / "cpp"}" {name})\n'
    (folder / "CMakeLists.txt").write_text(project)
    ninja = ["-G", "Ninja"] if shutil.which("ninja") else []
    # To look for MPI and CUDA takes most of the time; only slow tests need them.
    every = pytestconfig.getoption("--matrix")
    without = ["-DCMAKE_DISABLE_FIND_PACKAGE_MPI=ON", "-DCMAKE_CUDA_COMPILER=NOTFOUND"]
    options = [*ninja, f"-Dglobule_DIR={config}", *([] if every else without)]
    done = run(CMAKE, "-S", folder, "-B", folder / "build", *options, env={**os.environ, "PATH": PATH})
    if done.returncode != 0 and "CMAKE_MAKE_PROGRAM" in done.stderr:
        pytest.skip("neither ninja nor make is there: sudo apt-get install make")
    assert done.returncode == 0, done.stderr
    build(folder / "build", "make_images", "load_and_draw")
    return folder / "build"


def build(folder, *names):
    done = run(CMAKE, "--build", folder, "--parallel", os.cpu_count() or 1, "--target", *names)
    assert done.returncode == 0, done.stdout + done.stderr


def targets(folder) -> str:
    """What can be built."""
    return run(CMAKE, "--build", folder, "--target", "help").stdout


@pytest.fixture(scope="module")
def made(built, tmp_path_factory):
    """What make_images writes, and what it was given."""
    folder = tmp_path_factory.mktemp("made")
    rng = np.random.default_rng(7)
    grid = np.stack(np.meshgrid(*[np.arange(9)] * 3, indexing="ij"), -1).reshape(-1, 3)
    positions = (0.125 * grid + 0.03 * rng.random((len(grid), 3))).astype(np.float32)
    frames = rng.integers(0, 256, (24, 40, 48), np.uint8)
    positions.tofile(folder / "positions")
    frames.tofile(folder / "sweep")
    done = run(built / "tests" / "make_images", folder / "positions", folder / "sweep", folder)
    assert done.returncode == 0, done.stderr
    return folder, positions, frames


def same(folder, name, array):
    """Whether a file's bytes are an array's."""
    found = np.frombuffer((folder / name).read_bytes(), array.dtype)
    assert found.size == array.size, name
    different = np.count_nonzero(found != np.ravel(array))
    assert found.tobytes() == np.ravel(array).tobytes(), f"{name}: {different} differ"


def test_folders():
    assert Path(gb.include_dir(), "globule", "globule.hpp").is_file()
    assert Path(gb.cmake_dir(), "globuleConfig.cmake").is_file()
    for file in Path(gb.cmake_dir()).iterdir():  # the package can be moved
        assert str(ROOT) not in file.read_text(), file
        assert "/tmp" not in file.read_text(), file


def test_one_version():
    header = (ROOT / "include/globule/version.hpp").read_text()
    version = ".".join(re.findall(r"VERSION_(?:MAJOR|MINOR|PATCH) (\d+)", header))
    assert gb.__version__ == version
    assert re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.M)[1] == version
    installed = Path(gb.cmake_dir(), "globuleConfigVersion.cmake").read_text(encoding="utf-8")
    assert re.search(r'PACKAGE_VERSION "(.+)"', installed)[1] == version


@pytest.mark.parametrize("name", ["loop_tests", pytest.param("cpp_tests", marks=pytest.mark.slow)])
def test_doctest(built, name):
    if name not in targets(built):
        pytest.skip("doctest.h is missing: sudo apt-get install doctest-dev")
    build(built, name)
    env = {**os.environ, "OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "400"}
    every = (CTEST, "--test-dir", built / "tests", "--output-on-failure", "--no-tests=error")
    done = run(*(every if name == "cpp_tests" else [built / "tests" / name]), env=env)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_a_program_takes_globule_in_by_fetch_content(built, tmp_path):
    """The page's recipe, without Python and the network; test_docs_code.py runs the one for an installed globule."""
    page = blocks(ROOT / "docs/how-to/cpp-cmake-program.md")
    script = "".join(b.code for b in page if b.reason or "> drops.cpp" in b.code)
    env = {**os.environ, "PATH": PATH, "GLOBULE_SOURCE": str(ROOT)}
    command = ["bash", "-euo", "pipefail", "-c", script]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert "drops.ppm: " in done.stdout
    assert ppm(tmp_path / "drops.ppm").std() > 5
    assert "nanobind" not in (tmp_path / "build/CMakeCache.txt").read_text(encoding="utf-8")


def test_default_images(made):
    folder, positions, _ = made
    for i, kernel in enumerate(KERNELS):
        scene = gb.Scene(positions, kernel=kernel, key_bits=64 if i % 2 else 32, device="cpu")
        frame = gb.render(scene, size=DRAWN)
        same(folder, f"kernel_{kernel}", frame.picture)
        same(folder, f"depth_{kernel}", frame.distance)


def test_rich_images(made):
    folder, p, _ = made
    i = np.arange(len(p))
    color = ((i[:, None] + 7 * np.arange(3)) % 32 / 32).astype(np.float32)
    support = np.float32(0.2) + np.float32(0.0625) * (i % 3).astype(np.float32)
    weight = np.where(i % 5, 1.0, 0.5).astype(np.float32)
    particles = gb.Particles(p, support, weight, color, reflection=0.25, refraction=0.5)
    scene = gb.Scene(particles, octree="dense", device="cpu")
    flat = fit_camera(scene, DRAWN, direction=(-1, 0.5, 0.25), up=(0, 0, 1), orthographic=True)
    cut = [gb.ClipPlane((1, 0.5, 0), 0.5)]
    same(folder, "orthographic", gb.render(scene, flat, DRAWN, clips=cut).picture)

    rich = gb.RenderSettings(
        lights=(
            gb.DirectionalLight((1, 2, 0.5), angle=2),
            gb.PointLight((2, 3, 4), radius=0.25),
        ),
        ambient="sky", sky=gb.Sky(), ground=gb.Ground(-0.25, check=0.5, reflection=0.25),
        shadows=True, ambient_rays=3, samples=2,
    )  # fmt: skip
    camera = gb.Camera.fit(p, size=DRAWN)
    clips = [
        gb.ClipSphere((0.5, 0.5, 0.5), 0.25), gb.ClipBox((-9, -9, -9), (9, 9, 0.75), keep=True)
    ]  # fmt: skip
    frame = gb.render(scene, camera, DRAWN, rich, clips)
    same(folder, "rich", frame.picture)
    same(folder, "rich_normal", frame.normal)
    same(folder, "rich_refined", frame.refine(2).picture)

    image = (np.arange(8 * 16 * 3) % 11 / 8).astype(np.float32).reshape(8, 16, 3)
    mirror = gb.RenderSettings(
        sky=gb.Environment(image, strength=0.75, turn=30),
        material=gb.Material(reflection=0.5, color=(0.25, 0.5, 0.75), specular=0.5),
    )
    other = gb.Particles(p + np.float32(0.3), color=(0.75, 0.25, 0.125))
    glass = gb.Material(transmission=0.75, index=1.25, absorption=(1, 2, 3))
    layers = [
        gb.Layer(scene, clips=[gb.ClipPlane((0, 1, 0), 0.5)]),
        gb.Layer(gb.Scene(other, support=0.25, device="cpu"), glass),
    ]
    same(folder, "layers", gb.render(layers, camera, DRAWN, mirror).picture)


def test_simulation(made):
    folder, _, _ = made
    sim = gb.Simulation(
        {
            "spacing": 0.05,
            "gravity": (0, -9.81, 0),
            "domain": {"lo": (0, 0, 0), "hi": (1, 0.75, 0.5), "periodic": ["z"]},
            "fluids": [
                {"name": "water", "viscosity": 0.5, "color": (0.28, 0.52, 0.80)},
                {"name": "oil", "viscosity": 0, "density": 800.0, "color": (0.75, 0.5, 0.25)},
            ],
            "boundaries": [{"name": "walls"}],
        },
        device="cpu",
    )
    # The C++ interface has its own walls, half a spacing outside of the domain.
    index = np.stack(np.meshgrid(range(22), range(17), range(10), indexing="ij"), -1).reshape(-1, 3)
    outside = ((index[:, :2] == 0) | (index[:, :2] == (21, 16))).any(1)
    sim.add((index[outside] - (1, 1, 0) + 0.5) * (1 / 20, 0.75 / 15, 0.5 / 10), "walls")
    index = np.stack(np.meshgrid(*map(np.arange, (6, 10, 10)), indexing="ij"), -1).reshape(-1, 3)
    places = (index.astype(np.float32) + np.float32(0.5)) * np.float32(0.05)
    below = index[:, 1] < 6
    sim.add(places[below], "water")
    sim.add(places[~below], "oil", (0.5, 0.0, 0.0))
    for _ in range(5):
        sim.step()
    sim.run(0.05)
    same(folder, "sim_ids", sim.ids)
    same(folder, "sim_positions", sim.positions)
    same(folder, "sim_velocities", sim.velocities)
    camera = gb.Camera((0.5, 0.5, 2.5), (0.5, 0.25, 0.25))
    same(folder, "sim_image", gb.render(sim.scene, camera, DRAWN).picture)


def pose(f):
    tilt = 0.015625 * f
    return np.array([[0.5, 0, 0, 1], [0, 0.5, 0, 2], [tilt, 0.03125, 1, 0.75 * f], [0, 0, 0, 1]])


def same_volume(folder, name, volume):
    values = volume.values.ravel().view(np.uint8)
    same(folder, name, np.concatenate([values, volume.radius.ravel()]))
    same(folder, f"{name}.matrix", volume.world_from_voxel)


def test_volumes(made):
    folder, _, frames = made
    poses = np.stack([pose(f) for f in range(len(frames))])
    poses[5, 0, 3] = np.nan
    mask = np.ones((40, 48), bool)
    mask[[0, 3]] = False
    sweep = gb.ultrasound.Sweep(frames, poses, mask=mask)
    for method in ("pvn-om", "vvn-om", "pvn", "vvn", "bezier", "frames"):
        volume = gb.ultrasound.reconstruct(sweep, method, 0.7, device="cpu")
        same_volume(folder, f"volume_{method}", volume)
    for compounding in ("mean", "maximum", "latest", "first", "median"):
        volume = gb.ultrasound.reconstruct(
            sweep, "pvn-om", size=31, max_kernel=5, compounding=compounding, max_distance=1.5,
            device="cpu",
        )  # fmt: skip
        same_volume(folder, f"compound_{compounding}", volume)
    floats = frames.astype(np.float32) * np.float32(0.37) - np.float32(5)
    box = ((2, 3, 1), (20, 15, 12))
    volume = gb.ultrasound.reconstruct(
        gb.ultrasound.Sweep(floats, poses), "pvn-om", spacing=0.6, region=box, device="cpu"
    )
    same_volume(folder, "volume_float", volume)
    live = gb.ultrasound.Reconstructor(0.7, mask=mask, device="cpu")
    for f in (12, 3, 20, 8, 0, 23, 16):
        live.add(frames[f], pose(f))
    same_volume(folder, "live", live.volume())


def ppm(path):
    """(H, W, 3) uint8 of a file as the examples write it."""
    head, size, most, data = path.read_bytes().split(b"\n", 3)
    assert (head, most) == (b"P6", b"255")
    width, height = map(int, size.split())
    return np.frombuffer(data, np.uint8).reshape(height, width, 3)


def test_load_and_draw(built, made, tmp_path):
    _, p, _ = made
    np.save(tmp_path / "p.npy", p)
    p.tofile(tmp_path / "p.raw")
    np.savetxt(tmp_path / "p.xyz", p, fmt="%.9g")
    expected = gb.render(gb.Scene(p, device="cpu"), size=(640, 480)).picture
    program = built / "examples" / "load_and_draw"
    for name in ("p.npy", "p.raw", "p.xyz"):
        done = run(program, name, "image.ppm", "cpu", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "729 particles" in done.stdout
        assert np.array_equal(ppm(tmp_path / "image.ppm"), expected), name
    done = run(program, "missing.npy", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr == "missing.npy: cannot be read\n"
    done = run(program, "p.npy", "image.ppm", "gpu", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("device: expected auto, cpu")


def drop() -> np.ndarray:
    """(N, 3) float64, as in integrations/cpp/drop.hpp."""
    index = np.stack(np.meshgrid(*[np.arange(-8, 9)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return 0.05 * index[(index**2).sum(1) <= 64]


def drawn_by(built, name, folder) -> dict[str, str]:
    """What a program that tries an adaptor says of each image: in place, or copied."""
    if name not in targets(built):
        pytest.skip("no Kokkos was found")
    build(built, name)
    done = run(built / "integrations" / name, cwd=folder)
    assert done.returncode == 0, done.stderr
    return dict(re.findall(r"^(\w+)\.ppm: 2109 particles, (.+)$", done.stdout, re.M))


def shows_the_drop(folder, name, positions=None, order=None) -> None:
    """The image is Python's, and values are those of the particles in their order."""
    p = drop() if positions is None else positions
    order = np.arange(len(p)) if order is None else order
    scene = gb.Scene(p[order].astype(np.float32), surface="smooth", spacing=0.05, device="cpu")
    expected = gb.render(scene, gb.Camera((1, 0.7, 1.6), (0, 0, 0)), DRAWN).picture
    # Each of the two rounds the axes of the camera by itself: a pixel may be a level off.
    assert np.abs(ppm(folder / f"{name}.ppm").astype(int) - expected).max() <= 1, name
    values = np.fromfile(folder / f"{name}.raw", np.float32)
    np.testing.assert_allclose(values, (order / len(p)).astype(np.float32), rtol=1e-6)


def test_arrays_of_dualsphysics(built, tmp_path):
    said = drawn_by(built, "try_dualsphysics", tmp_path)
    assert said == {"dualsphysics": "in place", "dualsphysics_floating": "copied"}
    for name in said:
        shows_the_drop(tmp_path, name)


def test_tiles_like_amrex(built, tmp_path):
    assert drawn_by(built, "try_amrex", tmp_path) == {"amrex": "copied"}
    origin = np.array([1e6, -2e6, 0])
    order = np.concatenate([np.arange(len(drop()))[t::3] for t in range(3)])
    shows_the_drop(tmp_path, "amrex", (drop() + origin) - origin, order)


def test_views_of_kokkos(built, tmp_path):
    said = drawn_by(built, "try_kokkos", tmp_path)
    assert said == {"kokkos_right": "in place", "kokkos_double": "in place",
                    "kokkos_left": "copied", "kokkos_left_double": "copied"}  # fmt: skip
    for name in said:
        shows_the_drop(tmp_path, name)


def toy(folder, name, spacing, counts, green):
    """The last image of a toy simulation, from where its particles ended."""
    p = np.fromfile(folder / f"{name}.raw", np.float32).reshape(-1, 3)
    i = np.arange(len(p))
    layer = i // counts[0] % counts[1]
    color = np.float32([0.1, 0.3, 0.8]) * np.ones((len(p), 1), np.float32)
    color[:, 1] += np.float32(green) * layer.astype(np.float32)
    support = float(np.float32(2) * np.float32(spacing))
    return gb.Scene(gb.Particles(p, support=support, color=color), device="cpu")


@pytest.mark.slow
def test_toy_sph(built, tmp_path):
    build(built, "toy_sph")
    done = run(built / "examples" / "toy_sph", 40, "cpu", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1200 particles after 40 steps" in done.stdout
    scene = toy(tmp_path, "toy_sph", 0.05, (10, 12), 0.05)
    camera = gb.Camera((0.5, 0.9, 2.2), (0.5, 0.3, 0.25))
    expected = gb.render(scene, camera, (320, 240)).picture
    found = ppm(tmp_path / "toy_sph.ppm")
    assert np.array_equal(found, expected)
    assert found.std() > 5


@pytest.mark.slow
def test_toy_sph_cuda(built, tmp_path):
    if "toy_sph_cuda" not in targets(built):
        pytest.skip("no CUDA compiler was found")
    build(built, "toy_sph_cuda")
    try:
        choose("cuda")
    except RuntimeError as error:
        pytest.skip(f"cuda: {error}")
    done = run(built / "examples" / "toy_sph_cuda", 30, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "after 30 steps" in done.stdout
    p = np.fromfile(tmp_path / "toy_sph_cuda.raw", np.float32).reshape(-1, 3)
    color = np.tile(np.float32([0.1, 0, 0.8]), (len(p), 1))
    # nvcc contracts the sum of the color into one rounding
    layer = np.arange(len(p)) // 20 % 24
    color[:, 1] = np.float32(np.float64(np.float32(0.3)) + np.float64(np.float32(0.02)) * layer)
    particles = gb.Particles(p, support=float(np.float32(0.05)), color=color)
    camera = gb.Camera((0.5, 0.9, 2.2), (0.5, 0.3, 0.25))
    expected = gb.render(gb.Scene(particles, device="cuda"), camera, (640, 480)).picture
    assert np.array_equal(ppm(tmp_path / "toy_sph_cuda.ppm"), expected)


@pytest.mark.slow
def test_insitu_mpi(built, tmp_path):
    """A simulation on ranks draws the same bits on any number of them; and what one scene shows."""
    if "insitu_mpi" not in targets(built):
        pytest.skip("no MPI was found")
    start = launcher.mpiexec()
    build(built, "insitu_mpi")
    images = []
    for n in (1, 3, 4):
        done = run(start, "-n", n, built / "examples" / "insitu_mpi", 40, 0.05, 20, "cpu",
                   cwd=tmp_path, env=launcher.ENV)  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert f"2560 particles on {n} ranks, 40 steps" in done.stdout
        images.append(ppm(tmp_path / "insitu_mpi.ppm"))
    assert images[0].shape == (400, 640, 3)
    assert images[0].std() > 5
    for image in images[1:]:
        assert np.array_equal(images[0], image)
    done = run(start, "-n", 3, built / "examples" / "insitu_mpi", 2, 0.05, 1, "gpu",
               cwd=tmp_path, env=launcher.ENV)  # fmt: skip
    assert done.returncode != 0
    assert done.stderr.count("device: expected auto, cpu") == 1


@pytest.mark.slow
def test_cut_tissue(built, tmp_path):
    build(built, "cut_tissue")
    done = run(built / "examples" / "cut_tissue", "cpu", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    cut, pieces, after, before = map(float, re.findall(r"(?<![-.\d])[\d.]+(?= )", done.stdout))
    assert cut > 100
    assert pieces == 1
    assert 0 < after < 0.9 * before
    assert len(np.unique(ppm(tmp_path / "cut_tissue.ppm").reshape(-1, 3), axis=0)) > 100


@pytest.mark.slow
def test_volume_from_sweep(built, tmp_path):
    build(built, "volume_from_sweep")
    done = run(built / "examples" / "volume_from_sweep", "cpu", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    f, row, column = np.ogrid[:60, :80, :96]
    tilt = 0.002 * f
    x, y, z = 0.5 * column - 24, 0.5 * row - 20, tilt * row + 0.5 * f - 15
    square = x * x + y * y + z * z
    speckle = 60 + (7 * row + 3 * column) % 20
    frames = np.where(square < 16, 40, np.where(square < 144, 220, speckle)).astype(np.uint8)
    poses = np.zeros((60, 4, 4))
    poses[:] = np.diag([0.5, 0.5, 1, 1])
    poses[:, 2, 1], poses[:, 2, 3] = 0.002 * np.arange(60), 0.5 * np.arange(60)
    sweep = gb.ultrasound.Sweep(frames, poses)
    volume = gb.ultrasound.reconstruct(sweep, spacing=0.75, compounding="maximum", device="cpu")
    same(tmp_path, "volume.raw", volume.values)
    live = gb.ultrasound.Reconstructor(0.75, device="cpu")
    for image, place in zip(frames, poses, strict=True):
        live.add(image, place)
    same(tmp_path, "volume_live.raw", live.volume().values)


@pytest.mark.slow
def test_a_backend_of_another_version_is_refused(built, made, tmp_path):
    build(built, "other_abi")
    library = Path(gb.__file__).parent / "libglobule.so"
    shutil.copy(library, tmp_path)
    for level in ("v2", "v3", "v4"):
        shutil.copy(built / "tests" / "libother_abi.so", tmp_path / f"libglobule_cpu_{level}.so")
    np.save(tmp_path / "p.npy", made[1])
    env = {**os.environ, "LD_LIBRARY_PATH": str(tmp_path)}
    env.pop("GLOBULE_SIMD", None)
    done = run(built / "examples" / "load_and_draw", "p.npy", "x.ppm", "cpu", cwd=tmp_path, env=env)
    assert done.returncode == 1
    assert "backend library is of another version (interface 1, expected" in done.stderr
    assert not (tmp_path / "x.ppm").exists()
