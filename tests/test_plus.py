"""PLUS-exact reconstruction: PLUS' own reference volumes, its arithmetic pixel by pixel."""

import functools
import itertools
from pathlib import Path

import globule as gb
import numpy as np
import plus_reference
import pytest
from globule.cli import main
from globule.formats import FormatError
from globule.ultrasound.plus.config import Filler, PlusConfig, read_plus_config
from globule.ultrasound.plus.fan import detect_fan
from globule.ultrasound.plus.reconstruct import _box, _voxel_from_image, reconstruct_plus
from globule.ultrasound.plus.region import pixel_sources
from sweep_helpers import spine_data
from test_reconstruct import make_sweep


@pytest.mark.few_backends
@pytest.mark.parametrize("name", [
    "LNMEAN", "NNMEAN", "NNLATE", *(pytest.param(name, marks=pytest.mark.slow) for name in ("LNMAXI", "RECON")),
])  # fmt: skip
def test_public_references(backend, name):
    data = spine_data()
    reference = gb.volumes.read_volume(data / f"{name}.reference.mha")
    sweep = gb.ultrasound.read_sweep(data / "SpinePhantomFreehand.igs.mha", plus=data / f"{name}.xml")
    volume = reconstruct_plus(sweep, data / f"{name}.xml", **backend)
    slab = tuple(slice(n) for n in reference.shape)
    if name == "RECON":  # comes from an older PLUS, which rounded the number of voxels down
        older = reconstruct_plus(sweep, data / f"{name}.xml", extent="floor", **backend)
        np.testing.assert_array_equal(older.values, reference.values)
    else:
        assert reference.shape == volume.shape
    assert np.count_nonzero(volume.values[slab] != reference.values) == 0
    # PLUS writes the origin with six digits.
    np.testing.assert_allclose(volume.world_from_voxel, reference.world_from_voxel, atol=1e-3)


def sweep_and_config(dtype, **settings):
    sweep = make_sweep(n=4, shape=(14, 17), dtype=dtype, gap=1.1)
    if dtype == np.float32:
        sweep.frames = np.abs(sweep.frames)
    if dtype == np.uint16:
        sweep.frames //= 256  # products beyond 32 bits are undefined in PLUS
    return sweep, PlusConfig((1.0, 0.9, 1.1), **settings)


def expected(sweep, config, importance=None):
    shape = sweep.frames.shape[1:]
    origin, spacing, size = _box(config, [m.tolist() for m in sweep.world_from_image], shape, "round")
    matrices = _voxel_from_image([m.tolist() for m in sweep.world_from_image], origin, spacing)
    sources = pixel_sources(config, shape, config.fan_angles, importance)
    values, acc = plus_reference.insert(config, sweep.frames, matrices, size, sources, importance)
    return plus_reference.fill(config.fillers, values, acc) if config.fill_holes else values, acc


def random_filler(rng):
    """A hole filler of any kind with sizes that the oracle takes in short time."""
    kind = rng.choice([
        "STICK", "NEAREST_NEIGHBOR", "GAUSSIAN", "GAUSSIAN_ACCUMULATION", "DISTANCE_WEIGHT_INVERSE",
    ])  # fmt: skip
    if kind == "STICK":
        return Filler("STICK", int(rng.integers(2, 13)), int(rng.integers(1, 4)))
    size, least = int(rng.choice([3, 4, 5, 5, 9])), float(rng.choice([0.0, 0.02, 0.3]))
    if kind.startswith("GAUSSIAN"):
        return Filler(str(kind), size, deviation=float(rng.uniform(0.5, 2)), least_ratio=least)
    return Filler(str(kind), size, least_ratio=least)


