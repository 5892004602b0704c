"""Wrong arguments of pictures: each message names the argument, what was expected and what came."""

import dataclasses
import re

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses
from light import QUIET, ball

NAN, INF = float("nan"), float("inf")
CAMERA = gb.Camera((0, 0, 5), (0, 0, 0))


def refuse(error, name, got, scene=None, size=(4, 3), **options):
    """Rendering with these options fails, saying `name: expected ..., got ...`."""
    scene = ball() if scene is None else scene
    refused(error, name, got, lambda: gb.render(scene, CAMERA, size, **options))


def refused(error, name, got, call):
    """A call fails, saying `name: expected ..., got ...`."""
    with pytest.raises(error) as caught:
        call()
    message = str(caught.value)
    assert re.match(rf"{name}(\[\d\])?: expected ", message), message
    assert f", got {got}" in message, message
    assert "\n" not in message
    assert len(message) < 300


SETTINGS = [
    (ValueError, "background", (1, 2), None),
    (ValueError, "background", (0, NAN, 0), None),
    (TypeError, "background", "white", None),
    (ValueError, "ambient", "moon", None),
    (ValueError, "ambient", -0.1, None),
    (TypeError, "ambient_rays", True, None),
    (ValueError, "ambient_distance", NAN, None),
    (ValueError, "exposure", INF, None),
    (TypeError, "bounces", 2.0, None),
    (TypeError, "samples", "many", None),
    (TypeError, "sky", "blue", None),
    (TypeError, "ground", -1.0, None),
    (TypeError, "lights", ["sun"], "'sun'"),
    (ValueError, "lights", [gb.Headlight()] * 9, "9"),
]


@pytest.mark.parametrize(("error", "name", "value", "got"), SETTINGS, ids=str)
def test_settings(error, name, value, got):
    """Refused where they are made, and as a dict."""
    got = repr(value) if got is None else got
    refused(error, name, got, lambda: dataclasses.replace(QUIET, **{name: value}))
    refused(error, name, got, lambda: gb.RenderSettings(**{name: value}))
    refuse(error, name, got, settings={name: value})


def test_other_things_than_expected():
    for name, call in (
        ("material", lambda: dataclasses.replace(QUIET, material=0.5)),
        ("material", lambda: gb.Layer(ball(), "clay")),
        ("lights", lambda: dataclasses.replace(QUIET, lights=0.5)),
        ("shadows", lambda: dataclasses.replace(QUIET, shadows="no")),
        ("keep", lambda: gb.ClipBox((0, 0, 0), (1, 1, 1), keep="yes")),
        ("image", lambda: gb.Environment({"studio": 1})),
        ("clips", lambda: gb.render(ball(), clips="plane")),
        ("clips", lambda: gb.Layer(ball(), None, 0.5)),
        ("settings", lambda: gb.render(ball(), settings={"shadow": True})),
        ("settings", lambda: gb.render(ball(), settings=3)),
        ("scene", lambda: gb.render(5)),
    ):
        refuses(f"{name}: expected .*, got ", call, error=TypeError)


def test_materials():
    for error, name, value in (
        (ValueError, "reflection", NAN),
        (TypeError, "reflection", "shiny"),
        (ValueError, "color", (1, NAN, 0)),
        (TypeError, "color", "red"),
        (ValueError, "absorption", (0, 0, INF)),
        (ValueError, "absorption", (1, 2, 3, 4)),
        (TypeError, "shininess", "very"),
    ):
        refused(error, name, repr(value), lambda name=name, value=value: gb.Material(**{name: value}))


LIGHTS = [
    (ValueError, "radiance", lambda: gb.Headlight(-1), "-1"),
    (ValueError, "radiance", lambda: gb.DirectionalLight((0, 1, 0), NAN), "nan"),
    (ValueError, "direction", lambda: gb.DirectionalLight((0, 0, 0)), "(0, 0, 0)"),
    (ValueError, "direction", lambda: gb.DirectionalLight((0, NAN, 0)), "(0, nan, 0)"),
    (TypeError, "direction", lambda: gb.DirectionalLight("up"), "'up'"),
    (ValueError, "angle", lambda: gb.DirectionalLight(angle=180), "180"),
    (ValueError, "position", lambda: gb.PointLight((1, INF, 0)), "(1, inf, 0)"),
    (ValueError, "radius", lambda: gb.PointLight((1, 2, 3), radius=-1), "-1"),
]


