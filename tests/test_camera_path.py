"""Cameras that move: through their keys, without jumps, and a clear word about wrong keys."""

import json

import numpy as np
import pytest
from cli_helpers import refuses
from globule import Camera, CameraPath, orbit

KEYS = [
    {"frame": 0, "eye": [0, 0, 5], "look_at": [0, 0, 0]},
    {"frame": 10, "eye": [5, 1, 0], "fov": 30},
    {"frame": 40, "eye": [0, 2, -5], "look_at": [0, 1, 0], "up": [0, 0, 1]},
    {"frame": 50, "eye": [-5, 1, 0], "fov": 50},
]


@pytest.mark.parametrize("interpolation", ["smooth", "linear"])
def test_a_path_goes_through_its_keys(interpolation):
    path = CameraPath(KEYS, interpolation=interpolation)
    assert path.n_frames == 51
    state = {"up": (0, 1, 0), "fov": 40}
    for key in KEYS:
        state.update(key)
        at = path(key["frame"])
        for name in ("eye", "look_at", "up", "fov"):
            assert getattr(at, name) == pytest.approx(state[name])
    assert path(-3) == path(0)
    assert path(99) == path(50)


def test_linear_is_straight_and_two_keys_are_too():
    for path in (CameraPath(KEYS, interpolation="linear"), CameraPath(KEYS[:2])):
        assert path(5).eye == pytest.approx((2.5, 0.5, 2.5))
        assert path(5).fov == pytest.approx(35)


@pytest.mark.slow
def test_a_smooth_path_has_no_jump_in_place_or_speed():
    path = CameraPath(KEYS)
    step = 0.01
    eyes = np.array([path(f).eye for f in np.arange(0, 50, step)])
    speed = np.diff(eyes, axis=0) / step
    assert np.abs(np.diff(eyes, axis=0)).max() < 0.02
    assert np.abs(np.diff(speed, axis=0)).max() < 0.02  # a corner would be a jump of about 0.5


def test_centripetal_curves_do_not_overshoot_close_keys():
    """The case that makes a loop with uniform knots: two keys close together between far ones."""
    x = [0.0, 10.0, 10.1, 20.0]
    keys = [{"frame": 10 * i, "eye": [v, 0, 5], "look_at": [v, 0, 0]} for i, v in enumerate(x)]
    eyes = np.array([CameraPath(keys)(f).eye[0] for f in np.linspace(0, 30, 500)])
    assert (np.diff(eyes) >= -1e-9).all()


def test_a_repeated_key_holds_the_camera_still():
    keys = [*KEYS[:2], {**KEYS[1], "frame": 20}, {**KEYS[2], "frame": 40}]
    path = CameraPath(keys)
    held = {path(f).eye for f in np.linspace(10, 20, 30)}
    assert np.ptp(np.array(sorted(held)), axis=0) == pytest.approx(0)


def test_times_and_files(tmp_path):
    toml, listed = tmp_path / "p.toml", tmp_path / "p.json"
    toml.write_text(
        'interpolation = "linear"\n'
        "[[key]]\ntime = 0\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n"
        "[[key]]\ntime = 2\neye = [4, 0, 5]\n"
    )
    path = CameraPath.load(toml, fps=25)
    assert path.n_frames == 51
    assert path(25).eye == pytest.approx((2, 0, 5))
    listed.write_text(json.dumps(KEYS))
    assert CameraPath.load(listed)(20) == CameraPath(KEYS)(20)


def test_wrong_keys(tmp_path):
    for keys, parts in (
        ([], ["key", "list"]),
        ([{"eye": [0, 0, 1], "look_at": [0, 0, 0]}], ["key 1", "frame or time"]),
        ([KEYS[0], {"time": 3}], ["key 2", "expected frame", "got time"]),
        ([{"frame": 0, "eye": [0, 0, 1]}], ["key 1", "look_at"]),
        ([KEYS[0], {"frame": 4, "eye": [1, 2]}], ["key 2", "eye", "[1, 2]"]),
        ([KEYS[0], {"frame": 4, "eye": "abc"}], ["key 2", "eye", "'abc'"]),
        ([KEYS[0], {"frame": 4, "fov": 200}], ["key 2", "fov", "200"]),
        ([KEYS[0], {"frame": 4, "fov": True}], ["key 2", "fov", "True"]),
        ([KEYS[0], KEYS[0]], ["key 2", "frame", "more than"]),
        ([KEYS[0], {"frame": 4, "eyes": [1, 2, 3]}], ["key 2", "eyes"]),
        ([KEYS[0], {"frame": 4, "eye": [0, 0, 0]}], ["key 2", "look_at"]),
        ([KEYS[0], 7], ["key 2", "7"]),
    ):
        with pytest.raises(ValueError, match=parts[0]) as error:
            CameraPath(keys)
        assert all(part in str(error.value) for part in parts), error.value
        path = tmp_path / "p.json"
        path.write_text(json.dumps(keys))
        with pytest.raises(ValueError, match=r"p\.json: ") as error:
            CameraPath.load(path)
        assert parts[0] in str(error.value)


@pytest.mark.parametrize(
    ("name", "text"), [("p.toml", "key ="), ("p.json", "{"), ("p.txt", ""), ("p.json", '{"keys": []}')]
)
def test_wrong_files(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    refuses(name, CameraPath.load, tmp_path / name)


def test_orbit_is_a_circle_that_closes():
    start = Camera((3, 2, 0), (0, 1, 0), fov=30)
    cameras = orbit(start, 1, 8)
    eyes = np.array([c.eye for c in cameras])
    assert cameras[0] == start
    assert len(cameras) == 8
    assert np.hypot(eyes[:, 0], eyes[:, 2]) == pytest.approx(3)
    assert (eyes[:, 1] == 2).all()
    assert eyes[2] == pytest.approx((0, 2, -3))  # anticlockwise from above
    steps = np.linalg.norm(np.roll(eyes, -1, axis=0) - eyes, axis=1)
    assert steps == pytest.approx(steps[0])
    refuses("n: ", orbit, start, 1, 0)


@pytest.mark.parametrize("unit", ["time", "frame"])
@pytest.mark.parametrize("last", [1e308, 1e18, 2**31, 2**63, 10**22, 1_000_000])
def test_movies_without_end_are_refused(unit, last):
    keys = [{unit: 0, "eye": [2, 2, 2], "look_at": [0, 0, 0]}, {unit: last}]
    refuses(f"key 2: {unit}: expected at most 1,000,000 frames, got", CameraPath, keys)
    assert CameraPath([keys[0], {unit: 30_000}]).n_frames == 30_000 * (30 if unit == "time" else 1) + 1
