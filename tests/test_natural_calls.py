"""The calls that come to mind first work, or say in one line what to call instead."""

import ast
import dataclasses
import inspect
import io
import logging
import pickle
import re
import subprocess
import sys
from operator import attrgetter
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube
from globule.cli import main
from globule.data.attributes import attribute_colors
from globule.render.settings import for_values
from globule.scene.thesis import Thesis
from light import ball
from PIL import Image

SIZE = (32, 24)
CAMERA = gb.Camera((2.5, 2, 3), (0, 0, 0))


@pytest.fixture
def scene():
    p = cube()
    p.attributes["speed"] = np.linspace(0, 4, len(p))
    return gb.Scene(p, device="cpu")


def same(one, other):
    np.testing.assert_array_equal(one.image, other.image)
    assert one.mask.any()


def test_what_stands_for_a_scene_or_several(particles):
    p = gb.read(particles)
    expected = gb.render(gb.Scene(p, surface="smooth"), CAMERA, SIZE)
    for natural in (p, particles, Path(particles), [p], gb.Layer(p), [gb.Layer(particles)]):
        same(gb.render(natural, CAMERA, SIZE), expected)
    bare = gb.render(gb.Scene(p.positions, surface="smooth"), CAMERA, SIZE)
    same(gb.render(p.positions, CAMERA, SIZE), bare)
    same(gb.render(p.positions.tolist(), CAMERA, SIZE), bare)
    assert len(gb.Scene(particles)) == len(gb.Scene(gb.Scene(p))) == len(p)
    scene = gb.Scene(p[:3])
    scene.update(particles)
    assert (len(scene), gb.Camera.fit(particles)) == (len(p), gb.Camera.fit(p))
    assert gb.fluids.measure_spacing(particles).shape == (len(p),)
    apart = [gb.Particles([[x, 0, 0]], support=1.0) for x in (-1.0, 1.0)]
    both = gb.render(apart, size=SIZE)
    same(both, gb.render(iter([gb.Scene(p) for p in apart]), size=SIZE))
    assert repr(both) == "Frame(32 x 24, 1 sample a pixel, 2 layers, cpu)"
    sim = gb.Simulation(gb.Particles(cube().positions), spacing=0.3, device="cpu")
    expected = gb.render(sim.scene, CAMERA, SIZE)
    same(gb.render(sim, CAMERA, SIZE), expected)
    same(gb.render(gb.Layer(sim), CAMERA, SIZE), expected)
    colored = gb.render(sim, CAMERA, SIZE, color_by="y")
    assert not np.array_equal(colored.image, expected.image)
    np.testing.assert_allclose(colored.distance, expected.distance, rtol=1e-5)
    same(gb.render(sim, CAMERA, SIZE), expected)
    assert len(gb.Scene(sim)) == len(sim)


def test_a_size_in_the_cameras_place(scene):
    same(gb.render(scene, SIZE), gb.render(scene, None, SIZE))
    same(gb.render(scene, list(SIZE)), gb.render(scene, None, SIZE))
    same(gb.render(scene, SIZE, CAMERA), gb.render(scene, CAMERA, SIZE))
    assert gb.render(scene, size=CAMERA).size == gb.render(scene).size == (1024, 782)


@pytest.mark.parametrize(("call", "message"), [
    (lambda p: gb.Particles(p, radius=1), "Particles(positions, support, weight, color, reflection, refraction, "
     "rigidity, anisotropy, attributes, origin, up, names): got an unexpected keyword argument 'radius'"),
    (lambda p: gb.Scene(p, surfce="smooth"), "argument 'surfce', did you mean surface?"),
    (lambda p: gb.load_preset("watr"), "load_preset(name, scene, up): missing a required argument: 'scene'"),
    (lambda p: gb.load_preset("watr", gb.Scene(p)), "flat, got 'watr', did you mean water?"),
    (lambda p: gb.Scene(p, kernel="murakamy"), "got 'murakamy', did you mean murakami?"),
    (lambda p: gb.Simulation("dam-brake"), "brain-surgery, got dam-brake, did you mean dam-break?"),
])  # fmt: skip
def test_words_that_are_not_known(call, message):
    with pytest.raises((TypeError, ValueError, OSError)) as raised:
        call([[0.0, 0, 0]])
    assert str(raised.value).endswith(message)
    assert isinstance(raised.value, TypeError) == ("argument" in str(raised.value))


