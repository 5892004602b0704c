"""Movies: right number, right size, right colors, and whole or not at all."""

import os
import sys

import numpy as np
import pytest
from globule.formats.pictures.video import need_av, write_movie

try:
    import av
except ImportError:
    av = None

needs_av = pytest.mark.skipif(av is None, reason="PyAV is not installed (the extra `video`)")


def pictures(n: int, width: int, height: int) -> list[np.ndarray]:
    ramp = np.linspace(0, 200, n).astype(np.uint8)
    return [np.full((height, width, 3), (v, 60, 220 - v), np.uint8) for v in ramp]


@needs_av
@pytest.mark.parametrize(("size", "fps"), [((64, 48), 24), ((41, 31), 29.97), ((2, 2), 60), ((1, 1), 25)])
def test_a_movie_holds_its_pictures_and_what_players_need(tmp_path, size, fps):
    made = pictures(7, *size)
    assert write_movie(tmp_path / "a.mp4", iter(made), fps) == 7
    with av.open(str(tmp_path / "a.mp4")) as movie:
        frames = movie.decode(video=0)
        shown = [f.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray() for f in frames]
    width, height = (v + v % 2 for v in size)
    assert len(shown) == 7
    assert all(p.shape == (height, width, 3) for p in shown)
    for before, after in zip(made, shown, strict=True):
        assert np.abs(after.mean((0, 1)) - before.mean((0, 1))).max() < 4
    assert os.listdir(tmp_path) == ["a.mp4"]
    with av.open(str(tmp_path / "a.mp4")) as movie:
        stream = movie.streams.video[0]
        assert float(stream.average_rate) == pytest.approx(fps, rel=1e-3)
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.codec_context.codec.name in ("h264", "libdav1d", "libx264")
        assert stream.codec_context.colorspace == 1


@needs_av
def test_the_same_pictures_make_the_same_bytes(tmp_path):
    """With B-frames, 20 movies of these pictures were up to 8 different files."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:242, :322]
    wave = [128 + 100 * np.sin((x + 3 * k) / 17) * np.cos((y - 2 * k) / 23) for k in range(12)]
    pictures = [np.clip(w[..., None] + rng.normal(0, 3, (242, 322, 3)), 0, 255).astype(np.uint8) for w in wave]
    made = set()
    for _ in range(8):
        write_movie(tmp_path / "a.mp4", pictures, 12)
        made.add((tmp_path / "a.mp4").read_bytes())
    assert len(made) == 1


def test_no_half_movies_and_none_without_pyav(tmp_path, monkeypatch):
    def broken():
        yield from pictures(2, 32, 32)
        raise OSError("gone")

    (tmp_path / "old.mp4").write_bytes(b"old")
    with pytest.raises(OSError, match="gone"):
        write_movie(tmp_path / "old.mp4", broken())
    with pytest.raises(ValueError, match="at least one"):
        write_movie(tmp_path / "new.mp4", [])
    with pytest.raises(ValueError, match="expected 32x32, got 34x32"):
        write_movie(tmp_path / "new.mp4", [*pictures(1, 32, 32), *pictures(1, 34, 32)])
    with pytest.raises(ValueError, match="fps"):
        write_movie(tmp_path / "new.mp4", pictures(1, 32, 32), 0)
    assert (os.listdir(tmp_path), (tmp_path / "old.mp4").read_bytes()) == (["old.mp4"], b"old")
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImportError, match=r"globule\[video\]"):
        need_av()
