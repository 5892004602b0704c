#!/usr/bin/env python3
"""Fluids side by side: the same particles, walls, tolerance and time in globule and SPlisHSPlasH.

    pip install pysplishsplash
    python bench/peers/fluids.py [--data FOLDER] [--cases splash,column] [--n 20000] [--csv FILE]

`splash` continues a developed splash for 0.05 s, if its file is there; `column` lets --n particles
fall for 0.3 s. Every run is a process of its own. Both programs use DFSPH, the cubic spline of
support 2 spacings, no viscosity, steps of at most 5 ms and at most 0.4 spacings of the fastest
particle. Differences: globule's steps heed the pressure too, and its walls stop particles by
contact besides by pressure. The velocities' tolerance is each program's own: a tenth of the error,
at most 0.02 %, in globule, 0.1 % in SPlisHSPlasH; "SPlisHSPlasH tight" has globule's. Threads that
wait check 400 times before they sleep, as globule's do by default.

The first table has steps, iterations (density + divergence), processor time (user + system) of the
steps alone, and million particle-steps per second of processor time and of wall time. The second
has both final states measured by one code (fluid_judge.py), and how far the same particle is from
where globule has it (median, in spacings). A peer that is missing is skipped with the command
that installs it.
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path

import numpy as np
from fluid_judge import flow
from fluid_peers import PACKAGES, PEERS, fluid_rows, simulation

DATA = Path(__file__).parents[3] / "shared" / "data" / "particles"
SPLASH = "splash_117649.npz"
SECONDS = {"splash": 0.05, "column": 0.3}
WAITING = {"OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "400"}
# SPlisHSPlasH's wheel has OpenGL libraries of its own. Two copies of libGLdispatch in a process
# crash as soon as it is imported, unless the system's comes first.
SYSTEM_GL = {"LD_PRELOAD": "libGLdispatch.so.0"}
SPEED = ("case", "error", "threads", "program", "steps", "mean step, ms", "iterations",
         "processor s", "processor s / simulated s", "M particle-steps / processor s",
         "M particle-steps / s")  # fmt: skip
FLOW = ("case", "error", "threads", "program", "compression", "99.9 %", "largest", "kinetic, J",
        "energy, J", "height, m", "front, m", "lost", "apart")  # fmt: skip


def prepare(case: str, n: int, data: Path, folder: Path) -> Path:
    """Particles and walls as globule's simulation begins, for everybody."""
    import globule as gb

    recipe = {"splash": str(data / SPLASH) if case == "splash" else None, "n": n}
    sim = simulation(recipe, 0.01, 1)
    rows, domain, obstacles = fluid_rows(sim), sim.settings.domain, np.zeros((0, 2, 3))
    if case == "splash":
        with np.load(recipe["splash"]) as file:
            obstacles = np.array([[file["obstacle_min"], file["obstacle_max"]]])
    found = {
        "fluid": np.asarray(sim.positions)[rows],
        "velocity": np.asarray(sim.velocities)[rows],
        "walls": np.asarray(sim.positions)[~rows],
    }
    fluid = gb.Particles(found["fluid"], attributes={"velocity": found["velocity"]})
    gb.write(folder / "fluid.bgeo", fluid)
    gb.write(folder / "walls.bgeo", gb.Particles(found["walls"]))
    np.savez(
        folder / "case.npz",
        **found,
        spacing=float(sim.settings.spacing),
        lo=np.asarray(domain.lo, float),
        hi=np.asarray(domain.hi, float),
        obstacles=obstacles,
        recipe=json.dumps(recipe),
    )
    return folder / "case.npz"


def environment(peer: str) -> tuple[dict[str, str], str]:
    """What a peer's process needs, and why the peer cannot run, or ""."""
    absent = [name for name in PACKAGES[peer] if importlib.util.find_spec(name) is None]
    if absent:
        return {}, f"pip install {' '.join(absent)}"
    begin = f"import {PACKAGES[peer][0]}"
    for extra in ({}, SYSTEM_GL):
        env = {**os.environ, **extra}
        command = [sys.executable, "-c", begin]
        done = subprocess.run(command, capture_output=True, text=True, env=env)
        if done.returncode == 0:
            return extra, ""
    if done.returncode < 0:
        return {}, f"`{begin}` crashes (signal {-done.returncode}); apt-get install libgl1 libglx0"
    return {}, f"`{begin}`: {(done.stderr.strip() or 'no message').splitlines()[-1]}"


def measured(peer: str, case: Path, run: dict, extra: dict, limit: float) -> dict | None:
    """One run in a process of its own, and its final state judged here."""
    out = case.parent / "state.npz"
    out.unlink(missing_ok=True)
    command = [sys.executable, __file__, "--one", peer, str(case), json.dumps(run)]
    threads = {"OMP_NUM_THREADS": str(run["threads"])}
    env = {**os.environ, **threads, **WAITING, **extra}
    try:
        done = subprocess.run(command, capture_output=True, text=True, env=env, timeout=limit)
    except subprocess.TimeoutExpired:
        print(f"{peer}: stopped after {limit:g} s", file=sys.stderr)
        return None
    if not out.exists():
        lines = (done.stderr.strip() or f"no message, exit code {done.returncode}").splitlines()
        print(f"{peer}: {lines[-1]}", file=sys.stderr)
        return None
    with np.load(out) as file:
        found = {k: file[k].tolist() if file[k].ndim == 0 else file[k] for k in file}
    return found


