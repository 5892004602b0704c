from collections.abc import Sequence
from typing import Annotated

import numpy
from numpy.typing import NDArray

class SweepFrames:
    def __init__(
        self,
        values: tuple[int, int, int],
        type: int,
        shape: Sequence[int],
        poses: object,
        mask: object | None,
        first_order: int,
    ) -> None: ...

class SweepGrid:
    def __init__(self, arg0: str, arg1: int, /) -> None: ...
    def start(self, arg0: int, arg1: int, arg2: bool, arg3: float, arg4: Sequence[int], /) -> None: ...
    def grow(self, arg0: Sequence[int], arg1: Sequence[int], /) -> None: ...
    def add(self, arg0: SweepFrames, arg1: int, /) -> None: ...
    def median(self, arg: SweepFrames, /) -> None: ...
    def bezier(self, arg: SweepFrames, /) -> None: ...
    def fill(
        self,
        method: int,
        frames: SweepFrames | None,
        reach: int,
        weights: numpy.ndarray | None,
        kind: int,
        extrapolate: bool,
        max_gap: float,
        values: numpy.ndarray | None = ...,
        radius: numpy.ndarray | None = ...,
        spread: numpy.ndarray | None = ...,
        contrast: numpy.ndarray | None = ...,
    ) -> None: ...
    def filled(self) -> tuple: ...
    def read_filled(
        self,
        first: Sequence[int],
        size: Sequence[int],
        values: numpy.ndarray | None = ...,
        radius: numpy.ndarray | None = ...,
    ) -> None: ...
    def count_map(self, arg: numpy.ndarray, /) -> None: ...
    def variance_map(self, arg0: SweepFrames, arg1: numpy.ndarray, /) -> None: ...
    def source_map(self, arg0: int, arg1: numpy.ndarray, /) -> None: ...
    def facts(self) -> dict: ...
    def free_bytes(self) -> int: ...
    def plus(self, arg: dict, /) -> tuple[float, float]: ...

class Tissue:
    def __init__(self, arg0: str, arg1: int, /) -> None: ...
    def add(
        self,
        positions: numpy.ndarray,
        ids: numpy.ndarray,
        inverse_mass: numpy.ndarray,
        hold: numpy.ndarray,
        phase: numpy.ndarray,
        offsets: numpy.ndarray,
        other: numpy.ndarray,
        length: numpy.ndarray,
        stiffness: numpy.ndarray,
        bound: numpy.ndarray,
        contact: float,
        lame: numpy.ndarray | None = ...,
        frequency: float = ...,
        relaxation: numpy.ndarray | None = ...,
    ) -> None: ...
    def materials(self, arg: Sequence[Sequence[float]], /) -> None: ...
    def instruments(self, arg0: Sequence[Sequence[Sequence[float]]], arg1: list, /) -> None: ...
    def advance(self, arg0: float, arg1: Sequence[float], arg2: int, arg3: int, /) -> int: ...
    def tear(self, arg: float, /) -> int: ...
    def follow(self) -> None: ...
    def cut(self, arg0: numpy.ndarray, arg1: numpy.ndarray, arg2: int, /) -> int: ...
    def pieces(self) -> int: ...
    def grasp(self, arg0: Sequence[float], arg1: float, arg2: int, /) -> None: ...
    def remove(self, arg: object, /) -> int: ...
    def felt(self) -> list[float]: ...
    def n(self) -> int: ...
    def n_bonds(self) -> int: ...
    def elastic_energy(self) -> float: ...
    def substeps(self, arg: float, /) -> int: ...
    def get(
        self,
        positions: numpy.ndarray | None = ...,
        velocities: numpy.ndarray | None = ...,
        piece: numpy.ndarray | None = ...,
        hold: numpy.ndarray | None = ...,
        ids: numpy.ndarray | None = ...,
    ) -> None: ...
    def accelerate(self, arg: numpy.ndarray, /) -> None: ...
    def set(self, positions: numpy.ndarray | None = ..., velocities: numpy.ndarray | None = ...) -> None: ...
    def set_vessel(self, arg0: int, arg1: float, arg2: float, arg3: int, /) -> None: ...
    def pools(self) -> list[float]: ...
    def arrays(self) -> dict: ...
    def write(self, arg0: str, arg1: numpy.ndarray, /) -> None: ...

class Look:
    def __init__(self, arg: dict, /) -> None: ...
    def with_edges(self, arg: int, /) -> Look: ...
    def reaching(self, arg: float, /) -> Look: ...

class Material:
    def __init__(self, arg: dict, /) -> None: ...

class View:
    def __init__(
        self,
        frame: Sequence[float],
        width: int,
        height: int,
        orthographic: bool,
        share: tuple[int, int, int, int, bool] = ...,
    ) -> None: ...

