"""Movies: pictures to H.264 in an MP4 file, by PyAV (the extra `video`).

PyAV's wheel brings FFmpeg with x264, whose licence is the GPL; globule itself neither contains nor
links it.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from ..._base.checks import number, optional
from ..._base.files import atomic_write

CRF = "18"  # x264's constant quality: differences are hardly visible, about 1 MB a second at 720p
FPS = 1e-3, 1e6  # the least and the most frames per second of a movie


def need_av() -> Any:
    """PyAV. Raises MissingPackageError without it."""
    return optional("av", "video", "PyAV")


def write_movie(path: str | os.PathLike[str], pictures: Iterable[Any], fps: float = 30.0) -> int:
    """Write pictures as an MP4 file, H.264, yuv420p, BT.709; it appears whole or not at all.

    An odd width or height gains a copy of its last column or row: yuv420p has even sizes only.

    Args:
        path: name ending in .mp4.
        pictures: (H, W, 3) uint8 sRGB each, all of one size.
        fps: frames per second.

    Returns:
        The number of frames.

    Raises:
        MissingPackageError: PyAV is not installed.
        ValueError: no pictures, or of several sizes.
    """
    av = need_av()
    fps = number("fps", fps, *FPS)
    n = 0
    with atomic_write(path) as file, av.open(file, "w", format="mp4") as movie:
        stream = None
        for picture in pictures:
            picture = even(picture)
            size = (picture.shape[1], picture.shape[0])
            if stream is None:
                stream = _stream(av, movie, size, fps)
            elif size != (stream.width, stream.height):
                was = f"{stream.width}x{stream.height}"
                raise ValueError(f"pictures: expected {was}, got {size[0]}x{size[1]}")
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(
                format="yuv420p", dst_colorspace="ITU709"
            )
            movie.mux(stream.encode(frame))
            n += 1
        if stream is None:
            raise ValueError("pictures: expected at least one, got none")
        movie.mux(stream.encode(None))
    return n


def movie_facts(path: str | os.PathLike[str]) -> tuple[int, tuple[int, int]]:
    """How many frames a movie has, and their width and height; none of a file that is no movie."""
    av = need_av()
    try:
        with av.open(os.fspath(path)) as movie:
            stream = movie.streams.video[0]
            return stream.frames, (stream.width, stream.height)
    except (av.error.FFmpegError, IndexError):  # the first is an OSError or ValueError, too
        return 0, (0, 0)


def read_movie(path: str | os.PathLike[str]) -> Iterator[np.ndarray]:
    """The pictures of a movie of `write_movie`, (H, W, 3) uint8 sRGB each."""
    with need_av().open(os.fspath(path)) as movie:
        for frame in movie.decode(video=0):
            planes = frame.reformat(format="yuv444p").to_ndarray()
            # Not FFmpeg's own conversion to RGB: it rounds down, which would darken a picture
            # every time that it is written and read.
            y, u, v = ((plane - low) / width for plane, low, width in zip(
                planes.astype(np.float32), (16, 128, 128), (219, 224, 224), strict=True
            ))  # fmt: skip
            red, blue = y + 1.5748 * v, y + 1.8556 * u
            green = (y - 0.2126 * red - 0.0722 * blue) / 0.7152
            rgb = np.stack((red, green, blue), axis=-1)
            yield np.rint(255 * np.clip(rgb, 0, 1)).astype(np.uint8)


def even(picture: np.ndarray) -> np.ndarray:
    """The picture (H, W, 3) with its last row and column doubled where H or W is odd."""
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _stream(av: Any, movie: Any, size: tuple[int, int], fps: float) -> Any:
    stream = movie.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
    stream.width, stream.height = size
    stream.pix_fmt = "yuv420p"
    # Without B-frames: with them, x264 gives other bits in one of four runs.
    stream.options = {"crf": CRF, "bf": "0"}
    context = stream.codec_context
    # Without these tags players guess the matrix by the size, and colors shift.
    context.colorspace = context.color_primaries = context.color_trc = 1  # BT.709
    context.color_range = 1  # 16 to 235
    return stream
