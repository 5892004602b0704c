"""The benchmark of particle surfaces: six scenes, every program that is installed, one command.

    python bench/field -o results                    # takes an hour
    python bench/field --particles 5000 --size 320x240 --scenes ball,sheet

Prints a table, and writes results.csv, results.md (a page with settings and versions) and an image
of each scene by each program. A program that is missing is skipped with the command that installs
it. Each program runs in a process of its own; docs/compare.md says what each column means.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
from cases import SCENES, Case, cameras, moved  # noqa: E402
from peers import ONE_RADIUS, PEERS  # noqa: E402

FRAMES, VIEWS = 2, 2  # after the first image
COLUMNS = ("scene", "particles", "program", "version", "first_s", "frame_s", "view_s",
           "first_cpu_s", "frame_cpu_s", "view_cpu_s", "peak_mib", "judged", "own_wrong",
           "own_hit", "own_normal_deg", "own_normal_99_deg", "truth_wrong", "truth_hit",
           "truth_normal_deg", "truth_normal_99_deg", "note")  # fmt: skip


def case_of(name: str, most: int) -> Case:
    make, n = SCENES[name]
    return make(min(n, most))


def cpu_seconds() -> float:
    own, children = (resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def peak_mib() -> float:
    """Of this process, or of its largest child, in MiB."""
    status = Path("/proc/self/status").read_text()  # ru_maxrss would hold that of the parent, too
    own = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    return max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) / 1024


def timed(work) -> tuple:
    wall, cpu = time.perf_counter(), cpu_seconds()
    result = work()
    return result, time.perf_counter() - wall, cpu_seconds() - cpu


def run_one(scene: str, program: str, options: argparse.Namespace, out: Path) -> dict:
    """Time one program on one scene, in this process, and judge what it drew."""
    from judging import compare, squares
    from PIL import Image

    case = case_of(scene, options.particles)
    views = cameras(case, options.size, 1 + VIEWS)
    peer = PEERS[program](case, options.size)
    frames = [moved(case, step) for step in range(FRAMES + 1)]
    base = peak_mib()

    def draw(step: int, view: int):
        if step >= 0:
            peer.move(frames[step])
        return peer.image(views[view])

    image, first, first_cpu = timed(lambda: draw(0, 0))
    Image.fromarray(image).save(out.with_suffix(".png"))
    by_frame = [timed(lambda i=i: draw(i, 0))[1:] for i in range(1, FRAMES + 1)]
    by_view = [timed(lambda i=i: draw(-1, i))[1:] for i in range(1, VIEWS + 1)]
    found = {"particles": len(case.positions), "version": PEERS[program].version(),
             "first_s": first, "first_cpu_s": first_cpu, "peak_mib": peak_mib()}  # fmt: skip
    found["before_mib"] = base
    for name, times in (("frame", by_frame), ("view", by_view)):
        found[f"{name}_s"], found[f"{name}_cpu_s"] = np.median(times, axis=0)
    peer.move(frames[0])
    mask, normals = peer.judged(views[0])
    rays = [a.reshape(-1, 3) for a in views[0].rays(options.size)]
    surface = peer.surface()
    parts = squares(options.size, len(case.positions))
    chosen = np.concatenate(parts)
    by_part = [[np.asarray(a[part], np.float64) for a in rays] for part in parts]
    directions = np.concatenate([d for _, d in by_part])
    found["judged"] = len(chosen)
    truths = {"own": surface and (lambda o, d: surface.near(o, d).first_hit(o, d)),
              "truth": case.truth}  # fmt: skip
    for name, hits in truths.items():
        if hits is None:
            continue
        expected = [np.concatenate(a) for a in zip(*(hits(*part) for part in by_part), strict=True)]
        got = compare(mask, normals, chosen, expected, directions)
        found |= {f"{name}_wrong": got["wrong"], f"{name}_hit": got["hit"]}
        if "normal" in got:
            found |= {f"{name}_normal_deg": got["normal"],
                      f"{name}_normal_99_deg": got["normal_99"]}  # fmt: skip
    return found


def measured(scene: str, program: str, options: argparse.Namespace, out: Path) -> dict:
    command = [sys.executable, str(Path(__file__).parent), "--one", scene, program,
               "--particles", str(options.particles), "-o", str(out),
               "--size", "x".join(map(str, options.size))]  # fmt: skip
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=options.limit)
    except subprocess.TimeoutExpired:
        return {"note": f"stopped after {options.limit:g} s"}
    if done.returncode:
        lines = (done.stderr.strip() or f"exit status {done.returncode}").splitlines()
        return {"note": lines[-1][:160]}
    return json.loads(done.stdout.strip().splitlines()[-1])


def shown(found: dict, name: str, digits: str = ".3g") -> str:
    value = found.get(name)
    return "" if value is None else format(value, digits)


def wrong(found: dict, name: str) -> str:
    """Wrong pixels of those hit, and the angle's median and 99th percentile."""
    if f"{name}_wrong" not in found:
        return " | "
    angle = shown(found, f"{name}_normal_deg", ".2f")
    if angle:
        angle += f" ({shown(found, f'{name}_normal_99_deg', '.1f')})"
    return f"{found[f'{name}_wrong']:,} of {found[f'{name}_hit']:,} | {angle}"