def one(peer: str, case: Path, run: dict) -> None:
    """Writes state.npz beside the case."""
    with np.load(case) as file:
        found = PEERS[peer]({k: file[k] for k in file}, run, case.parent)
    np.savez(case.parent / "part.npz", **found)
    os.replace(case.parent / "part.npz", case.parent / "state.npz")


def row(name: str, peer: str, run: dict, case: dict, found: dict) -> dict:
    n, steps = len(case["fluid"]), found["steps"]
    return {
        "case": f"{name}, {n}",
        "particles": n,
        "walls": len(case["walls"]),
        "program": peer,
        **run,
        **{k: v for k, v in found.items() if np.ndim(v) == 0},
        "dt": found["time"] / steps,
        "cpu_per_simulated": found["cpu"] / found["time"],
        "per_cpu_second": n * steps / found["cpu"] / 1e6,
        "per_second": n * steps / found["wall"] / 1e6,
        **flow(case, found["positions"], found["velocities"]),
    }


def rows_of(name: str, options, path: Path, peers: dict[str, dict]) -> list[dict]:
    """The start, then each error, number of threads and program; of several runs, the one with the
    least processor time."""
    with np.load(path) as file:
        case = {k: file[k] for k in file}
    begin = flow(case, case["fluid"], case["velocity"])
    label = f"{name}, {len(case['fluid'])}"
    rows = [{"case": label, "program": "start", **begin}]
    for error in options.errors:
        for threads in options.threads:
            run = {"error": error, "threads": threads, "seconds": options.seconds or SECONDS[name]}
            first = None
            for peer, extra in peers.items():
                all_runs = (measured(peer, path, run, extra, options.limit) for _ in range(options.runs))
                runs = [found for found in all_runs if found]
                if not runs:
                    continue
                best = min(runs, key=lambda found: found["cpu"])
                rows.append(row(name, peer, run, case, best))
                if peer == "globule":
                    first = best["positions"]
                elif first is not None:
                    apart = np.linalg.norm(best["positions"] - first, axis=1)
                    rows[-1]["apart"] = float(np.median(apart) / case["spacing"])
                print(f"{label}: {peer}, {run}: {best['cpu']:.1f} s", file=sys.stderr, flush=True)
    return rows


def tables(rows: list[dict]) -> str:
    def line(cells) -> str:
        return "| " + " | ".join(cells) + " |"

    speed = [line(SPEED), line(["---"] * len(SPEED))]
    state = [line(FLOW), line(["---"] * len(FLOW))]
    for r in rows:
        settings = [f"{r['error']:.1%}", str(r["threads"])] if "error" in r else ["", ""]
        head = [r["case"], *settings, r["program"]]
        if "steps" in r:
            iterations = f"{r['iterations']:.1f} + {r['divergence_iterations']:.1f}"
            numbers = (1e3 * r["dt"], r["cpu"], r["cpu_per_simulated"])
            dt, cpu, per_simulated = (f"{v:.3g}" for v in numbers)
            rates = [f"{r[k]:.3f}" for k in ("per_cpu_second", "per_second")]
            speed.append(line([*head, str(r["steps"]), dt, iterations, cpu, per_simulated, *rates]))
        shares = [f"{r[k]:.2%}" for k in ("compression", "high_compression", "most_compression")]
        sizes = [f"{r[k]:.5g}" for k in ("kinetic", "energy", "height", "front")]
        apart = f"{r['apart']:.3f}" if "apart" in r else ""
        state.append(line([*head, *shares, *sizes, str(r["lost"]), apart]))
    return "\n".join([*speed, "", *state])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    numbers = {"error": lambda s: [float(v) for v in s.split(",")]}
    numbers["threads"] = lambda s: [int(v) for v in s.split(",")]
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the splash's file")
    parser.add_argument("--cases", default=",".join(SECONDS))
    parser.add_argument("--peers", default=",".join(PEERS))
    parser.add_argument("--n", type=int, default=20_000, help="particles of the column, about")
    parser.add_argument("--errors", type=numbers["error"], default=[0.001, 0.01])
    parser.add_argument("--threads", type=numbers["threads"], default=[1, 2])
    parser.add_argument("--seconds", type=float, help="to simulate; splash: 0.05, column: 0.3")
    parser.add_argument("--runs", type=int, default=1, help="the least processor time counts")
    parser.add_argument("--limit", type=float, default=1800.0, help="seconds for each process")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        peer, case, run = options.one
        one(peer, Path(case), json.loads(run))
        return
    peers = {}
    for peer in options.peers.split(","):
        extra, why = environment(peer)
        if why:
            print(f"{peer}: skipped; {why}", file=sys.stderr)
        else:
            peers[peer] = extra
            print(f"{peer} {metadata.version(PACKAGES[peer][0])}", file=sys.stderr)
    rows = []
    for case in options.cases.split(","):
        if case == "splash" and not (options.data / SPLASH).exists():
            print(f"splash: skipped; {options.data / SPLASH} is not there", file=sys.stderr)
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = prepare(case, options.n, options.data, Path(folder))
            rows += rows_of(case, options, path, peers)
    print(tables(rows))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1, default=float) + "\n", encoding="utf-8")
    if options.csv:
        names = list(dict.fromkeys(name for r in rows for name in r))
        with open(options.csv, "w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, names)
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