@pytest.mark.parametrize(("call", "said"), [
    (lambda: gb.Scene(gb.Particles([[0, np.nan, 0], [0, 0, 0], [0, 0, np.inf]]), device="cpu"),
     "positions: 2 of 3 are not drawn: they have NaN or inf"),
    (lambda: gb.Particles(np.random.default_rng(0).random((50, 3)) + 1e9), "positions: "),
])  # fmt: skip
def test_warnings_name_the_line_of_the_program(call, said):
    with pytest.warns(UserWarning, match=said) as warned:
        call()
    assert [w.filename for w in warned] == [__file__]


def test_settings_as_a_dict(scene):
    look = {"shadows": True, "samples": 2, "background": 0.5}
    expected = gb.render(scene, SIZE, settings=gb.RenderSettings(**look))
    for given in ((SIZE, look), (None, SIZE, look)):
        same(gb.render(scene, *given), expected)
    same(gb.render(scene, SIZE, settings=look), expected)


MISTAKES = [
    (lambda s: gb.render(s, 640, 480), TypeError, "camera: expected Camera or a size"),
    (lambda s: gb.render(s, gb.RenderSettings()), TypeError, "write settings=... for"),
    (lambda s: gb.render(s, {"samples": 2}), TypeError, "got settings"),
    (lambda s: gb.render(s, (64, 48), (5, 5)), TypeError, r"size: expected one, got \(64, 48\)"),
    (lambda s: gb.render(s, (64, 48), {"sample": 1}), TypeError, "samples.*, got 'sample'"),
    (lambda s: gb.render(s, samples=4), TypeError, r"samples belongs to .* settings=\{'samples'"),
    (lambda s: gb.render(s, threshold=1), TypeError, r"threshold belongs .* globule\.Scene\("),
    (lambda s: gb.render(s, fov=30), TypeError, r"fov belongs to the camera: .*globule\.Camera\("),
    (lambda s: gb.render(s, colour_by="x"), TypeError, "color_by.*, got 'colour_by'"),
    (lambda s: gb.render(s, settings="water"), TypeError,
     r"globule\.load_preset\('water', scene\)"),
    (lambda s: gb.render({"positions": [[0, 0, 0]]}), TypeError, r"globule\.Particles\(\*\*"),
    (lambda s: gb.render(None), TypeError, "scene: expected a Scene, .* got None"),
    (lambda s: gb.render("frame_*.vtk"), ValueError, r"globule\.render_sequence"),
    (lambda s: gb.render("splash"), FileNotFoundError, "splash"),
    (lambda s: gb.render([s, s], color_by="speed"), ValueError, r"globule\.color_by\("),
    (lambda s: gb.Scene(gb.volumes.Volume(np.zeros((2, 2, 2), np.uint8), np.eye(4))), TypeError,
     r"got Volume; globule\.volumes\.extract_iso_surface"),
    (lambda s: gb.Scene(gb.ultrasound.phantoms.cylinders(n_frames=2)), TypeError,
     r"globule\.ultrasound\.reconstruct"),
    (lambda s: gb.Scene(gb.Layer(s)), TypeError, r"got Layer; globule\.render\(layer\)"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "error", "message"), MISTAKES)
def test_what_cannot_work_says_what_to_call(call, error, message, scene, folder):
    with pytest.raises(error, match=message) as caught:
        call(scene)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 320


def test_color_by_is_that_of_the_command(scene, particles):
    p = scene.particles
    by_hand = dataclasses.replace(p, color=gb.colorize(p.attributes["speed"], "magma", 1, 3))
    lit = for_values(gb.RenderSettings())
    smooth = gb.render(gb.Scene(by_hand, device="cpu", surface="smooth"), CAMERA, SIZE, lit)
    expected = gb.render(gb.Scene(by_hand, device="cpu"), CAMERA, SIZE, lit)
    how = {"color_by": "speed", "colormap": "magma", "range": (1, 3)}
    same(gb.render(p, CAMERA, SIZE, **how), smooth)
    same(gb.render(gb.color_by(p, "speed", "magma", (1, 3)), CAMERA, SIZE, lit), smooth)
    painted = gb.RenderSettings(material=gb.Material(color=(1, 0, 0)))
    same(gb.render(scene, CAMERA, SIZE, painted, **how), expected)
    same(gb.render(gb.Layer(scene), CAMERA, SIZE, **how), expected)
    same(gb.render(scene, CAMERA, SIZE, lit), expected)  # a scene keeps them
    assert not np.array_equal(gb.render(scene, CAMERA, SIZE, painted).image, expected.image)
    words = ["--eye", "3,2,4", "--look-at", "0,0,0", "--size", "32x24"]
    for option, how in [
        (["--color-by", "speed"], {"color_by": "speed"}),
        (["--color-by", "flow", "--colormap", "magma"], {"color_by": "flow", "colormap": "magma"}),
        (["--color-by", "flow:1"], {"color_by": "flow:1"}),
        (["--color-by", "x", "--range", "1,-1"], {"color_by": "x", "range": (1, -1)}),
    ]:  # fmt: skip
        assert main(["render", particles, "-o", "a.png", *words, *option]) == 0
        frame = gb.render(particles, gb.Camera((3, 2, 4), (0, 0, 0)), (32, 24), **how)
        np.testing.assert_array_equal(np.asarray(Image.open("a.png")), frame.image)


