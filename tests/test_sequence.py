"""Sequences: what stays the same from picture to picture, what is kept, and how they end."""

import json
import os
import signal
import subprocess
import sys
import threading

import globule as gb
import numpy as np
import pytest
from cli_helpers import COMMAND, SMALL, at_edge, cube, refused, run_json
from format_helpers import naming
from globule.cli import main
from globule.pieces.shown import shown_scene
from globule.render.image_sequence import is_whole
from globule.render.sequence import find_files, leader, missing_numbers, read_ahead, with_frames
from PIL import Image
from waiting import PATIENCE, until

try:
    import av
except ImportError:
    av = None

needs_av = pytest.mark.skipif(av is None, reason="PyAV is not installed (the extra `video`)")
N = 4
AIM = ["--eye", "1,0.5,6", "--look-at", "1,0.5,0"]
pytestmark = pytest.mark.usefixtures("folder")


def frame(i: int) -> gb.Particles:
    axis = np.arange(5, dtype=np.float32) / 5
    grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    speed = i + np.linspace(0, 1, len(grid))
    return gb.Particles(grid * (1 + 0.1 * i) + [0.3 * i, 0, 0], attributes={"speed": speed})


@pytest.fixture
def files(folder):
    for i in range(N):
        gb.write(f"f_{i}.npz", frame(i))
    return [f"f_{i}.npz" for i in range(N)]


def pictures(pattern: str = "p_%d.png") -> list[np.ndarray]:
    return [np.asarray(Image.open(pattern % i)) for i in range(N)]


def test_patterns_and_missing_frames(folder, capsys):
    (folder / "sub").mkdir()
    for name in ("f_1.ply", "f_2.ply", "f_10.ply", "f_010.ply", "f_x.ply", "sub/g1.ply"):
        (folder / name).write_text("")
    (folder / "odd[1].ply").write_text("")
    for given, found in (
        (["f_?.ply"], ["f_1.ply", "f_2.ply", "f_x.ply"]),
        (["f_[0-9]*.ply"], ["f_1.ply", "f_2.ply", "f_010.ply", "f_10.ply"]),
        (["f_%d.ply"], ["f_1.ply", "f_2.ply", "f_010.ply", "f_10.ply"]),
        (["f_%03d.ply"], ["f_010.ply"]),
        (["sub/g%d.ply"], ["sub/g1.ply"]),
        (["odd[1].ply"], ["odd[1].ply"]),
        (["f_1.ply", "f_10.ply", "f_2.ply"], ["f_1.ply", "f_2.ply", "f_10.ply"]),  # as the shell sorts them
        (["f_2.ply", "f_10.ply", "f_1.ply"], ["f_2.ply", "f_10.ply", "f_1.ply"]),  # as somebody has put them
    ):
        assert find_files(given) == found
    with pytest.raises(ValueError, match=r"no_%d\.ply: expected a pattern"):
        find_files(["no_%d.ply"])
    for i in (1, 2, 5):
        gb.write(folder / f"m_{i}.npz", cube())
    with pytest.warns(UserWarning, match=r"m_1.npz to m_5.npz: frames 3, 4 missing \(2 in all\)"):
        assert len(find_files(["m_*.npz"])) == 3
    assert main(["render", "m_*.npz", "-o", "m_%02d.png", "--size", "24x18", "--device", "cpu"]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "missing" in line]
    assert said == ["globule: warning: m_1.npz to m_5.npz: frames 3, 4 missing (2 in all)"]


@pytest.mark.parametrize(
    ("numbers", "missing"),
    [
        ((1, 2, 5), [3, 4]), ((1, 2, 3), []), ((1, 5), []), ((0, 1000, 2000, 4000), [3000]),
        ((0, 10, 25, 70), []), ((8, 9, 10, 12), [11]), ((7,), []), ((1, 1, 3), []),
        ((0, 1, 10**12), []),
    ],
)  # fmt: skip
def test_frames_that_are_missing(numbers, missing):
    assert missing_numbers([f"out/v2_{i}.vtk" for i in numbers]) == missing
    assert missing_numbers([f"out/v2_{i:08}.vtk" for i in numbers]) == missing
    assert missing_numbers(["a.vtk", "b1.vtk", "b3.vtk"]) == []


def test_reading_ahead_overlaps_and_is_bounded():
    fetched, ahead_of = [], []
    taken = 0

    def source():
        for i in range(9):
            fetched.append(threading.current_thread().name)
            ahead_of.append(i - taken)
            yield i

    ahead = read_ahead(source())
    for i in range(9):
        taken = i + 1
        assert next(ahead) == i
        most = min(taken + 2, 9)  # one waits, one finds no place
        until(lambda most=most: len(fetched) == most)
    assert max(ahead_of) == 1
    assert threading.current_thread().name not in fetched
    assert list(ahead) == []


