"""Files with several frames: each frame of one is a file's name that knows which it stands for."""

from __future__ import annotations


class FrameOf(str):
    """The name of a file, for one of its frames; `read` takes it. Equal to the same frame's only.

    Attributes:
        frame: its number, from 0.
    """

    frame: int

    def __new__(cls, path: str, frame: int) -> FrameOf:
        """The name of a file, and the number of one of its frames."""
        one = super().__new__(cls, path)
        one.frame = frame
        return one

    def __getnewargs__(self) -> tuple[str, int]:  # type: ignore[override]
        return str(self), self.frame  # for pickle and copy

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FrameOf) and self.frame == other.frame and str.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash((str.__hash__(self), self.frame))
