"""JPEG of the viewer: strips are the same image as one piece."""

from __future__ import annotations

import io

import numpy as np
import pytest
from globule.viewer import encode
from PIL import Image

simplejpeg = pytest.importorskip("simplejpeg")


def waves(width: int, height: int) -> np.ndarray:
    """An image whose every block differs from its neighbors."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    noise = np.random.default_rng(3).integers(0, 60, (height, width))
    bands = [90 * np.sin(x / 9 + k) * np.cos(y / 13) + 100 + noise for k in range(3)]
    return np.stack(bands, axis=-1).astype(np.uint8)


@pytest.mark.parametrize("sharp", [False, True])
@pytest.mark.parametrize("size", [(1280, 720), (1001, 777), (523, 1409)])
def test_strips_are_the_same_image_as_one_piece(size, sharp):
    picture = waves(*size)
    sampling = "444" if sharp else "420"
    one = simplejpeg.encode_jpeg(picture, 85, "RGB", sampling, fastdct=True)
    strips = encode.jpeg(picture, 85, sharp)
    assert b"\xff\xdd\x00\x04" in strips  # restart interval: there are strips
    assert b"\xff\xdd\x00\x04" not in one
    for decode in (lambda data: np.asarray(Image.open(io.BytesIO(data))), simplejpeg.decode_jpeg):
        assert np.array_equal(decode(strips), decode(one))
    assert encode.jpeg(picture, 85, sharp) == strips


def test_a_small_image_is_one_piece():
    picture = waves(640, 360)
    assert b"\xff\xdd\x00\x04" not in encode.jpeg(picture, 85)


def test_a_file_without_a_scan_is_refused():
    with pytest.raises(ValueError, match="expected a segment"):
        encode.joined([b"\xff\xd8\xff\xd9"], 8, 1)