def test_patterns_and_paths_make_pictures_and_mistakes_none(files, capsys):
    facts = run_json(capsys, "render", "f_%d.npz", "-o", "p_%d.png", *SMALL)
    assert facts["images"] == [f"p_{i}.png" for i in range(N)]
    assert len({report["support"] for report in facts["frames"]}) == 1  # the first's, although the block grows
    masks = [(p != p[0, 0]).any(axis=2) for p in pictures()]
    assert [(mask.any(), at_edge(mask)) for mask in masks] == [(True, False)] * N  # the camera sees all of them
    middles = [np.argwhere(mask).mean(axis=0)[1] for mask in masks]
    assert (np.diff(middles) > 1).all()  # and the block moves through a view that stands still
    command = ["--color-by", "speed", *AIM, *SMALL]
    assert main(["render", *files, "-o", "a_%d.png", *command]) == 0
    assert main(["render", *files, "-o", "b_%d.png", *command, "--range", "0,4"]) == 0
    for a, b in zip(pictures("a_%d.png"), pictures("b_%d.png"), strict=True):
        assert (a == b).all()
    assert main(["render", files[0], "-o", "one.png", *command]) == 0
    assert (np.asarray(Image.open("one.png")) != pictures("a_%d.png")[0]).any()
    gb.write("f_0.npz", gb.Particles(np.zeros((0, 3))))
    assert main(["render", *files, "-o", "p_%d.png", *SMALL]) == 0
    n_seen = [int((p != p[0, 0]).any(axis=2).sum()) for p in pictures()]
    assert n_seen[0] == 0
    assert min(n_seen[1:]) > 50
    keys = [{"time": 0, "eye": [0.5, 0.5, 4], "look_at": [0.5, 0.5, 0.5]}, {"time": 1, "eye": [4, 0.5, 0.5]}]
    with open("path.json", "w", encoding="utf-8") as file:
        json.dump(keys, file)
    command = ["render", files[1], "--camera-path", "path.json", "--fps", "2", *SMALL]
    os.mkdir("turn")
    assert main([*command, "-o", "turn"]) == 0
    assert sorted(os.listdir("turn")) == [f"f_1_{i:04d}.png" for i in range(3)]
    scene = gb.Scene(gb.read(files[1]), device="cpu", surface="smooth")
    expected = gb.render(scene, gb.CameraPath(keys, fps=2)(1), (40, 30)).picture
    assert (np.asarray(Image.open("turn/f_1_0001.png")) == expected).all()
    path = ["--camera-path", "no.toml"]
    capsys.readouterr()
    for words, said in (
        (["none_*.ply"], "none_*.ply"), ([*files, "--fps", "0"], "--fps"), ([*files, *path], "no.toml"),
        ([*files, *path, "--eye", "1,2,3"], "--eye"),
    ):  # fmt: skip
        assert said in refused(capsys, "render", *words, "-o", "p_%d.png")


@pytest.mark.parametrize("aim", [[], AIM])
def test_pictures_before_a_broken_file_stay(files, capsys, folder, aim):
    (folder / "f_2.npz").write_bytes(b"nonsense")
    assert main(["render", *files, "-o", "p_%d.png", *aim, *SMALL]) == 2
    assert "f_2.npz" in capsys.readouterr().err
    assert sorted(p.name for p in folder.glob("p_*.png")) == ["p_0.png", "p_1.png"]


def test_resume(files, folder, capsys):
    command = ["render", *files, "-o", "p_%d.png", "--aov", "p_%d.npz", *SMALL]
    assert main(command) == 0
    whole = pictures()
    (folder / "p_2.npz").write_bytes(b"half")
    (folder / "p_1.png").write_bytes((folder / "p_1.png").read_bytes()[:-300])  # half
    (folder / "p_3.png").unlink()

    def times():
        return [(folder / f"p_{i}.png").stat().st_mtime_ns for i in (0, 1, 2)]

    before = times()
    capsys.readouterr()
    assert (main([*command, "--resume"]), capsys.readouterr().out.count("\n")) == (0, 3)
    assert [a == b for a, b in zip(times(), before, strict=True)] == [True, False, False]
    with np.load("p_2.npz") as arrays:
        assert arrays["mask"].any()
    for a, b in zip(whole, pictures(), strict=True):
        assert (a == b).all()
    assert main([*command, "--resume"]) == 0  # all there
    assert "4 images, 4 of them finished before" in capsys.readouterr().out
    assert not is_whole("p_0.png", (41, 30))


