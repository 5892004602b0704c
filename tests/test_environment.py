"""Environment images and EXR files: known values, every coding, bad files."""

import sys

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses
from globule.formats import FormatError
from globule.formats.pictures import environment
from globule.formats.pictures.environment import read_environment
from globule.formats.pictures.exr import write_exr
from PIL import Image

HEAD = b"#?RADIANCE\n# made by hand\nFORMAT=32-bit_rle_rgbe\n"


@pytest.fixture
def openexr():
    return pytest.importorskip("OpenEXR", reason="OpenEXR is not installed")


def bright(width: int = 300, height: int = 7) -> np.ndarray:
    """Radiances over twelve orders of magnitude, with black and with long runs."""
    image = np.exp(np.random.default_rng(1).normal(0, 5, (height, width, 3))).astype("f4")
    image[:, width // 5 : width // 2] = image[:, :1]
    image[1] = 0
    return image


def rgbe(image: np.ndarray) -> np.ndarray:
    largest = image.max(axis=2)
    fraction, exponent = np.frexp(largest)
    scale = np.where(largest > 0, fraction * 256 / np.maximum(largest, 1e-30), 0)
    pixels = np.zeros((*largest.shape, 4), np.uint8)
    pixels[..., :3] = image * scale[..., None]
    pixels[..., 3] = np.where(largest > 0, exponent + 128, 0)
    return pixels


def runs(values: np.ndarray) -> bytes:
    """One plane of a row: runs of 3 or more, dumps else."""
    out, i, n = b"", 0, len(values)
    ends = np.flatnonzero(np.diff(values)) + 1
    for end in [*ends.tolist(), n]:
        while i < end:
            length = min(end - i, 127)
            if length > 2:
                out += bytes((128 + length, values[i]))
            else:
                out += bytes((length,)) + values[i : i + length].tobytes()
            i += length
    return out


def hdr(image: np.ndarray, coding: str, head: bytes = HEAD) -> bytes:
    height, width = image.shape[:2]
    pixels = rgbe(image)
    start = bytes((2, 2, width >> 8, width & 255))
    if coding == "flat":
        data = pixels.tobytes()
    elif coding == "runs":
        rows = (b"".join(runs(row[:, c]) for c in range(4)) for row in pixels)
        data = b"".join(start + row for row in rows)
    else:  # old runs: (1, 1, 1, n), low digit first
        flat, data = pixels.reshape(-1, 4), b""
        ends = np.flatnonzero((np.diff(flat.astype(int), axis=0) != 0).any(axis=1)) + 1
        for begin, end in zip([0, *ends], [*ends, len(flat)], strict=True):
            data += flat[begin].tobytes()
            n = end - begin - 1
            while n:
                data += bytes((1, 1, 1, n & 255))
                n >>= 8
    return head + b"\n-Y %d +X %d\n" % (height, width) + data


@pytest.mark.parametrize("coding", ["flat", "runs", "old"])
def test_hdr(coding, tmp_path):
    (tmp_path / "a.hdr").write_bytes(hdr(bright(), coding))
    image = read_environment(tmp_path / "a.hdr")
    assert image.dtype == np.float32
    assert image.shape == (7, 300, 3)
    largest = bright().max(axis=2, keepdims=True)
    assert (np.abs(image - bright()) <= largest / 256 + 1e-30).all()
    assert (image[1] == 0).all()


def test_hdr_exposure_and_orientation(tmp_path):
    plain, image = tmp_path / "a.hdr", bright(20)
    plain.write_bytes(hdr(image, "runs"))
    expected = read_environment(plain)
    data = hdr(image, "flat", HEAD + b"EXPOSURE=2\nEXPOSURE= 0.25\n")
    plain.write_bytes(data.replace(b"-Y 7 +X 20", b"+Y 7 -X 20"))
    assert np.allclose(read_environment(plain), 2 * expected[::-1, ::-1], rtol=1e-6)


def test_exr(openexr, tmp_path):
    image = bright()
    write_exr(tmp_path / "a.exr", {"color": image, "Z": np.full(image.shape[:2], np.inf)})
    assert np.array_equal(read_environment(tmp_path / "a.exr"), image)
    half = np.minimum(image[..., 0], 6e4).astype("f2")
    write_exr(tmp_path / "gray.exr", {"Y": half})
    assert (read_environment(tmp_path / "gray.exr") == half[..., None]).all()
    image[0, 0, 0] = -1
    write_exr(tmp_path / "a.exr", {"color": image})
    assert read_environment(tmp_path / "a.exr")[0, 0, 0] == 0
    image[2, 5, 1] = np.nan
    write_exr(tmp_path / "a.exr", {"color": image})
    with pytest.raises(FormatError, match="row 2, column 5: expected finite radiance"):
        read_environment(tmp_path / "a.exr")


def test_exr_of_a_frame(openexr, tmp_path):
    scene = gb.Scene(gb.Particles(np.eye(3)), device="cpu")
    frame = gb.render(scene, size=(40, 30))
    frame.save(tmp_path / "a.exr")
    with openexr.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        planes = {name: channel.pixels for name, channel in file.channels().items()}
    assert np.array_equal(np.stack([planes[c] for c in "RGB"], axis=2), frame.color)
    assert np.array_equal(planes["Z"], frame.distance)
    assert np.array_equal(planes["normal.Y"], frame.normal[..., 1])
    assert np.array_equal(planes["albedo.B"], frame.albedo[..., 2])
    assert np.array_equal(planes["position.X"], frame.position[..., 0], equal_nan=True)
    assert [file.name for file in tmp_path.iterdir()] == ["a.exr"]


def test_exr_refuses_images_of_different_sizes(openexr, tmp_path):
    for channels in ({"a": np.zeros((2, 2)), "b": np.zeros((2, 3))}, {}, {"a": np.zeros(3)}):
        refuses("channels: expected", write_exr, tmp_path / "a.exr", channels)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("extension", [".png", ".jpg"])
def test_pictures_become_linear(extension, tmp_path):
    picture = np.zeros((8, 16, 3), np.uint8)
    picture[:, 8:] = 188
    Image.fromarray(picture).save(tmp_path / f"a{extension}", quality=100)
    image = read_environment(tmp_path / f"a{extension}")
    assert image.shape == (8, 16, 3)
    assert (image[:, :7] < 1e-3).all()
    assert np.allclose(image[:, 10:], 0.5, atol=0.01)  # sRGB 188 is half of white


def test_bad_hdr(tmp_path):
    for data, what in (
        (b"nonsense", "expected '#\\?RADIANCE'"),
        (HEAD, "an empty line and the size"),
        (HEAD + b"\n-Y 0 +X 5\n", "expected a size like"),
        (HEAD + b"EXPOSURE=nan\n\n-Y 1 +X 1\n0000", "an exposure above 0"),
        (HEAD.replace(b"rgbe", b"xyze") + b"\n-Y 1 +X 1\n0000", "expected 32-bit_rle_rgbe"),
        (HEAD + b"\n-Y 999999999 +X 999999999\n", "at most 134,217,728 pixels"),
        (HEAD + b"\n-Y 10000 +X 10000\n\x02\x02\x27\x10", "expected at (least|most)"),
        (HEAD + b"\n-Y 10000 +X 10000\n", "expected at most 200 times the 68 bytes"),
        (HEAD + b"\n-Y 1 +X 2\n\1\1\1\7", "expected 2 pixels, got 7"),
        (HEAD + b"\n-Y 1 +X 2\n" + b"\x80\x80\x80\x80" + 9 * b"\1\1\1\xff", "expected 2 pixels"),
        (HEAD + b"\n-Y 1 +X 8\n\2\2\0\x08" + 40 * b"\xff", "row 0: expected 8 pixels"),
        (HEAD + b"\n-Y 1 +X 8\n\2\2\0\x09" + 40 * b"\x88", "row 0: expected the start"),
    ):
        (tmp_path / "a.hdr").write_bytes(data)
        with pytest.raises(FormatError, match=what) as caught:
            read_environment(tmp_path / "a.hdr")
        assert "\n" not in str(caught.value)
        assert "a.hdr" in str(caught.value)


def test_other_files(tmp_path, monkeypatch):
    Image.new("RGB", (3, 3)).save(tmp_path / "a.png", "TIFF")
    with pytest.raises(FormatError, match=r"expected an environment image .*, got tiff"):
        read_environment(tmp_path / "a.png")
    Image.new("RGB", (3, 3)).save(tmp_path / "no-ending", "PNG")
    assert read_environment(tmp_path / "no-ending").shape == (3, 3, 3)
    (tmp_path / "a.png").unlink()
    for name in ("a.hdr", "a.png"):
        with pytest.raises(FileNotFoundError):
            read_environment(tmp_path / name)
    monkeypatch.setattr(environment, "MOST_PIXELS", 100)
    Image.new("RGB", (11, 10)).save(tmp_path / "a.png")
    refuses("at most 100 pixels, got 11x10", read_environment, tmp_path / "a.png", error=FormatError)


def test_without_openexr(monkeypatch, tmp_path):
    assert issubclass(gb.MissingPackageError, ImportError)
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    (tmp_path / "a.exr").write_bytes(b"\x76\x2f\x31\x01")
    for work in (
        lambda: read_environment(tmp_path / "a.exr"),
        lambda: write_exr(tmp_path / "a.exr", {"Z": np.zeros((2, 2))}),
    ):
        refuses(r'OpenEXR .* install "globule\[formats', work, error=gb.MissingPackageError)