@pytest.mark.parametrize(("how", "error", "message"), [
    ({"name": "speeed"}, ValueError, "color_by: expected one of x, y, z, .*speed, got speeed"),
    ({"name": 3}, TypeError, "color_by: expected a name, got 3"),
    ({"name": "speed", "colormap": "jet"}, ValueError, "colormap: expected one of viridis"),
    ({"name": "speed", "range": (0, np.inf)}, ValueError, "range: expected a finite number"),
    ({"name": "speed", "range": 3}, TypeError, r"range: expected \(lo, hi\), got 3"),
])  # fmt: skip
def test_wrong_colors(scene, how, error, message):
    with pytest.raises(error, match=message):
        gb.color_by(scene.particles, **how)


def test_values_that_are_not_finite_are_gray_and_logged(scene, caplog):
    p = scene.particles
    p.attributes["speed"] = np.where(p.positions[:, 0] > 0, np.nan, p.positions[:, 1])
    with caplog.at_level(logging.WARNING, "globule"):
        colored = gb.color_by(p, "speed")
    n = int((p.positions[:, 0] > 0).sum())
    assert caplog.messages == [f"{n} of {len(p)} particles have no finite speed"]
    found = attribute_colors(p, "speed")
    assert (found.n_unknown, len(np.unique(colored.color[p.positions[:, 0] > 0], axis=0))) == (n, 1)
    np.testing.assert_allclose(found.range, (p.positions[:, 1].min(), p.positions[:, 1].max()))


def test_a_sequence_in_colors(folder):
    positions = cube().positions
    for i in range(3):
        speed = np.full(len(positions), float(i))
        gb.write(f"f_{i}.npz", gb.Particles(positions, support=0.5, attributes={"speed": speed}))
    seen = []
    done = gb.render_sequence(
        "f_*.npz", "%d.png", SIZE, color_by="speed", settings={"samples": 2},
        progress=lambda *counts: seen.append(counts),
    )  # fmt: skip
    assert (seen, done) == ([(1, 3), (2, 3), (3, 3)], ["0.png", "1.png", "2.png"])
    assert len({tuple(np.asarray(Image.open(name))[12, 16]) for name in done}) == 3  # the range is that of all files
    same_value = gb.render_sequence(["f_1.npz", "f_1.npz"], "s%d.png", SIZE, color_by="speed")
    assert len(same_value) == 2  # no range at all: the map's middle
    one = gb.color_by(gb.read("f_1.npz"), "speed", range=(0, 2))
    with pytest.raises(ValueError, match=r"range: expected \(lo, hi\)"):
        gb.render_sequence(iter([gb.read("f_0.npz"), one]), "no%d.png", SIZE, color_by="speed")
    assert gb.find_value_range(["f_0.npz", "f_2.npz"], "speed") == (0, 2)
    x = one.positions[:, 0]
    assert gb.find_value_range([one], "x") == (x.min(), x.max())


def test_questions_take_lists_and_one_stands_for_a_list_of_one(scene, particles):
    rays = [[0, 0, 5], [0, 9, 5]], [[0, 0, -1]] * 2
    points, values = [[0, 0, 0], [0.2, 0.1, 0]], scene.particles.attributes["speed"]
    blended = scene.blend(points, values.tolist())
    np.testing.assert_array_equal(scene.blend(np.float32(points), values), blended)
    hits = scene.intersect(*rays)
    assert hits.distance is hits[0]
    assert hits.distance[0] < 5
    assert np.isinf(hits.distance[1])
    clip, light, layer = gb.ClipPlane((0, 0, 1), 0.1), gb.Headlight(0.5), gb.Layer(scene)
    one, several = (
        gb.render(make(gb.Layer(scene, clips=make(clip))), SIZE,
                  settings={"lights": make(light)}, clips=make(clip))
        for make in (lambda thing: thing, lambda thing: [thing])
    )  # fmt: skip
    np.testing.assert_array_equal(one.image, several.image)
    assert (gb.RenderSettings(lights=light), layer.clips) == (gb.RenderSettings(lights=[light]), ())
    whole = gb.find_value_range([particles], "speed")
    assert gb.find_value_range(Path(particles), "speed") == whole
    assert gb.find_value_range(gb.read(particles), "speed") == whole
    tracked = [gb.measure.track_surface(given) for given in (Path(particles), [Path(particles)])]
    np.testing.assert_array_equal(*(found["volume"] for found in tracked))


