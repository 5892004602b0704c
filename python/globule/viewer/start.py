"""The start page of `globule view` without a file: scenes, recent files, dropped files.

The page never sends a path: a scene by its name, a recent file by its number, or the bytes of
files. Two dropped files are compared, more are a sequence. When the choice has been opened, the
start page's server ends and the viewer takes its port.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import secrets
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from .._base.files import atomic_write
from ..sim.scene_read import SHIPPED
from .compare_source import CompareSource
from .guard import LOCAL, Guard
from .source import Source

PATH = "/globule/start"
SPLASH = "splash"
MOST_UPLOAD = 1 << 30  # bytes
LEAST_PART, MOST_PART = 64 * 1024, 512 * 1024  # bytes of an upload at once, but for the last ones
STALLED = 60.0  # s after which a part of an upload comes no more
MOST_RECENT = 8
MOST_FILES = 1000  # of a sequence
# Formats whose files never name another file.
ENDINGS = (
    ".vtk", ".vtp", ".vtu", ".bgeo", ".bgeo.gz", ".ply", ".xyz", ".csv", ".txt", ".dat", ".npz", ".npy", ".tsv",
    ".parquet", ".arrow", ".feather", ".pts", ".tec", ".plt", ".mat", ".gsd", ".dump", ".lammpstrj", ".lmp",
    ".lammps", ".extxyz", ".bi4", ".pcd", ".las", ".laz", ".pdb", ".ent", ".gro", ".tipsy", ".gadget",
    ".gadget2", ".obj", ".stl", ".glb", ".nii", ".nii.gz", ".nrrd", ".mha", ".vti", ".igs.mha", ".igs.nrrd",
)  # fmt: skip
SCENES = {
    SPLASH: "Water that falls back from a wall: 29,160 particles",
    "dam-break": "A column of water collapses in a box",
    "droplet": "A drop falls into a shallow pool",
    "poiseuille": "Flow between two plates",
    "beam": "A soft beam bends under its own weight",
    "cut-block": "A blade cuts a block of tissue",
    "brain-surgery": "A scalpel opens the cortex (needs the extra atlas)",
}


class Start:
    """The server of the start page.

    Args:
        open_what: returns a `Source` for a path, the name of a scene (`SPLASH` is one), or several
            paths, a sequence.
        host: the address to listen on; any but a loopback address demands a token.
        port: the first port to try; 0 takes any free one.
        demand_token, token: as for `Viewer`.

    Attributes:
        port: that the server listens on.
        token: that the viewer has to use, too; None on a loopback address.

    Raises:
        OSError: no port is free.
    """

    def __init__(
        self,
        open_what: Callable[[Any], Source],
        host: str = "127.0.0.1",
        port: int = 0,
        demand_token: bool = False,
        token: str | None = None,
    ):
        self._open, self.host = open_what, host
        tokens = host not in LOCAL or demand_token
        self.token = (token or secrets.token_urlsafe(24)) if tokens else None
        self.source: Source | None = None
        self._recent = recent_files()
        self._folder = tempfile.mkdtemp(prefix="globule-")
        self._chosen, self._busy = threading.Event(), threading.Lock()
        from .server import Server, page_file

        self._server = Server(Guard(self.token), page_file("start.html"), PATH, self._talk, host, port)
        self.port = self._server.port

    def address(self, name: str = "127.0.0.1") -> str:
        """The address to open in a browser."""
        return f"http://{name}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    def wait(self) -> Source:
        """Wait until a person has chosen; returns what was opened and frees the port."""
        while not self._chosen.wait(0.2):
            pass
        self._server.close()
        assert self.source is not None
        return self.source

    def close(self) -> None:
        """End the server and remove uploads."""
        self._server.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    async def _talk(self, connection: Any) -> None:
        """Tell a browser what there is, and do what it asks for."""
        from websockets.exceptions import ConnectionClosed

        scenes = [[name, words] for name, words in SCENES.items()]
        recent = [[Path(path).name, str(Path(path).parent)] for path in self._recent]
        first: list[str] = []  # uploads: two files are compared
        with contextlib.suppress(ConnectionClosed), self._unless_opened(first):
            hello = {"scenes": scenes, "recent": recent, "endings": ENDINGS, "most": MOST_UPLOAD}
            await connection.send(json.dumps(hello))
            async for text in connection:
                if isinstance(text, bytes):  # the rest of an upload that was refused
                    continue
                try:
                    await self._do(connection, text, first)
                except Exception as error:
                    self._forget(first)
                    words = str(error) or type(error).__name__
                    words = re.sub(re.escape(self._folder + os.sep) + f"[^{os.sep}]+{os.sep}", "", words)
                    await connection.send(json.dumps({"error": words}))

    async def _do(self, connection: Any, text: str | bytes, first: list[str]) -> None:
        """Do what a browser asks for; an upload with another to come is kept in `first`."""
        asked = json.loads(text)
        what = asked.get("do") if isinstance(asked, dict) else None
        if what == "scene" and asked.get("name") in SCENES:
            name = asked["name"]
        elif what == "recent" and asked.get("number") in range(len(self._recent)):
            name = self._recent[asked["number"]]
        elif what == "upload":
            name = await self._receive(connection, str(asked.get("name")), asked.get("size"))
            first.append(name)
            if asked.get("more") and len(first) < MOST_FILES:
                await connection.send(json.dumps({"kept": os.path.basename(name)}))
                return
        else:
            raise ValueError("start page: expected the name of a scene, a recent file or a file")
        await connection.send(json.dumps({"opening": os.path.basename(name)}))
        names = first if name in first else [*first, name]
        await asyncio.get_running_loop().run_in_executor(None, self._take, names)
        await connection.send(json.dumps({"opened": True}))
        await asyncio.sleep(0.2)  # until it is there
        self._chosen.set()

    def _forget(self, uploads: list[str]) -> None:
        """Remove a browser's uploads from the disk."""
        for path in uploads:
            shutil.rmtree(os.path.dirname(path), ignore_errors=True)
        uploads.clear()

    @contextlib.contextmanager
    def _unless_opened(self, uploads: list[str]) -> Iterator[None]:
        """Remove uploads after the block, unless the viewer shows them."""
        try:
            yield
        finally:
            if self.source is None:
                self._forget(uploads)

    def _take(self, names: list[str]) -> None:
        with self._busy:
            if self.source is not None:
                return
            if len(names) > 2:
                self.source = self._open(names)
                return
            sources = [self._open(name) for name in names]
            self.source = sources[0] if len(sources) == 1 else CompareSource(*sources)

    async def _receive(self, connection: Any, name: str, size: Any) -> str:
        """Receive a file of a browser; returns the path of the copy."""
        ending = next((e for e in sorted(ENDINGS, key=len, reverse=True) if name.lower().endswith(e)), None)
        if ending is None:
            raise ValueError(f"{name[-60:]}: expected a file with one of {' '.join(ENDINGS)}")
        free = shutil.disk_usage(self._folder).free // 2
        most = min(MOST_UPLOAD, free)
        if not isinstance(size, int) or not 0 < size <= most:
            raise ValueError(f"{name[-60:]}: expected 1 to {most:,} bytes, got {size}")
        stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name[: -len(ending)])[-60:] or "file"
        path = os.path.join(tempfile.mkdtemp(dir=self._folder), stem + ending)
        done = 0
        try:
            with open(path, "wb") as file:
                while done < size:
                    try:
                        part = await asyncio.wait_for(connection.recv(), STALLED)
                    except asyncio.TimeoutError:
                        waited = f"expected {size - done:,} more bytes, got none for {STALLED:g} s"
                        raise ValueError(f"{stem}{ending}: {waited}. Send it again.") from None
                    least, most = (min(end, size - done) for end in (LEAST_PART, MOST_PART))
                    if not isinstance(part, bytes) or not least <= len(part) <= most:
                        raise ValueError(f"{stem}{ending}: expected the bytes of the file")
                    if done == 0:
                        _check_head(stem + ending, part)
                    done += file.write(part)
                    await connection.send(json.dumps({"received": done}))
        except BaseException:
            self._forget([path])
            raise
        return path