AROUND = [
    (ValueError, "zenith", lambda: gb.Sky(zenith=(1, 2)), "(1, 2)"),
    (ValueError, "horizon", lambda: gb.Sky(horizon=-1), "-1"),
    (ValueError, "ground", lambda: gb.Sky(ground=NAN), "nan"),
    (ValueError, "up", lambda: gb.Sky(up=(0, 0, 0)), "(0, 0, 0)"),
    (ValueError, "image", lambda: gb.Environment(np.ones((2, 3, 4))), "(2, 3, 4)"),
    (ValueError, "image", lambda: gb.Environment(np.ones((0, 3, 3))), "(0,"),
    (ValueError, "image", lambda: gb.Environment(np.ones((1, 40_000, 3))), "(1, 40000, 3)"),
    (ValueError, "turn", lambda: gb.Environment(np.ones((2, 4, 3)), turn=INF), "inf"),
    (ValueError, "strength", lambda: gb.Environment(np.ones((2, 4, 3)), strength=-1), "-1"),
    (ValueError, "up", lambda: gb.Environment(np.ones((2, 4, 3)), up=(1, 2)), "(1, 2)"),
    (ValueError, "height", lambda: gb.Ground(NAN), "nan"),
    (TypeError, "height", lambda: gb.Ground("low"), "'low'"),
    (ValueError, "normal", lambda: gb.Ground(0, normal=(0, 0, 0)), "(0, 0, 0)"),
    (ValueError, "color", lambda: gb.Ground(0, color=-1), "-1"),
    (ValueError, "other", lambda: gb.Ground(0, other=(1, 2)), "(1, 2)"),
    (ValueError, "check", lambda: gb.Ground(0, check=-1), "-1"),
    (ValueError, "reflection", lambda: gb.Ground(0, reflection=1.5), "1.5"),
]


@pytest.mark.parametrize("value", [NAN, INF, -1.0])
def test_environment_values(value):
    image = np.ones((4, 8, 3), np.float32)
    image[2, 3, 1] = value
    refuses("image: expected finite radiance >= 0", gb.Environment, image)


CLIPS = [
    (ValueError, "normal", lambda: gb.ClipPlane((0, 0, 0)), "(0, 0, 0)"),
    (TypeError, "normal", lambda: gb.ClipPlane("up"), "'up'"),
    (ValueError, "offset", lambda: gb.ClipPlane((0, 0, 1), INF), "inf"),
    (ValueError, "lo", lambda: gb.ClipBox((0, 0), (1, 1, 1)), "(0, 0)"),
    (ValueError, "hi", lambda: gb.ClipBox((0, 0, 0), (1, 0, 1)), "(1, 0, 1)"),
    (ValueError, "center", lambda: gb.ClipSphere((0, 0), 1), "(0, 0)"),
    (ValueError, "radius", lambda: gb.ClipSphere((0, 0, 0), 0), "0"),
    (TypeError, "radius", lambda: gb.ClipSphere((0, 0, 0), "big"), "'big'"),
]


@pytest.mark.parametrize(("error", "name", "made", "got"), [*LIGHTS, *AROUND, *CLIPS])
def test_lights_sky_ground_and_clips(error, name, made, got):
    refused(error, name, got, made)


def test_layers():
    refuse(ValueError, "scene", "0", scene=[])
    refuse(ValueError, "scene", "5", scene=[ball() for _ in range(5)])
    refuse(TypeError, "scene", "3", scene=[ball(), 3])
    refused(TypeError, "scene", "4", lambda: gb.Layer(4))
    assert gb.render([ball() for _ in range(4)], CAMERA, (4, 3)).mask.shape == (3, 4)


def test_sizes():
    for error, size, got in (
        (ValueError, (3, -1), "3x-1"),
        (TypeError, "big", "'big'"),
        (TypeError, (1, 2, 3), "(1, 2, 3)"),
        (ValueError, (2**20, 2**20), "1048576x"),
    ):
        refuse(error, "size", got, size=size)