def test_names_are_few_stand_in_one_place_and_type_checkers_see_them():
    own = [name for name in gb.__all__ if not inspect.ismodule(getattr(gb, name))]
    spaces = {name for name in gb.__all__ if name not in own}
    assert len(own) <= 46
    assert spaces == {"fluids", "measure", "sim", "ultrasound", "volumes"}
    paths = own + [f"{space}.{name}" for space in spaces for name in getattr(gb, space).__all__]
    things = {path: attrgetter(path)(gb) for path in paths}
    assert len({id(thing) for thing in things.values()}) == len(things)
    for path, thing in things.items():
        assert inspect.isclass(thing) == path.rpartition(".")[2][0].isupper(), path
    tree = ast.parse(Path(gb.__file__).read_text(encoding="utf-8"))
    (block,) = [n for n in tree.body if isinstance(n, ast.If) and "TYPE" in ast.unparse(n.test)]
    seen = {alias.name: node.module for node in block.body for alias in node.names}
    assert seen == {**gb._MODULE_OF, **dict.fromkeys(gb._SPACES)}


def test_what_shows_itself_and_its_progress(scene):
    frame = gb.render(scene, SIZE, settings={"samples": 3})
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(frame._repr_png_()))), frame.image)
    np.testing.assert_array_equal(frame.picture, frame.image)
    assert repr(frame) == "Frame(32 x 24, 3 samples a pixel, cpu)"
    assert re.fullmatch(r"Scene\(\d+ particles, murakami, threshold 0.6, support [\d.]+, cpu\)", repr(scene))
    assert repr(CAMERA) == "Camera(eye=(2.5, 2, 3), look_at=(0, 0, 0), up=(0, 1, 0), fov=40)"
    seen = []

    def progress(done, total):
        seen.append((done, total))

    look = {"samples": 3, "shadows": True}
    frame = gb.render(scene, SIZE, settings=look, progress=progress)
    same(frame, gb.render(scene, SIZE, settings=look))
    same(frame.refine(2, progress), gb.render(scene, SIZE, settings={**look, "samples": 5}))
    assert seen == [(1, 3), (2, 3), (3, 3), (1, 2), (2, 2)]
    particles = scene.particles
    for long in (
        lambda: gb.fluids.find_anisotropy(particles.positions, 0.5, progress=progress),
        lambda: gb.fluids.remove_strays(particles, 0.5, progress=progress),
        lambda: gb.fluids.measure_spacing(particles, progress=progress),
    ):
        seen.clear()
        long()
        assert (seen[-1], sorted(seen)) == ((len(particles), len(particles)), seen)


def test_particles_check_what_is_assigned():
    p = cube()
    n, before = len(p), p.positions
    for name, value, error, message in [
        ("support", -1, ValueError, "support: expected numbers >= 0, got -1"),
        ("positions", np.zeros((n, 4)), ValueError, r"positions: expected shape \(N, 3\)"),
        ("attributes", {"speed": np.ones(2)}, ValueError, r"attributes\['speed'\]: expected shape"),
        ("attributes", 5, TypeError, "attributes: expected a dict of arrays, got 5"),
        ("colour", (1, 0, 0), AttributeError, r"expected one of .*, got colour; .*attributes\["),
    ]:
        with pytest.raises(error, match=message):
            setattr(p, name, value)
    assert p.positions is before
    p.color, p.weight = [0, 0.5, 1], np.ones(n)
    assert p.color.dtype == p.weight.dtype == np.float32
    with pytest.raises(ValueError, match=rf"positions: expected shape \({n}, 3\), as weight has"):
        p.positions = np.zeros((2, 3))
    p.weight = None
    p.positions = np.zeros((2, 3))
    p.attributes["speed"] = [1, 2]
    assert len(p) == 2


