"""How the viewer keeps up: pictures per second, latency, and how soon a still picture is sharp.

    python -m bench.viewer                                         # this machine's processor
    python -m bench.viewer --device cuda --particles 300000 --size 1920x1080 --only rate
    python -m bench.viewer --only browser                          # through a real browser
    python -m bench.viewer --only frames --soak-seconds 28800      # 8 hours of 10,000 files

Needs no browser but for the last: pictures go through a socket to a thread that
answers each. Prints a table and writes viewer.csv with --output.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import threading
import time
from collections.abc import Callable

import globule as gb
import numpy as np
from globule.render.camera_path import orbit
from globule.render.fit import fit_camera
from globule.viewer.encode import jpeg
from globule.viewer.engine import Engine
from globule.viewer.picture import trace
from globule.viewer.source import SceneSource
from globule.viewer.state import State

from .socket_sink import SocketSink
from .throttle import Throttle
from .viewer_long import of_frames, of_soak


class Session:
    """An engine with one client whose camera can be turned."""

    def __init__(
        self,
        particles: gb.Particles,
        size: tuple[int, int],
        device: str,
        through: Callable[[int], int] = lambda port: port,
        rate: float = 20.0,
    ):
        state = State()
        state.set(quality__rate=rate, quality__width=max(160, size[0]))
        self.size = size
        self.engine = Engine(SceneSource("bench", particles, device), state)
        with self.engine.source.lock:
            scene = self.engine.source.layers(state)[0].scene
        self.device = scene.device.description
        self.cameras = orbit(fit_camera(scene, size), n=720)
        self.sink = SocketSink(through)
        self.client = self.engine.add(self.sink, self.cameras[0])
        self.sink.client = self.client
        self.latencies: list[tuple[float, float, bool]] = []

    def turn(self, seconds: float, hertz: float = 60.0) -> dict[str, np.ndarray]:
        """Turn the camera; what was acknowledged meanwhile."""
        pacer, done = self.client.pacer, []
        keep = pacer.acknowledge

        def acknowledge(now: float, number: int) -> None:
            before = [one for one in pacer.in_flight if one.number <= number]
            done.extend((now, now - one.seen, now - one.sent, one.n_bytes, one.still) for one in before)
            keep(now, number)

        pacer.acknowledge = acknowledge
        end, i = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            i += 1
            self.client.look(self.cameras[i % len(self.cameras)], self.size)
            time.sleep(1 / hertz)
        self.i = i
        pacer.acknowledge = keep
        rows = np.array([row for row in done if not row[4]], float).reshape(-1, 5)
        return {"at": rows[:, 0], "latency": rows[:, 1], "transfer": rows[:, 2], "bytes": rows[:, 3]}

    def until_sharp(self) -> float:
        """Seconds from a last change until a picture of full size has arrived."""
        began, number = time.monotonic(), self.client.number
        self.client.look(self.cameras[(self.i + 7) % len(self.cameras)], self.size)
        while not (self.client.pacer._samples and not self.client.pacer.in_flight and self.client.number > number):
            time.sleep(0.002)
        return time.monotonic() - began

    def close(self) -> None:
        self.engine.close()
        self.sink.close()


def cloud(n: int) -> gb.Particles:
    """A wavy pool of about n particles on a jittered lattice."""
    edge = round((2.6 * n) ** (1 / 3))
    x, z, y = (
        a.reshape(-1)
        for a in np.meshgrid(np.arange(edge), np.arange(edge), np.arange(max(1, edge // 2)), indexing="ij")
    )
    top = edge / 2 * (0.75 + 0.25 * np.sin(7 * x / edge) * np.cos(5 * z / edge))
    positions = np.stack([x, y, z], 1)[y <= top] + np.random.default_rng(1).uniform(
        -0.15, 0.15, (int((y <= top).sum()), 3)
    )
    return gb.Particles(positions / edge, support=2 / edge)


def of_rate(options: argparse.Namespace) -> list[tuple[str, str]]:
    particles = cloud(options.particles)
    session = Session(particles, options.size, options.device, rate=options.rate)
    session.turn(3.0, hertz=240.0)
    found = session.turn(options.seconds, hertz=240.0)
    pacer = session.client.pacer
    rate = len(found["at"]) / options.seconds
    scale = pacer.scale
    sharp = np.median([session.until_sharp() for _ in range(3)])
    rows = [
        ("device", session.device),
        ("particles", f"{len(particles):,}"),
        ("size", f"{options.size[0]}x{options.size[1]}"),
        ("pictures / s while moving", f"{rate:.1f}"),
        ("share of the width while moving", f"{scale:.2f}"),
        ("latency, median", _ms(found["latency"])),
        ("sharp when still after", f"{sharp:.2f} s"),
        ("trace", f"{1e3 * session.engine.trace_seconds:.1f} ms (the last)"),
    ]
    session.close()
    return rows


def of_click(options: argparse.Namespace) -> list[tuple[str, str]]:
    """How long a click on the surface waits for its answer, as `Tools.pick` asks for it: while the
    camera turns, and while a still image is refined."""
    rows = []
    for name, refined in (("while moving", False), ("while a still image is refined", True)):
        session = Session(cloud(options.particles), options.size, options.device)
        engine, client, waits = session.engine, session.client, []
        engine.state.set(quality__samples=64)
        session.turn(2.0)
        end = time.monotonic() + options.seconds
        turning = threading.Thread(target=lambda s=session: s.turn(options.seconds + 1.0))
        if not refined:
            turning.start()
        while time.monotonic() < end:
            if refined:
                session.i += 7
                client.look(session.cameras[session.i % len(session.cameras)], session.size)
            time.sleep(0.1 + 0.3 * np.random.default_rng(len(waits)).random())
            began, frame = time.perf_counter(), client.frame
            engine.interrupt()
            with engine.source.lock:
                frame.pick(frame.size[0] // 2, frame.size[1] // 2)
            waits.append(time.perf_counter() - began)
        if not refined:
            turning.join()
        session.close()
        most = 1e3 * np.percentile(waits, [50, 90, 100])
        words = "{:.0f} ms, 90 % below {:.0f}, at most {:.0f}".format(*most)
        rows.append((f"{name}: {len(waits)} clicks", words))
    return rows


def of_still(options: argparse.Namespace) -> list[tuple[str, str]]:
    """A first image of full size of the view at rest, from the camera to the bytes of its JPEG."""
    source, state, size = (SceneSource("bench", cloud(options.particles), options.device), State(), options.still)
    with source.lock:
        scene = source.layers(state)[0].scene
    cameras = orbit(fit_camera(scene, size), n=24)
    rows: dict[str, list[float]] = {"trace": [], "fetch": [], "encode": [], "all": []}
    for camera in [*cameras[:4], *cameras]:
        times = [time.perf_counter()]
        with source.lock:
            frame = trace(source, state, camera, size, (0.0, 1.0, 0.0))
            times.append(time.perf_counter())
            picture = frame.picture
        times.append(time.perf_counter())
        data = jpeg(picture, state.quality.sharpness, sharp=True)
        times.append(time.perf_counter())
        for name, seconds in zip(rows, [*np.diff(times), times[-1] - times[0]], strict=True):
            rows[name].append(seconds)
    words = {name: f"{_ms(v[4:])}, at most {1e3 * max(v[4:]):.2f} ms" for name, v in rows.items()}
    source.close()
    return [
        ("device", scene.device.description),
        ("particles", f"{len(scene.particles):,}"),
        ("size", f"{size[0]}x{size[1]}, {state.quality.sharpness} % quality, a color for each pixel"),
        *words.items(),
        ("bytes", f"{len(data):,}"),
    ]


def of_transfer(options: argparse.Namespace) -> list[tuple[str, str]]:
    """Encoding and transfer alone, at 720p."""
    scene = gb.Scene(cloud(options.particles), device=options.device)
    picture = gb.render(scene, size=(1280, 720)).picture
    encode = []
    for _ in range(20):
        began = time.perf_counter()
        data = jpeg(picture, 80)
        encode.append(time.perf_counter() - began)
    sink, done, times = SocketSink(), threading.Event(), []

    class Answered:
        def acknowledge(self, number: int) -> None:
            done.set()

    sink.client = Answered()
    for number in range(20):
        done.clear()
        began = time.perf_counter()
        sink.send(number, data, None)
        done.wait()
        times.append(time.perf_counter() - began)
    sink.close()
    both = np.add(encode, times)
    return [
        ("encode 720p", _ms(encode)),
        ("transfer there and back", _ms(times)),
        ("encode + transfer", _ms(both)),
        ("bytes", f"{len(data):,}"),
    ]


def of_slow_link(options: argparse.Namespace) -> list[tuple[str, str]]:
    throttles: list[Throttle] = []

    def through(port: int) -> int:
        throttles.append(Throttle(port, 8e6, 0.02).__enter__())
        return throttles[0].port

    session = Session(cloud(options.particles), (1280, 720), options.device, through)
    session.turn(3.0)
    found = session.turn(options.link_seconds)
    half = len(found["at"]) // 2
    rows = [
        ("link", "8 Mbit/s, 20 ms each way"),
        ("seconds", f"{options.link_seconds:g}"),
        ("pictures / s", f"{len(found['at']) / options.link_seconds:.1f}"),
        ("latency, median", _ms(found["latency"])),
        ("latency, first half", _ms(found["latency"][:half])),
        ("latency, second half", _ms(found["latency"][half:])),
        ("latency, 95 of 100", f"{1e3 * np.percentile(found['latency'], 95):.0f} ms"),
        ("bytes a picture", f"{np.median(found['bytes']):,.0f}"),
    ]
    session.close()
    throttles[0].__exit__()
    return rows


def of_browser(options: argparse.Namespace) -> list[tuple[str, str]]:
    """The same through Chromium without a graphics card, directly and over the slow link."""
    from playwright.sync_api import sync_playwright

    flags = [
        "--headless=new",
        "--no-sandbox",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
    ]
    rows = []
    began = time.perf_counter()
    viewer = gb.view(cloud(options.particles), port=0, browser=False, block=False, device=options.device)
    rows.append(("start of the viewer", f"{time.perf_counter() - began:.2f} s"))
    with sync_playwright() as playwright, Throttle(viewer.port, 8e6, 0.02) as slow:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        for name, port in (("direct", viewer.port), ("8 Mbit/s, 20 ms", slow.port)):
            page = chromium.new_page(viewport={"width": 1280, "height": 720})
            page.goto(f"http://127.0.0.1:{port}/", timeout=120_000)
            while not viewer.clients:
                page.wait_for_timeout(100)
            client = next(iter(viewer.clients.values()))
            page.wait_for_timeout(6000)
            page.mouse.move(400, 300)
            page.mouse.down()
            latencies, start, number = [], time.monotonic(), client.number
            while time.monotonic() - start < options.link_seconds:
                t = time.monotonic() - start
                page.mouse.move(400 + 250 * np.sin(t), 300 + 60 * np.sin(1.7 * t))
                page.wait_for_timeout(15)
                client.pacer.latency and latencies.append(client.pacer.latency[-1])
            seconds = time.monotonic() - start
            page.mouse.up()
            half = len(latencies) // 2
            rows += [
                (f"{name}: pictures / s", f"{(client.number - number) / seconds:.1f}"),
                (f"{name}: latency, median", _ms(latencies)),
                (f"{name}: latency, second half", _ms(latencies[half:])),
            ]
            page.close()
            while viewer.clients:
                time.sleep(0.1)
        chromium.close()
    viewer.close()
    return rows


def _ms(values: object) -> str:
    return f"{1e3 * float(np.median(values)):.2f} ms" if len(values) else "-"


PARTS = {
    "rate": of_rate,
    "still": of_still,
    "click": of_click,
    "transfer": of_transfer,
    "link": of_slow_link,
    "browser": of_browser,
    "soak": of_soak,
    "frames": of_frames,
}


def pixels(text: str) -> tuple[int, ...]:
    """Width and height of "1280x720"."""
    return tuple(int(n) for n in text.split("x"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--particles", type=int, default=25_000)
    parser.add_argument("--size", default="1280x720", type=pixels)
    parser.add_argument("--still", default="3840x2160", type=pixels, help="of the view at rest")
    parser.add_argument("--rate", type=float, default=20.0, help="pictures per second aimed at")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--link-seconds", type=float, default=60.0)
    parser.add_argument("--soak-seconds", type=float, default=3600.0, help="of soak and frames")
    parser.add_argument("--visit-seconds", type=float, default=20.0, help="that a client stays")
    parser.add_argument("--frames", type=int, default=10_000, help="files of the sequence")
    parser.add_argument("--frame-particles", type=int, default=1000, help="in each file")
    parser.add_argument("--kept-mb", type=int, default=1074, help="of a sequence, in memory")
    parser.add_argument("--only", choices=PARTS, action="append")
    parser.add_argument("--output", metavar="FOLDER", help="write viewer.csv there")
    options = parser.parse_args()
    table = []
    for name in options.only or ("rate", "transfer", "link"):
        table += [(name, *row) for row in PARTS[name](options)]
    load = ", ".join(f"{v:.1f}" for v in os.getloadavg())
    table.append(("machine", "load over 1, 5, 15 minutes", load))
    wide = [max(len(row[k]) for row in table) for k in range(2)]
    for part, what, value in table:
        print(f"{part:{wide[0]}}  {what:{wide[1]}}  {value}")
    if options.output:
        os.makedirs(options.output, exist_ok=True)
        with open(os.path.join(options.output, "viewer.csv"), "w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([("part", "what", "value"), *table])


if __name__ == "__main__":
    main()
