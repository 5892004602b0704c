"""SPlisHSPlasH steps, and globule draws its particles where they are: nothing is copied, no file lies in between.

Writes splishsplash.png, which shows four times. Needs `pip install pysplishsplash`; an argument is the spacing, m.
"""

import ctypes
import json
import sys
import tempfile
import time
from pathlib import Path

import globule as gb
import numpy as np

try:
    ctypes.CDLL("libGLX.so.0", ctypes.RTLD_GLOBAL)  # the wheel crashes where its own OpenGL comes before the system's
    import pysplishsplash as sph
except (ImportError, OSError):
    print("skipped: no SPlisHSPlasH here (pip install pysplishsplash)")
    raise SystemExit from None
spacing = float(sys.argv[1]) if len(sys.argv) > 1 else 0.04
room, images, seconds = np.array([1.6, 1.0, 0.4]), [], []
place = {"translation": [0] * 3, "scale": [1] * 3, "rotationAxis": [1, 0, 0], "rotationAngle": 0}

with tempfile.TemporaryDirectory() as name:  # SPlisHSPlasH reads its scene from files
    folder = Path(name)
    axes = [np.arange(-0.5, side / spacing + 1) * spacing for side in room]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    gb.write(folder / "walls.bgeo", gb.Particles(grid[((grid < 0) | (grid > room)).any(axis=1)]))
    column = grid[((grid > spacing) & (grid < (0.4, 0.6, 0.4 - spacing))).all(axis=1)]
    gb.write(folder / "fluid.bgeo", gb.Particles(column))
    (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")  # a body needs a mesh, beside its particles
    wall = {"geometryFile": "a.obj", "particleFile": "walls.bgeo", "isWall": True, **place}
    fluid = {"id": "Fluid", "particleFile": "fluid.bgeo", **place}
    how = {"particleRadius": spacing / 2, "simulationMethod": 4, "boundaryHandlingMethod": 0}  # DFSPH
    scene = {"Configuration": how, "FluidModels": [fluid], "RigidBodies": [wall]}
    (folder / "scene.json").write_text(json.dumps(scene))
    base = sph.Exec.SimulatorBase()
    base.init(str(folder / "scene.json"), "", False, "", str(folder), False, False, 0.8)  # no cache, pause or window
    base.initSimulation()
    model, clock = sph.Simulation.getCurrent().getFluidModel(0), sph.TimeManager.getCurrent()

    def positions() -> np.ndarray:  # float32, the solver's own memory; behind these are those that emitters keep
        return np.asarray(model.getFieldBuffer("position"))[: model.numActiveParticles()]

    shown, begun = gb.Scene(positions(), surface="smooth", spacing=spacing), time.process_time()

    def after_step() -> None:
        start = time.process_time()
        if clock.getTime() * 30 >= len(images):
            shown.update(positions=positions())
            images.append(gb.render(shown, gb.Camera((0.8, 1.2, 2.6), (0.8, 0.35, 0.2)), (320, 240)).image)
        seconds.append(time.process_time() - start)

    base.setTimeStepCB(after_step)
    base.runSimulation()
    part = sum(seconds) / (time.process_time() - begun)
gb.save_png("splishsplash.png", np.hstack([images[k] for k in np.linspace(0, len(images) - 1, 4).astype(int)]))
print(f"{len(shown):,} particles, {len(seconds)} steps; {len(images)} images took {part:.1%} of the processor time")