@functools.cache
def configurations(dtype, interpolation):
    """Every optimization and compounding, all other settings of PLUS drawn at random: sweep,
    configuration, importance mask, and the oracle's values and accumulator."""
    made = []
    for optimization, compounding in itertools.product(
        ("NONE", "PARTIAL", "FULL"), ("LATEST", "MAXIMUM", "MEAN", "IMPORTANCE_MASK")
    ):
        rng = np.random.default_rng([len(made), len(interpolation), np.dtype(dtype).itemsize])
        x, y = int(rng.integers(0, 5)), int(rng.integers(0, 4))
        sweep, config = sweep_and_config(
            dtype, interpolation=interpolation, optimization=optimization,
            compounding=compounding, clip_origin=(x, y),
            clip_size=(int(rng.integers(4, 18 - x)), int(rng.integers(4, 15 - y))),
            rejection=float(rng.choice([0.0, 0.0, 30.0, 90.0])), fill_holes=bool(rng.integers(2)),
        )  # fmt: skip
        config.spacing = tuple(float(s) for s in rng.uniform(0.6, 2.5, 3))
        config.fillers = [random_filler(rng) for _ in range(rng.integers(1, 4))]
        if rng.integers(2):
            config.fan_angles = (float(rng.uniform(-80, -10)), float(rng.uniform(10, 80)))
            config.fan_origin = (float(rng.uniform(4, 12)), float(rng.uniform(-8, 0)))
            config.fan_start, config.fan_stop = float(rng.uniform(0, 5)), float(rng.uniform(12, 22))
        importance = rng.integers(0, 256, (14, 17), np.uint8)
        importance[4, 3:6] = 0
        mask = importance if compounding == "IMPORTANCE_MASK" else None
        sweep.world_from_image[:, 2, 3] *= float(rng.uniform(0.5, 3))
        made.append((sweep, config, mask, *expected(sweep, config, mask)))
    return made


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("interpolation", ["NEAREST_NEIGHBOR", "LINEAR"])
def test_every_configuration_is_the_oracle_s(backend, dtype, interpolation):
    filled = set()
    for sweep, config, mask, values, acc in configurations(dtype, interpolation):
        volume = reconstruct_plus(sweep, config, importance_mask=mask, **backend)
        np.testing.assert_array_equal(volume.values, values, err_msg=str(config))
        if not config.fill_holes:
            np.testing.assert_array_equal(volume.info["accumulator"], acc, err_msg=str(config))
        filled.add(config.fill_holes)
    assert filled == {True, False}


def test_saturated_accumulator(backend):
    """More than 255 pixels in a voxel: a recursive filter instead of the mean."""
    for optimization, interpolation in itertools.product(("NONE", "FULL"), ("NEAREST_NEIGHBOR", "LINEAR")):
        sweep, config = sweep_and_config(np.uint8, optimization=optimization, interpolation=interpolation)
        config.spacing = (6.0, 6.0, 6.0)
        volume = reconstruct_plus(sweep, config, **backend)
        values, acc = expected(sweep, config)
        np.testing.assert_array_equal(volume.values, values)
        np.testing.assert_array_equal(volume.info["accumulator"], acc)


def test_skip_invalid_frames_and_fan_detection():
    sweep, config = sweep_and_config(np.uint8)
    sweep.valid[2] = False
    config.skip = 2
    volume = reconstruct_plus(sweep, config, device="cpu")
    alone = make_sweep(n=4, shape=(14, 17), gap=1.1)
    alone.valid[1:] = False
    # Frames 0, 2 (invalid): the box is that of all valid frames, the pixels those of frame 0.
    first = reconstruct_plus(alone, config, device="cpu")
    assert volume.n_measured == first.n_measured < volume.values.size
    assert volume.info["frames"] == 1
    config = PlusConfig((1, 1, 1), fan_angles=(-45, 45), fan_origin=(100, -20), fan_start=20, fan_stop=220)
    j, i = np.indices((200, 200))
    angle = np.degrees(np.arctan2(i - 100, j + 20))
    low, high = detect_fan(config, np.where((angle > -30) & (angle < 25), 120, 5).astype(np.uint8))
    # The window, 20 pixels long, opens early and closes late; then 3 degrees are taken off.
    assert -42 < low < -26
    assert 21 < high < 36
    assert detect_fan(config, np.zeros((200, 200), np.uint8)) is None


XML = """<PlusConfiguration><VolumeReconstruction {}>{}</VolumeReconstruction></PlusConfiguration>"""


def test_configuration(tmp_path):
    path = tmp_path / "config.xml"
    path.write_text(
        XML.format(
            'OutputSpacing="0.1 0.2 0.3" Interpolation="Linear" Optimization="Partial" '
            'CompoundingMode="Importance_Mask" ImportanceMaskFilename="mask.png" FillHoles="ON" '
            'PixelRejectionThreshold="12" SkipInterval="3"',
            '<HoleFilling><HoleFillingElement Type="Gaussian" Size="5" Stdev="0.7" '
            'MinimumKnownVoxelsRatio="0.4"/></HoleFilling>',
        )
    )
    config = read_plus_config(path)
    assert (config.spacing, config.interpolation, config.optimization) == ((0.1, 0.2, 0.3), "LINEAR", "PARTIAL")
    assert (config.compounding, config.importance_file) == ("IMPORTANCE_MASK", str(tmp_path / "mask.png"))
    assert (config.fillers, config.rejection, config.skip) == ([Filler("GAUSSIAN", 5, 1, 0.7, 0.4)], 12, 3)


