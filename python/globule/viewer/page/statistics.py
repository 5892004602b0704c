"""The panel Statistics."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ..._base.memory import resident_bytes
from ..markdown import table
from .panel import Panel


def used(device: str, threads: int) -> str:
    """The words of a device, with the number of threads that a scene uses of it; 0: all."""
    return re.sub(r"\d+ threads?", f"{threads} thread{'s' * (threads > 1)}", device) if threads else device


class Statistics(Panel):
    """Rates, times, sizes and memory, for each browser."""

    title = "Statistics"

    def build(self) -> None:
        """The table stands in the page's model: it is each browser's own."""

    def table(self, client: Any) -> str:
        """The table of a `Client` as Markdown."""
        engine, pacer, source = self.viewer.engine, client.pacer, self.viewer.source
        scene = source.maker.last_scene
        frame = client.frame
        latency = float(np.median(pacer.latency)) if pacer.latency else 0.0
        rows = {
            "frame rate": f"{pacer.rate:.1f} / s, {client.number:,} images",
            "size": f"{frame.size[0]} x {frame.size[1]}, {frame.samples} samples" if frame else "",
            "trace": f"{1e3 * engine.trace_seconds:.1f} ms",
            "encode": f"{1e3 * engine.encode_seconds:.1f} ms",
            "latency": f"{1e3 * latency:.0f} ms (median)",
            "sent": f"{pacer.n_bytes / 1e6:.1f} MB",
        }
        if scene is not None:
            with source.lock:
                octree, n = scene.octree, len(scene)
            rows["build"] = f"{1e3 * octree.build_seconds:.1f} ms"
            rows["particles"] = f"{n:,}"
            rows["octree"] = f"{octree.bytes / 1e6:.1f} MB"
            rows["device"] = used(scene.device.description, source.maker.threads)
        rows["memory"] = f"{resident_bytes() / 1e6:.0f} MB"
        rows["browsers"] = str(len(self.viewer.clients))
        rows.update(source.facts())
        return table(rows)