@needs_av
def test_a_movie_goes_on_where_it_stopped(files, folder, capsys):
    assert main(["render", "f_*.npz", "-o", "m.mp4", "--fps", "12", "--size", "41x30"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("m.mp4: 4 frames")
    assert err == ""
    assert not (folder / "m.mp4.frames").exists()
    with av.open("m.mp4") as movie:
        shown = list(movie.decode(video=0))
        assert movie.streams.video[0].average_rate == 12
    assert [(f.width, f.height) for f in shown] == [(42, 30)] * N
    facts = run_json(capsys, "render", "f_*.npz", "-o", "m.mp4", *SMALL)
    assert (facts["images"], facts["counts"]) == (["m.mp4"], {"pictures": 4, "kept": 0})
    good = (folder / "f_2.npz").read_bytes()
    (folder / "f_2.npz").write_bytes(b"nonsense")
    command = ["render", *files, "-o", "n.mp4", *SMALL, *AIM]
    assert main(command) == 2
    err = capsys.readouterr().err
    assert "f_2.npz" in err
    assert "2 finished images are in n.mp4.frames" in err
    assert not (folder / "n.mp4").exists()
    (folder / "f_2.npz").write_bytes(good)
    assert main([*command, "--resume"]) == 0
    assert "4 frames, 2 of them finished before" in capsys.readouterr().out
    assert (folder / "n.mp4").exists()
    assert not (folder / "n.mp4.frames").exists()


def test_a_movie_without_pyav(files, folder, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "av", None)
    assert "globule[video]" in refused(capsys, "render", *files, "-o", "m.mp4", *SMALL)
    assert not list(folder.glob("m.mp4*"))


@needs_av
def test_interrupted_in_the_middle(files, folder):
    """Ctrl-C: whole pictures only, one word about it, and the run can go on."""
    command = [*COMMAND, "render", *files * 200, "-o", "m.mp4", *SMALL]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    frames = folder / "m.mp4.frames"
    until(lambda: (frames / "000005.png").exists() or process.poll() is not None)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out) == (130, "")
    assert err.endswith("globule: interrupted\n")
    assert "--resume continues" in err
    kept = sorted(frames.iterdir())
    assert 6 <= len(kept) < 800
    assert all(is_whole(str(path), (40, 30)) for path in kept)
    assert not (folder / "m.mp4").exists()


def test_a_terminal_gets_a_progress_bar(files):
    ours, theirs = pytest.importorskip("pty").openpty()
    command = [*COMMAND, "render", *files, "-o", "p_%d.png", *SMALL]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=theirs, timeout=PATIENCE)
    os.close(theirs)
    shown = os.read(ours, 100_000).decode()
    os.close(ours)
    assert done.returncode == 0
    assert "/16 " in shown
    assert shown.endswith("\r\033[K")


class Falling:
    def __init__(self):
        self.positions = frame(0).positions.copy()
        self.n_steps = 0

    @property
    def particles(self):
        return gb.Particles(self.positions)

    def step(self):
        self.positions[:, 1] -= 0.1
        self.n_steps += 1


def test_sources_a_turntable_and_clips_of_one_set(files, folder):
    options = {"camera": gb.Camera((0.5, 0.5, 4), (0.5, 0.5, 0)), "size": (40, 30)}
    words = ["--eye", "0.5,0.5,4", "--look-at", "0.5,0.5,0", *SMALL]
    assert main(["render", *files, "-o", "p_%d.png", *words]) == 0
    whole = pictures()
    for source in ("f_*.npz", (frame(i) for i in range(N))):
        names = gb.render_sequence(source, "b_%d.png", **options, device="cpu")
        assert names == [f"b_{i}.png" for i in range(N)]
        assert all((a == b).all() for a, b in zip(whole, pictures("b_%d.png"), strict=True))
    falling = Falling()
    gb.render_sequence(falling, "p_%d.png", **options, n_frames=N, device="cpu")
    assert falling.n_steps == N - 1
    rows = [np.argwhere((p != p[0, 0]).any(axis=2)).mean(axis=0)[0] for p in pictures()]
    assert (np.diff(rows) > 0.5).all()
    with pytest.raises(ValueError, match="n_frames"):
        gb.render_sequence(falling, "p_%d.png", **options)
    with pytest.raises(ValueError, match="output"):
        gb.render_sequence(files, "p.png", **options)
    cameras = gb.orbit(gb.Camera((0.5, 0.5, 4), (0.5, 0.5, 0.5)), 1, N)
    names = gb.render_sequence(frame(0), "p_%d.png", cameras, (40, 30), device="cpu")
    assert (len(names), gb.render_sequence(frame(0), "p_%d.png", cameras, (40, 30), resume=True)) == (N, names)
    # Clips cut every frame.
    particles = cube()
    cut = gb.ClipPlane((1, 0, 0), float(particles.positions[:, 0].mean()))
    camera = gb.Camera.fit(particles, size=(40, 30))
    whole, open_ = (
        gb.render_sequence(particles, f"{name}_%d.png", camera, (40, 30), n_frames=1, clips=clips)
        for name, clips in (("whole", ()), ("cut", [cut]))
    )
    right = gb.render(particles, camera, (40, 30), clips=[cut]).image
    np.testing.assert_array_equal(np.asarray(Image.open(open_[0])), right)
    assert (np.asarray(Image.open(whole[0])) != right).any()


