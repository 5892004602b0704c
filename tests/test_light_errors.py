"""Wrong arguments of pictures: each message names the argument, what was expected and what came."""

import dataclasses

import globule as gb
import numpy as np
import pytest
from light import QUIET, ball

NAN, INF = float("nan"), float("inf")
CAMERA = gb.Camera((0, 0, 5), (0, 0, 0))


def refuse(error, name, got, **options):
    """Rendering with these options fails, saying `name: expected ..., got ...`."""
    scene = options.pop("scene") if "scene" in options else ball()
    with pytest.raises(error) as caught:
        gb.render(scene, **{"camera": CAMERA, "size": (4, 3), **options})
    message = str(caught.value)
    assert message.startswith(f"{name}: expected "), message
    assert f", got {got}" in message, message
    assert "\n" not in message
    assert len(message) < 300


SETTINGS = [
    (ValueError, "background", (1, 2), None),
    (ValueError, "background", (0, NAN, 0), None),
    (ValueError, "background", (0, -1, 0), None),
    (TypeError, "background", "white", None),
    (ValueError, "ambient", "moon", None),
    (ValueError, "ambient", (0, INF, 0), None),
    (ValueError, "ambient", -0.1, None),
    (ValueError, "ambient_rays", -1, None),
    (ValueError, "ambient_rays", 257, None),
    (TypeError, "ambient_rays", 1.5, None),
    (TypeError, "ambient_rays", True, None),
    (ValueError, "ambient_distance", -1.0, None),
    (ValueError, "ambient_distance", NAN, None),
    (TypeError, "ambient_distance", "far", None),
    (ValueError, "exposure", -1, None),
    (ValueError, "exposure", INF, None),
    (ValueError, "depth", -1, None),
    (ValueError, "depth", 33, None),
    (TypeError, "depth", 2.0, None),
    (ValueError, "cutoff", -0.1, None),
    (ValueError, "cutoff", 1.5, None),
    (ValueError, "cutoff", NAN, None),
    (ValueError, "samples", 0, None),
    (ValueError, "samples", 65537, None),
    (TypeError, "samples", "many", None),
    (ValueError, "specular", -1.0, None),
    (ValueError, "shininess", NAN, None),
    (TypeError, "sky", "blue", None),
    (TypeError, "ground", -1.0, None),
    (TypeError, "lights", ["sun"], "'sun'"),
    (ValueError, "lights", [gb.Headlight()] * 9, "9"),
]


@pytest.mark.parametrize(("error", "name", "value", "got"), SETTINGS, ids=str)
def test_settings(error, name, value, got):
    settings = dataclasses.replace(QUIET, **{name: value})
    refuse(error, name, repr(value) if got is None else got, settings=settings)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("material", {"settings": dataclasses.replace(QUIET, material=None)}),
        ("material", {"settings": dataclasses.replace(QUIET, material=0.5)}),
        ("material", {"scene": gb.Layer(ball(), "clay")}),
        ("lights", {"settings": dataclasses.replace(QUIET, lights=gb.Headlight())}),
        ("clips", {"clips": gb.ClipPlane((0, 0, 1))}),
        ("clips", {"scene": gb.Layer(ball(), None, gb.ClipPlane((0, 0, 1)))}),
        ("settings", {"settings": {"depth": 3}}),
        ("scene", {"scene": 5}),
    ],
    ids=str,
)
def test_other_things_than_expected(name, options):
    with pytest.raises(TypeError, match=f"{name}: expected .*, got "):
        gb.render(**{"scene": ball(), "camera": CAMERA, "size": (4, 3), **options})