def _check_head(name: str, head: bytes) -> None:
    """Raise ValueError for a header that names another file, which would be one of this machine."""
    if not name.endswith((".nrrd", ".mha")):
        return
    words = head[:65536].lower()
    detached = re.search(rb"^\s*data ?file\s*:", words, re.M)
    element = re.search(rb"^\s*elementdatafile\s*=\s*(\S+)", words, re.M)
    if detached or (element and element[1] != b"local"):
        raise ValueError(f"{name}: expected a file with its own data, got the name of another file")


# Recent files


def _recent_path() -> Path:
    base = os.environ.get("XDG_STATE_HOME") or os.path.join(os.path.expanduser("~"), ".local/state")
    return Path(base) / "globule" / "recent.json"


def recent_files() -> list[str]:
    """The files that `globule view` showed last and that are still there, newest first."""
    try:
        known = json.loads(_recent_path().read_text("utf-8"))
    except (OSError, ValueError):
        return []
    words = [path for path in known if isinstance(path, str)] if isinstance(known, list) else []
    return [path for path in words if os.path.isfile(path)][:MOST_RECENT]


def remember(path: str) -> None:
    """Note a file that `globule view` shows; a folder that cannot be written to is no error."""
    if path in SHIPPED or not os.path.isfile(path):
        return
    whole = os.path.realpath(path)
    if Path(whole).is_relative_to(os.path.realpath(tempfile.gettempdir())):  # it will not stay
        return
    known = [whole, *(other for other in recent_files() if other != whole)][:MOST_RECENT]
    with contextlib.suppress(OSError):
        _recent_path().parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(_recent_path(), "w") as file:
            file.write(json.dumps(known))
