"""A TCP proxy that is as slow as one likes: so many bytes a second to the client, and a delay each
way."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time

PIECE = 4096  # bytes that pass at once


class Throttle:
    """Listens on a port of its own, `port`, and passes everything on to `target`.

    bits: per second from the server to the client. delay: s each way. A context manager.
    """

    def __init__(self, target: int, bits: float, delay: float):
        self.target, self.bytes_per_second, self.delay = target, bits / 8, delay
        self.port = 0
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Throttle:
        self._thread.start()
        self._ready.wait()
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        # Small buffers: what waits must wait at the sender, as on a real link's narrow end.
        server = self._loop.run_until_complete(asyncio.start_server(self._accept, "127.0.0.1", 0, limit=PIECE))
        self.port = server.sockets[0].getsockname()[1]
        self._ready.set()
        self._loop.run_forever()
        server.close()
        left = asyncio.all_tasks(self._loop)
        for task in left:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
        self._loop.close()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection("127.0.0.1", self.target, limit=PIECE)
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(
                self._pass(reader, back, None), self._pass(there, writer, self.bytes_per_second), return_exceptions=True
            )

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, rate: float | None) -> None:
        waiting: asyncio.Queue = asyncio.Queue(64)

        async def deliver() -> None:
            while (item := await waiting.get()) is not None:
                due, data = item
                await asyncio.sleep(max(0.0, due - time.monotonic()))
                writer.write(data)
                await writer.drain()
            writer.close()

        task = asyncio.create_task(deliver())
        free = 0.0  # when the link's narrow end is
        try:
            while data := await reader.read(PIECE):
                if rate is not None:
                    free = max(free, time.monotonic()) + len(data) / rate
                    await asyncio.sleep(max(0.0, free - time.monotonic()))
                await waiting.put((time.monotonic() + self.delay, data))
        except (OSError, asyncio.CancelledError):
            task.cancel()
            return
        await waiting.put(None)
        await task