MATERIALS = [
    (ValueError, {"reflection": 1.5}),
    (ValueError, {"reflection": -0.5}),
    (ValueError, {"reflection": NAN}),
    (TypeError, {"reflection": "shiny"}),
    (ValueError, {"transmission": 2}),
    (ValueError, {"transmission": -1}),
    (ValueError, {"index": 0.9}),
    (ValueError, {"index": 5}),
    (ValueError, {"index": NAN}),
    (TypeError, {"index": "glass"}),
    (ValueError, {"roughness": 1.1}),
    (ValueError, {"roughness": -0.1}),
    (ValueError, {"color": (1, 2)}),
    (ValueError, {"color": (1, NAN, 0)}),
    (ValueError, {"color": (-1, 0, 0)}),
    (TypeError, {"color": "red"}),
    (ValueError, {"absorption": -1.0}),
    (ValueError, {"absorption": (0, 0, INF)}),
    (ValueError, {"absorption": (1, 2, 3, 4)}),
    (ValueError, {"specular": -0.1}),
    (ValueError, {"shininess": -2}),
    (TypeError, {"shininess": "very"}),
]


@pytest.mark.parametrize(("error", "field"), MATERIALS, ids=str)
def test_materials(error, field):
    ((name, value),) = field.items()
    material = gb.Material(**field)
    refuse(error, name, repr(value), settings=dataclasses.replace(QUIET, material=material))
    refuse(error, name, repr(value), scene=gb.Layer(ball(), material))


LIGHTS = [
    (ValueError, "radiance", gb.Headlight((1, 2)), "(1, 2)"),
    (ValueError, "radiance", gb.Headlight(-1), "-1"),
    (ValueError, "radiance", gb.DirectionalLight((0, 1, 0), NAN), "nan"),
    (ValueError, "direction", gb.DirectionalLight((0, 0, 0)), "(0, 0, 0)"),
    (ValueError, "direction", gb.DirectionalLight((0, NAN, 0)), "(0, nan, 0)"),
    (TypeError, "direction", gb.DirectionalLight("up"), "'up'"),
    (ValueError, "angle", gb.DirectionalLight(angle=-1), "-1"),
    (ValueError, "angle", gb.DirectionalLight(angle=180), "180"),
    (ValueError, "position", gb.PointLight((1, 2)), "(1, 2)"),
    (ValueError, "position", gb.PointLight((1, INF, 0)), "(1, inf, 0)"),
    (ValueError, "radius", gb.PointLight((1, 2, 3), radius=-1), "-1"),
    (ValueError, "radius", gb.PointLight((1, 2, 3), radius=NAN), "nan"),
]


@pytest.mark.parametrize(("error", "name", "light", "got"), LIGHTS, ids=str)
def test_lights(error, name, light, got):
    refuse(error, name, got, settings=dataclasses.replace(QUIET, lights=[light]))


AROUND = [
    (ValueError, "zenith", {"sky": gb.Sky(zenith=(1, 2))}, "(1, 2)"),
    (ValueError, "horizon", {"sky": gb.Sky(horizon=-1)}, "-1"),
    (ValueError, "ground", {"sky": gb.Sky(ground=NAN)}, "nan"),
    (ValueError, "up", {"sky": gb.Sky(up=(0, 0, 0))}, "(0, 0, 0)"),
    (ValueError, "turn", {"sky": gb.Environment(np.ones((2, 4, 3)), turn=INF)}, "inf"),
    (ValueError, "strength", {"sky": gb.Environment(np.ones((2, 4, 3)), strength=-1)}, "-1"),
    (ValueError, "up", {"sky": gb.Environment(np.ones((2, 4, 3)), up=(1, 2))}, "(1, 2)"),
    (ValueError, "height", {"ground": gb.Ground(NAN)}, "nan"),
    (TypeError, "height", {"ground": gb.Ground("low")}, "'low'"),
    (ValueError, "normal", {"ground": gb.Ground(0, normal=(0, 0, 0))}, "(0, 0, 0)"),
    (ValueError, "color", {"ground": gb.Ground(0, color=-1)}, "-1"),
    (ValueError, "other", {"ground": gb.Ground(0, other=(1, 2))}, "(1, 2)"),
    (ValueError, "check", {"ground": gb.Ground(0, check=-1)}, "-1"),
    (ValueError, "reflection", {"ground": gb.Ground(0, reflection=1.5)}, "1.5"),
]


@pytest.mark.parametrize(("error", "name", "setting", "got"), AROUND, ids=str)
def test_sky_and_ground(error, name, setting, got):
    refuse(error, name, got, settings=dataclasses.replace(QUIET, **setting))