def emitted() -> list[gb.Particles]:
    """A lattice that an emitter fills row by row: nothing, a line, planes."""
    cells = np.stack(np.meshgrid(*[np.arange(10)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return [gb.Particles(0.1 * cells[:n]) for n in (0, 10, 40, 160, 360, 640, 1000)]


def test_the_frame_with_most_particles_decides_for_all(tmp_path):
    """An emitter starts with few, whose spacing and support would be others."""
    frames = emitted()
    truth = np.array([len(frame) * 1e-3 for frame in frames])
    for k, frame in enumerate(frames):
        gb.write(tmp_path / f"e_{k}.npz", frame)
    for source in (frames, str(tmp_path / "e_*.npz")):
        found = gb.measure.track_surface(source)
        np.testing.assert_allclose(found["volume"][2:], truth[2:], rtol=0.03)
        np.testing.assert_allclose(found["particle_volume"], truth, rtol=0.01)
    size = (96, 72)
    camera = gb.Camera.fit(frames[-1], size=size)
    gb.render_sequence(str(tmp_path / "e_*.npz"), tmp_path / "p_%d.png", camera, size)
    scene = shown_scene(frames[-1], device="cpu")
    for k, frame in enumerate(frames):
        scene.update(frame)
        shown = np.asarray(Image.open(tmp_path / f"p_{k}.png").convert("RGB"))
        np.testing.assert_array_equal(shown, gb.render(scene, camera, size).picture)
    grown = gb.measure.track_surface(iter(frames))["volume"]  # whose largest nobody knows at the beginning
    np.testing.assert_allclose(grown[3:], truth[3:], rtol=0.03)
    places = frames[-1].positions
    counts = (0, 40, 90, 30, 1000, 20)  # filled and emptied again
    rows = ("".join(f"{x} {y} {z}\n" for x, y, z in places[:n]) for n in counts)
    (tmp_path / "a.xyz").write_text("".join(f"{n}\n\n{some}" for n, some in zip(counts, rows, strict=True)))
    assert leader(with_frames([str(tmp_path / "a.xyz")])) == 4
    assert main(["convert", str(tmp_path / "a.xyz"), str(tmp_path / "a.pvd")]) == 0
    assert leader(with_frames([str(tmp_path / "a.pvd")])) == 4
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5part", "w") as file:  # whose frames have no size of their own
        for k, n in enumerate((40, 1000, 30, 40, 40, 30, 20, 20)):
            for i, axis in enumerate("xyz"):
                file[f"Step#{k}/{axis}"] = places[:n, i]
    assert leader(with_frames([str(tmp_path / "a.h5part")])) == 1
    for k in range(len(counts)):  # as large as each other, whatever they name
        naming("vtkMultiBlockDataSet", tmp_path / f"b{k}.vtm", f"a_000{k}.vtp")
    assert leader([str(tmp_path / f"b{k}.vtm") for k in range(len(counts))]) == 4
    assert leader([np.zeros((10, 3)), np.zeros((11, 3)), np.zeros((0, 3))]) == 0
    assert leader([np.zeros((0, 3)), np.zeros((3, 3)), np.zeros((3, 3))]) == 1
    assert leader([]) == leader(["none.npz", "nor.npz"]) == 0


@pytest.mark.parametrize("words", [(), ("--eye", "3,4,5"), ("--preset", "water")])
def test_an_empty_first_frame_changes_no_other(folder, words):
    """Camera, ground and light are those of the frame that leads, also where z is up."""
    g = np.stack(np.mgrid[:4, :4, :8], -1).reshape(-1, 3) * 0.1
    for name, frames in (("a", (g[:0], g[:40], g + (1, 0, 0))), ("b", (g[:40], g + (1, 0, 0)))):
        with open(f"{name}.dump", "w") as file:
            for k, x in enumerate(frames):
                file.write(f"ITEM: TIMESTEP\n{k}\nITEM: NUMBER OF ATOMS\n{len(x)}\nITEM: BOX BOUNDS ff ff ff\n")
                file.write("0 9\n" * 3 + "ITEM: ATOMS x y z\n")
                np.savetxt(file, x, "%.6f")
        assert main(["render", f"{name}.dump", "-o", f"{name}%d.png", "--size", "48x36", *words]) == 0
    for k in (1, 2):
        with Image.open(f"a{k}.png") as one, Image.open(f"b{k - 1}.png") as other:
            assert (np.asarray(one) == np.asarray(other)).all()
            assert len(np.unique(np.asarray(one))) > 20