HEAD = (
    "scene | program | first image, s | frame, s | view, s | CPU: first, frame, view, s | "
    "peak, MiB | wrong pixels, own surface | normal, ° | wrong pixels, truth | normal, °"
)


def line(scene: str, program: str, found: dict) -> str:
    if "note" in found:
        return f"| {scene} | {program} | {found['note']} |" + " |" * 8
    cpu = ", ".join(shown(found, f"{k}_cpu_s") for k in ("first", "frame", "view"))
    walls = " | ".join(shown(found, f"{k}_s") for k in ("first", "frame", "view"))
    peak = shown(found, "peak_mib", ".0f")
    return (f"| {scene}, {found['particles']:,} | {program} | {walls} | {cpu} | {peak} | "
            f"{wrong(found, 'own')} | {wrong(found, 'truth')} |")  # fmt: skip


def processor() -> str:
    """The name of the processor, and of a GPU that CUDA sees."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else "processor not known"


def page(lines: list[str], versions: dict[str, str], options: argparse.Namespace) -> str:
    from bench.tables.report import machine

    width, height = options.size
    settings = [
        f"- **{name}** ({versions[name]}): {(PEERS[name].__doc__ or '').splitlines()[0]} "
        f"Settings: {PEERS[name].SETTINGS}."
        for name in versions
    ]
    skipped = [f"- **{name}**: not here; `{PEERS[name].INSTALL}`." for name in options.programs if name not in versions]
    table = [f"| {HEAD} |", "|" + "---|" * 11, *lines]
    about = f"{width} x {height} pixels. Machine: {machine(processor())}"
    return "\n".join([
        "# Particle surfaces: results", "", about, "",
        *table, "", "## Settings", *settings, *skipped, "",
    ])  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python bench/field", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )

    def names(text: str) -> list[str]:
        return [word.strip() for word in text.split(";" if ";" in text else ",")]

    def size(text: str) -> tuple[int, int]:
        width, _, height = text.partition("x")
        return int(width), int(height)

    parser.add_argument("--scenes", type=names, default=list(SCENES), help="separated by commas")
    parser.add_argument("--programs", type=lambda t: [w.strip() for w in t.split(";")],
                        default=list(PEERS), help="separated by semicolons")  # fmt: skip
    parser.add_argument("--particles", type=int, default=10**9, help="most particles of a scene")
    parser.add_argument("--size", type=size, default=(1024, 768), help="of the images")
    parser.add_argument("--limit", type=float, default=1800.0, help="seconds for each process")
    parser.add_argument("-o", "--output", type=Path, default=Path("field"), help="folder")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        found = run_one(*options.one, options, options.output)
        print(json.dumps({k: v if isinstance(v, (str, int)) else float(v) for k, v in found.items()}))
        return
    for kind, known, given in (("scene", SCENES, options.scenes),
                               ("program", PEERS, options.programs)):  # fmt: skip
        for name in given:
            if name not in known:
                parser.error(f"{kind}: expected one of {'; '.join(known)}, got {name!r}")
    options.output.mkdir(parents=True, exist_ok=True)
    versions = {}
    for name in options.programs:
        if PEERS[name].missing():
            print(f"{name}: skipped; {PEERS[name].INSTALL}", file=sys.stderr)
        else:
            versions[name] = PEERS[name].version()
    lines, rows = [], []
    print(f"| {HEAD} |\n|{'---|' * 11}")
    for scene in options.scenes:
        for program in versions:
            stem = f"{scene}-{program}".replace(" ", "-").replace(",", "").replace("+", "and")
            if scene == "mixed radii" and program in ONE_RADIUS:
                found = {"note": "all particles have one radius there"}
            else:
                found = measured(scene, program, options, options.output / stem)
            lines.append(line(scene, program, found))
            print(lines[-1], flush=True)
            rows.append({"scene": scene, "program": program, **found})
            with open(options.output / "results.csv", "w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore")
                writer.writeheader()
                writer.writerows(rows)
            text = page(lines, versions, options)
            (options.output / "results.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    os.environ.setdefault("OVITO_GUI_MODE", "0")
    main()
