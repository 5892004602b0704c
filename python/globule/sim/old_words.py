"""Names of the version before: they work for one version more, with a DeprecationWarning."""

from __future__ import annotations

import warnings
from typing import Any

# Of `Simulation`: where each has gone.
OLD_NAMES = {
    "advance": "run",
    "advance_to": "run_to",
    "instruments": "tools",
    **{name: f"arrays.{name}" for name in ("neighbors", "phase", "pressure", "set_state", "state")},
    **{
        name: f"record.{name}"
        for name in ("counts", "diagnostics", "measure", "n_born", "n_cut", "n_removed", "seconds",
                     "totals")
    },
    **{
        name: f"steer.{name}"
        for name in ("apply_force", "body", "make_rigid", "move_boundary", "set_sinks")
    },
    **{
        name: f"tissue.{name}"
        for name in ("ablate", "add_vessel", "bond", "cut", "elastic_energy", "n_bonds", "n_pieces",
                     "piece", "pools", "vessels")
    },
    **{name: f"tools.{name}" for name in ("grasp", "move_grasp", "release", "set_pushers")},
}  # fmt: skip
OLD_SETTINGS = {
    "density_error": "max_error",
    "least_iterations": "min_iterations",
    "longest_step": "max_dt",
    "most_iterations": "max_iterations",
}
_OLD_KEYS = {"phases", "walls", "periodic", "cfl", "weakly_compressible", *OLD_SETTINGS,
             "divergence_error", "viscosity_error", "sound_speed", "extra_viscosity"}  # fmt: skip
_LISTS = {"fluid": "fluids", "tissue": "solids", "boundary": "boundaries", "rigid": "rigids"}


def renamed(what: str, names: dict[str, str], name: str) -> str:
    """The name that an old one stands for, with a warning for the caller's caller.

    Raises:
        AttributeError: a name that is not an old one.
    """
    if name not in names:
        raise AttributeError(f"{what} has no {name!r}")
    warn(f"{what}.{name} is now {what}.{names[name]}", 4)
    return names[name]


def warn(message: str, stacklevel: int) -> None:
    """A DeprecationWarning that the old name goes with the next version."""
    message += "; the old name goes with the next version"
    warnings.warn(message, DeprecationWarning, stacklevel=stacklevel)


def with_old_keys(scene: Any) -> Any:
    """A dict of the version before (two corners as domain, phases, walls) in a scene's words;
    anything else as it is."""
    if not isinstance(scene, dict):
        return scene
    corners = hasattr(scene.get("domain"), "__len__") and not isinstance(scene["domain"], dict)
    if not corners and not _OLD_KEYS & set(scene):
        return scene
    warn("a dict with `phases`, `walls` or two corners as `domain` is now a scene's dict", 4)
    old = dict(scene)
    walls, periodic = old.pop("walls", True), old.pop("periodic", ())
    domain = old.pop("domain", None)
    new: dict[str, Any] = {"gravity": (0.0, -9.81, 0.0)}
    if domain is not None:
        new["domain"] = domain
    if corners:
        lo, hi = domain
        axes = [axis for axis, on in zip("xyz", periodic, strict=False) if on]
        new["domain"] = {"lo": lo, "hi": hi, "walls": bool(walls), "periodic": axes}
    solver: dict[str, Any] = {"divergence_error": 0.001}
    if "weakly_compressible" in old:
        solver["method"] = "wcsph" if old.pop("weakly_compressible") else "dfsph"
    for name in _OLD_KEYS & set(old) - {"phases"}:
        solver[OLD_SETTINGS.get(name, name)] = old.pop(name)
    for phase in old.pop("phases", [{"name": "fluid"}]):
        table = dict(phase)
        kind = str(table.pop("kind", "fluid"))
        if kind == "fluid":
            table = {"viscosity": 0.0, "implicit": False, **table}
        new.setdefault(_LISTS.get(kind, kind), []).append(table)
    return {**new, "solver": solver, **old}