def test_attributes_are_checked():
    p = cube()
    n = len(p)
    for assign in (
        lambda: p.attributes.__setitem__("a", np.ones(3)), lambda: p.attributes.update(a=np.ones(3)),
        lambda: p.attributes.setdefault("a", np.ones(3)), lambda: p.attributes.__ior__({"a": np.ones(3)}),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"attributes\['a'\]: expected shape"):
            assign()
    p.attributes |= {"a": np.arange(n)}
    assert p.attributes.setdefault("a", None) is p.attributes["a"]
    with pytest.raises(ValueError, match=f"positions: .* as a has {n} rows"):
        p.positions = np.zeros((2, 3))
    copied = pickle.loads(pickle.dumps(p))
    np.testing.assert_array_equal(copied.attributes["a"], np.arange(n))
    with pytest.raises(ValueError, match=r"attributes\['b'\]"):
        copied.attributes["b"] = [1]
    assert dataclasses.asdict(p)["attributes"].keys() == {"a"}


@pytest.mark.parametrize("made", [CAMERA, gb.RenderSettings(), gb.Sky(), gb.ClipSphere((0, 0, 0), 1), Thesis()])
def test_what_is_fixed_says_how_to_change_it(made):
    kind, name = type(made).__name__, dataclasses.fields(made)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError, match=rf"{kind}\.{name}.*replace\(.*{name}=\.\.\."):
        setattr(made, name, 1)
    with pytest.raises(AttributeError, match=f"{kind}: expected one of .*{name}.*, got typo"):
        made.typo = 1


@pytest.mark.parametrize(("wrong", "error", "message"), [
    ({"eye": "above"}, TypeError, "eye: expected three numbers, got 'above'"),
    ({"eye": (0, 1)}, ValueError, r"eye: expected three finite numbers, got \(0, 1\)"),
    ({"eye": (0, np.nan, 0)}, ValueError, "eye: expected three finite numbers"),
    ({"eye": (0, 0, 0)}, ValueError, "look_at: expected"),
    ({"up": None}, (TypeError, ValueError), "up: expected three"),
    ({"fov": "wide"}, TypeError, "fov: expected a number, got 'wide'"),
    ({"fov": 0}, ValueError, "fov: expected degrees between 1e-09 and 180, got 0"),
    ({"height": 0}, ValueError, "height: expected"),
])  # fmt: skip
def test_cameras_check(wrong, error, message):
    with pytest.raises(error, match=message):
        gb.Camera(**{"eye": (0, 0, 1), "look_at": (0, 0, 0), **wrong})


def loaded(code: str) -> set[str]:
    """The modules that are imported after some code has run in a fresh Python."""
    code += "\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_import_is_short_little_and_prints_nothing_and_scenes_are_checked(particles):
    names = loaded("import globule")
    heavy = ("PIL", "websockets", "matplotlib", "scipy", "av", "nibabel", "SimpleITK")
    assert not {name for name in names if name.split(".")[0] in heavy}
    rooms = ("sim", "ultrasound", "viewer", "volumes", "formats", "figures", "bench", "cli")
    assert not {name for name in names if name.startswith(tuple(f"globule.{r}" for r in rooms))}
    code = f"import globule as gb\nprint(len(gb.Scene({particles!r}, device='cpu')), end=' ')"
    assert str(len(gb.read(particles))) in loaded(code)
    assert {"globule.sim.simulation", "globule.render.render"} <= loaded(
        "import globule as gb\ngb.Simulation; assert callable(gb.render)"
    )
    assert {*gb.__all__, "__version__"} <= set(dir(gb))
    assert gb._MODULE_OF.keys() <= set(gb.__all__)
    for name in gb.__all__:
        assert getattr(gb, name) is not None
    assert callable(gb.render)
    assert gb.volumes.slices.reslice is gb.volumes.reslice
    with pytest.raises(AttributeError, match="no attribute 'reder'"):
        gb.reder  # noqa: B018
    printing = [
        path
        for room in ("_base", "scene", "render")
        for path in (Path(gb.__file__).parent / room).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and getattr(node.func, "id", None) == "print"
    ]
    assert printing == []
    p = gb.Particles(np.zeros((10, 3)), color=np.ones((10, 3)), weight=np.ones(10))
    scene = gb.Scene(p, support=0.2, device="cpu")
    with pytest.raises(ValueError, match=r"positions: expected 10 rows, as weight has, got 12; "
                       "give weight and color too, or new Particles"):  # fmt: skip
        scene.update(positions=np.zeros((12, 3)))
    scene.update(positions=np.zeros((12, 3)), weight=np.ones(12), color=np.ones((12, 3)))
    assert len(scene.particles) == 12
    scene = ball()
    for bad, error in ((0, ValueError), ("high", TypeError), (np.nan, ValueError)):
        with pytest.raises(error, match="threshold: expected a "):
            scene.threshold = bad
    scene.threshold = 0.3
    assert scene.threshold == 0.3