@pytest.mark.parametrize(
    ("image", "got"),
    [
        (np.ones((2, 3)), "(2, 3)"),
        (np.ones((2, 3, 4)), "(2, 3, 4)"),
        (np.ones((0, 3, 3)), "(0,"),
        (np.ones((1, 40_000, 3)), "(1, 40000, 3)"),
    ],
    ids=["flat", "four channels", "empty", "wide"],
)
def test_environment_shapes(image, got):
    with pytest.raises(ValueError, match="image: expected shape") as caught:
        gb.Environment(image)
    assert got in str(caught.value)


@pytest.mark.parametrize("value", [NAN, INF, -1.0])
def test_environment_values(value):
    image = np.ones((4, 8, 3), np.float32)
    image[2, 3, 1] = value
    with pytest.raises(ValueError, match="image: expected finite radiance >= 0"):
        gb.Environment(image)


CLIPS = [
    (ValueError, "normal", gb.ClipPlane((0, 0, 0)), "(0, 0, 0)"),
    (ValueError, "normal", gb.ClipPlane((0, NAN, 0)), "(0, nan, 0)"),
    (TypeError, "normal", gb.ClipPlane("up"), "'up'"),
    (ValueError, "offset", gb.ClipPlane((0, 0, 1), INF), "inf"),
    (TypeError, "offset", gb.ClipPlane((0, 0, 1), "far"), "'far'"),
    (ValueError, "lo", gb.ClipBox((0, 0), (1, 1, 1)), "(0, 0)"),
    (ValueError, "hi", gb.ClipBox((0, 0, 0), (1, 0, 1)), "(1, 0, 1)"),
    (ValueError, "hi", gb.ClipBox((0, 0, 0), (1, NAN, 1)), "(1, nan, 1)"),
    (ValueError, "center", gb.ClipSphere((0, 0), 1), "(0, 0)"),
    (ValueError, "radius", gb.ClipSphere((0, 0, 0), -1), "-1"),
    (ValueError, "radius", gb.ClipSphere((0, 0, 0), 0), "0"),
    (ValueError, "radius", gb.ClipSphere((0, 0, 0), NAN), "nan"),
    (TypeError, "radius", gb.ClipSphere((0, 0, 0), "big"), "'big'"),
    (TypeError, "clips", "plane", "'p'"),
]


@pytest.mark.parametrize(("error", "name", "clip", "got"), CLIPS, ids=str)
def test_clips(error, name, clip, got):
    refuse(error, name, got, clips=clip if name == "clips" else [clip])


def test_layers():
    refuse(ValueError, "scene", "0", scene=[])
    refuse(ValueError, "scene", "5", scene=[ball() for _ in range(5)])
    refuse(TypeError, "scene", "3", scene=[ball(), 3])
    refuse(TypeError, "scene", "'x'", scene=[gb.Layer("x")])
    assert gb.render([ball() for _ in range(4)], CAMERA, (4, 3)).mask.shape == (3, 4)


@pytest.mark.parametrize(
    ("error", "size", "got"),
    [
        (ValueError, (0, 3), "0x3"),
        (ValueError, (3, -1), "3x-1"),
        (TypeError, "big", "'big'"),
        (TypeError, 5, "5"),
        (TypeError, (1, 2, 3), "(1, 2, 3)"),
        (ValueError, (2**20, 2**20), "1048576x"),
    ],
    ids=str,
)
def test_sizes(error, size, got):
    refuse(error, "size", got, size=size)


def test_nothing_is_left_behind_by_what_was_refused():
    """The scene goes on as before."""
    scene = ball()
    before = gb.render(scene, CAMERA, (20, 20), QUIET).picture
    for bad in ({"depth": -1}, {"material": gb.Material(index=9)}, {"lights": [1]}):
        with pytest.raises((TypeError, ValueError)):
            gb.render(scene, CAMERA, (20, 20), dataclasses.replace(QUIET, **bad))
    np.testing.assert_array_equal(gb.render(scene, CAMERA, (20, 20), QUIET).picture, before)