STICKS = '<HoleFilling>\n<HoleFillingElement Type="STICK" NumberOfSticksToUse="1"/></HoleFilling>'


@pytest.mark.parametrize(("text", "message"), [
    ('<!DOCTYPE x [<!ENTITY a "b">]>\n<PlusConfiguration/>', "line 1: expected a DOCTYPE"),
    ("<PlusConfiguration>\n<a>\n</PlusConfiguration>", "line 3, column 3: expected XML"),
    ("\n<PlusConfiguration/>", "line 2: expected an element VolumeReconstruction, got none"),
    (XML.format("", ""), "line 1, VolumeReconstruction: expected OutputSpacing, got none"),
    (XML.format('\nOutputSpacing="1 1 x"', ""), "line 1, OutputSpacing: expected 3"),
    (XML.format('OutputSpacing="1 1"', ""), "line 1, OutputSpacing: expected 3 numbers"),
    (XML.format('OutputSpacing="1 1 0"', ""), "line 1, OutputSpacing: expected 1e-06 to"),
    (XML.format('OutputSpacing="1 1 1" Interpolation="CUBIC"', ""), "line 1, Interpolation: expected NEAREST"),
    (XML.format('OutputSpacing="1 1 1" FillHoles="ON"', ""),
     "line 1, FillHoles: expected a HoleFillingElement for ON, got none"),
    (XML.format('OutputSpacing="1 1 1" FillHoles="ON"', STICKS),
     "line 2, HoleFillingElement STICK: expected StickLengthLimit, got none"),
])  # fmt: skip
def test_mistakes_name_the_line(text, message, tmp_path):
    path = tmp_path / "c.xml"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        read_plus_config(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_importance_mask_is_needed():
    sweep, config = sweep_and_config(np.uint8, compounding="IMPORTANCE_MASK")
    with pytest.raises(ValueError, match=r"importance_mask: .* expected a mask, got none"):
        reconstruct_plus(sweep, config)
    with pytest.raises(ValueError, match="importance_mask: expected shape"):
        reconstruct_plus(sweep, config, importance_mask=np.ones((3, 3), np.uint8))


@pytest.mark.parametrize(("attributes", "message"), [
    ('ClipRectangleOrigin="0 0" ClipRectangleSize="0 0"', None),
    ('ClipRectangleOrigin="-3 -2" ClipRectangleSize="9 8"', None),
    ('FanAngles="-40 30" FanOrigin="8 -2" FanDepth="30"', None), ('FanAnglesDeg="-40 30"', None),
    ('OutputExtent="0 9 0 9 0 9" OutputOrigin="1 2 3" NumberOfThreads="3"', None),
    ('CompoundingMode="IMPORTANCE_MASK" ImportanceMaskFilename="nope.png"', "nope.png"),
    ('CompoundingMode="IMPORTANCE_MASK" ImportanceMaskFilename="c.xml"', "c.xml"),
    ('CompoundingMode="IMPORTANCE_MASK"', "importance_mask"),
    ('ClipRectangleOrigin="90 0" ClipRectangleSize="5 5"', "region"),
    ('FanAnglesDeg="-40 30" FanRadiusStopPixel="0"', "fan"),
])  # fmt: skip
def test_what_the_command_makes_of_a_configuration(folder, capsys, attributes, message):
    made = make_sweep(n=4, shape=(14, 17), gap=1.1)
    gb.ultrasound.write_sweep("s.igs.mha", gb.ultrasound.Sweep(made.frames, made.world_from_image))
    Path("c.xml").write_text(XML.format(f'OutputSpacing="1 0.9 1.1" {attributes}', ""), encoding="utf-8")
    words = ["reconstruct", "s.igs.mha", "--plus", "c.xml", "-o", "v.mha", "--device", "cpu"]
    status, err = main(words), capsys.readouterr().err
    if message:
        assert status == 2
        assert message in err
        assert err.count("\n") == 1
        assert not Path("v.mha").exists()
        return
    assert (status, err) == (0, "")
    values, _ = expected(gb.ultrasound.read_sweep("s.igs.mha", plus="c.xml"), read_plus_config("c.xml"))
    np.testing.assert_array_equal(gb.volumes.read_volume("v.mha").values, values)