class Clip:
    def __init__(self, arg0: int, arg1: bool, arg2: Sequence[float], arg3: Sequence[float], /) -> None: ...

class Thesis:
    def __init__(
        self,
        arg0: int,
        arg1: float,
        arg2: int,
        arg3: bool,
        arg4: bool,
        arg5: bool,
        arg6: bool,
        arg7: bool,
        arg8: bool,
        /,
    ) -> None: ...

def pack_squares(
    arg0: View,
    arg1: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")],
    arg2: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")],
    /,
) -> None:
    """
    The squares of an image that the view's rank has made, one after the other.
    """

def unpack_squares(
    arg0: View,
    arg1: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")],
    arg2: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")],
    /,
) -> None:
    """The reverse."""

def nearest_pixels(
    arg0: Sequence[Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")]],
    arg1: Sequence[Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")]],
    arg2: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    arg3: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")],
    /,
) -> None:
    """
    Of each pixel the nearest of several images: (n,) depths, (3 n,) bytes; the first of equals.
    """

def pack_hits(
    arg0: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    arg1: int,
    arg2: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    arg3: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    arg4: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    arg5: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")],
    arg6: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    /,
) -> None:
    """
    Rows of 9 for rays (K,): the number as an int32's bits, t, normal, albedo, layer.
    """

def put_hits(
    arg0: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    arg1: int,
    arg2: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    arg3: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    arg4: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    arg5: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")],
    /,
) -> None:
    """
    What `pack_hits` has packed, where it is nearer than what is there; the first of equals.
    """

version: str = ...

limits: dict = ...

kernels: dict = ...

def cpu_backends() -> list[str]: ...
def stop_at_poll(poll: int | None) -> None: ...
def n_polls() -> int: ...
def dlpack_view(arg: Annotated[NDArray, dict(writable=False)], /) -> tuple: ...
def crc64(arg0: int, arg1: int, arg2: int, /) -> int: ...
def axes_of(arg0: int, arg1: int, /) -> list: ...
def describe(arg0: str, arg1: int, /) -> tuple: ...
def let_wait(arg0: int, arg1: int, /) -> None: ...
def gpu_array(arg0: int, arg1: Sequence[int], arg2: int, arg3: int, arg4: int, arg5: object, /) -> NDArray: ...
def morton(arg0: int, arg1: str, arg2: Sequence[int], /) -> object: ...

class Frame:
    def depth(self, arg0: int, arg1: int, /) -> NDArray[numpy.float32]: ...
    def normal(self, arg0: int, arg1: int, /) -> NDArray[numpy.float32]: ...
    def albedo(self, arg0: int, arg1: int, /) -> NDArray[numpy.float32]: ...
    def color(self, arg0: int, arg1: int, /) -> NDArray[numpy.float32]: ...
    def position(self, arg0: int, arg1: int, /) -> NDArray[numpy.float32]: ...
    def picture(self, arg0: int, arg1: int, /) -> NDArray[numpy.uint8]: ...
    def layer(self, arg0: int, arg1: int, /) -> NDArray[numpy.uint8]: ...
    def passes(self) -> int: ...
    def trace_seconds(self) -> float: ...

class Scene:
    def __init__(self, arg0: str, arg1: int, arg2: int, /) -> None: ...
    def build(
        self,
        arg0: int,
        arg1: tuple[int, int, int],
        arg2: tuple[int, int, int],
        arg3: float,
        arg4: tuple[int, int, int],
        arg5: float,
        arg6: tuple[int, int, int],
        arg7: Sequence[float],
        arg8: tuple[int, int, int],
        arg9: float,
        arg10: tuple[int, int, int],
        arg11: float,
        arg12: tuple[int, int, int],
        arg13: float,
        arg14: float,
        arg15: int,
        arg16: int,
        arg17: bool,
        arg18: Sequence[float],
        arg19: bool,
        /,
    ) -> None: ...
    def build_mesh(
        self,
        arg0: int,
        arg1: tuple[int, int, int],
        arg2: int,
        arg3: tuple[int, int, int],
        arg4: tuple[int, int, int],
        arg5: tuple[int, int, int],
        arg6: tuple[int, int, int],
        arg7: int,
        arg8: float,
        arg9: tuple[int, int, int],
        arg10: bool,
        arg11: Sequence[float],
        arg12: bool,
        arg13: bool,
        arg14: tuple[int, int, int],
        arg15: float,
        /,
    ) -> None: ...
    def place_mesh(self, arg: Sequence[float], /) -> None: ...
    def intersect_mesh(
        self, arg0: int, arg1: tuple[int, int, int], arg2: tuple[int, int, int], arg3: int, arg4: int, arg5: int, /
    ) -> None: ...
    def facts(self, arg: bool, /) -> dict: ...
    def spacing(self, arg0: int, arg1: int, arg2: bool, /) -> float: ...
    def beside(self, arg: int, /) -> Scene: ...
    def sorted(self, arg0: int, arg1: int, /) -> None: ...
    def surface_kernels(self, arg0: int, arg1: int, /) -> None: ...
    def render(
        self,
        layers: Sequence[tuple[Scene, int, float, Material, Sequence[Clip], object]],
        view: View,
        look: Look,
        thesis: Thesis | None,
        passes: int,
        before: Frame | None,
    ) -> Frame: ...
    def intersect(
        self,
        kernel: int,
        threshold: float,
        thesis: Thesis | None,
        n: int,
        origins: tuple[int, int, int],
        directions: tuple[int, int, int],
        t: int,
        normal: int,
        albedo: int,
    ) -> None: ...
    def march_parts(
        self,
        arg0: int,
        arg1: float,
        arg2: Sequence[Clip],
        arg3: int,
        arg4: int,
        arg5: int,
        arg6: int,
        arg7: int,
        arg8: int,
        arg9: int,
        arg10: int,
        /,
    ) -> None: ...
    def occlude_parts(
        self,
        arg0: int,
        arg1: float,
        arg2: Sequence[Clip],
        arg3: Material,
        arg4: int,
        arg5: int,
        arg6: int,
        arg7: int,
        arg8: int,
        arg9: int,
        arg10: int,
        arg11: int,
        arg12: int,
        arg13: int,
        /,
    ) -> None: ...
    def evaluate(self, arg0: int, arg1: int, arg2: tuple[int, int, int], arg3: int, arg4: int, /) -> None: ...
    def blend(
        self,
        arg0: int,
        arg1: int,
        arg2: tuple[int, int, int],
        arg3: tuple[int, int, int],
        arg4: int,
        arg5: int,
        arg6: int,
        /,
    ) -> None: ...
    def integrate(
        self,
        arg0: int,
        arg1: int,
        arg2: tuple[int, int, int],
        arg3: tuple[int, int, int],
        arg4: tuple[int, int, int],
        arg5: int,
        arg6: int,
        arg7: int,
        /,
    ) -> None: ...
    def neighbors(self, arg0: int, arg1: tuple[int, int, int], arg2: float, /) -> tuple: ...
    def synchronize(self) -> None: ...
    def cancel(self) -> None: ...
    def thesis_work(self, arg0: int, arg1: int, /) -> None: ...

class Simulation:
    def __init__(self, arg0: str, arg1: int, arg2: dict, /) -> None: ...
    def scene(self) -> Scene: ...
    def configure(self, arg: dict, /) -> None: ...
    def set_phase(self, arg: dict, /) -> None: ...
    def add(
        self, positions: numpy.ndarray, phase: int, velocities: numpy.ndarray | None, velocity: Sequence[float]
    ) -> int: ...
    def remove(self, arg: numpy.ndarray, /) -> None: ...
    def emit(self, arg0: numpy.ndarray, arg1: int, arg2: numpy.ndarray, /) -> int: ...
    def set_inlets(self, arg: Sequence[Sequence[float]], /) -> None: ...
    def set_sinks(self, arg: Sequence[Sequence[float]], /) -> None: ...
    def capture(self, arg0: int, arg1: Sequence[float], /) -> None: ...
    def move_to(self, arg0: int, arg1: Sequence[float], /) -> None: ...
    def make_body(
        self,
        arg0: int,
        arg1: float,
        arg2: Sequence[float],
        arg3: Sequence[float],
        arg4: Sequence[float],
        arg5: Sequence[float],
        /,
    ) -> None: ...
    def body(self, arg: int, /) -> tuple: ...
    def motion(self) -> bytes: ...
    def set_motion(self, arg: bytes, /) -> None: ...
    def totals(self) -> dict: ...
    def step(self, arg: float, /) -> dict: ...
    def next_dt(self) -> float: ...
    def draw(self, arg: int, /) -> None: ...
    def size(self) -> int: ...
    def time(self) -> float: ...
    def n_steps(self) -> int: ...
    def next_id(self) -> int: ...
    def read(self, arg0: str, arg1: numpy.ndarray, /) -> None: ...
    def write(self, arg0: str, arg1: numpy.ndarray, /) -> None: ...
    def resize(self, arg0: int, arg1: int, arg2: float, arg3: int, /) -> None: ...
    def settle(self) -> None: ...
    def set_forces(self, arg: numpy.ndarray, /) -> None: ...
    def neighbors(self) -> tuple: ...
    def flow(self, arg0: numpy.ndarray, arg1: numpy.ndarray, /) -> None: ...
    def tissue(self) -> Tissue: ...
