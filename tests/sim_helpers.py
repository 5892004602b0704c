"""What tests of simulations share: rows of experiments, blocks of tissue, states on disk."""

import globule as gb
import numpy as np
from globule._base.settings import settings_of
from globule.sim import checkpoint
from globule.sim.scene_file import SceneFile, Vessel

from bench.tables.physics_tissue import SPACING, lattice


def tables(table: type = SceneFile) -> set[type]:
    """The tables of a scene: a table, and all those in it."""
    found = {table}
    for one in settings_of(table).values():
        inner = getattr(one.kind, "kind", one.kind)  # of a list
        found |= tables(inner) if isinstance(inner, type) else set()
    return found


def check(rows) -> None:
    rows = [row if isinstance(row, dict) else row._asdict() for row in rows]
    assert rows
    assert not [row for row in rows if not row["ok"]]


def jittered(shape, by: float = 0.1, seed: int = 0, spacing: float = SPACING) -> np.ndarray:
    """A lattice whose particles are up to `by` spacings off their places, float32."""
    off = np.random.default_rng(seed).uniform(-by, by, (np.prod(shape), 3))
    return (lattice(*shape, spacing) + off * spacing).astype("f4")


def tissue_and_blood(
    backend, positions, young=2500.0, fixed=None, model="solid", tissue=None, tension=0.0, **keys
) -> gb.Simulation:
    """Tissue of one body at `positions`, of particles 4 mm apart, and blood that a test adds."""
    blood = {"name": "blood", "density": 1060.0, "viscosity": 0.0035, "surface_tension": tension}
    solid = {"name": "tissue", "density": 1000.0, "surface_tension": tension}
    scene = {
        "spacing": 0.004, "domain": {"lo": (-0.1, -0.1, -0.1), "hi": (0.1, 0.1, 0.1)},
        "solver": {"max_error": 0.01, "divergence_error": 0.001},
        "fluids": [blood], "solids": [solid | (tissue or {})],
    }  # fmt: skip
    sim = gb.Simulation(scene | keys, **backend)
    ids = sim.add(positions, "tissue")
    if young is not None:
        sim.tissue.bond(ids, young, fixed, model)
    return sim


def vessel(path, radius: float, pressure: float, pool: float, fluid: str = "blood") -> Vessel:
    return Vessel(name="vein", solid="tissue", fluid=fluid, path=path, radius=radius,
                  pressure=pressure, pool=pool)  # fmt: skip


def reloaded(sim: gb.Simulation, folder, change=None) -> gb.Simulation:
    """A simulation from its checkpoint, whose arrays and facts `change` may have changed first."""
    sim.save(folder / "state.npz")
    if change is not None:
        arrays, facts = checkpoint.load(folder / "state.npz")
        arrays = dict(arrays)
        change(arrays, facts)
        checkpoint.save(folder / "state.npz", arrays, facts)
    return gb.Simulation.load(folder / "state.npz", device="cpu")


def assert_same_state(one: gb.Simulation, other: gb.Simulation) -> None:
    states = one.arrays.state(), other.arrays.state()
    assert states[0].keys() == states[1].keys()
    for name, value in states[0].items():
        np.testing.assert_array_equal(value, states[1][name], err_msg=name)
