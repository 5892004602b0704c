"""The figures of the thesis, drawn again from the results of this code.

`FIGURES` maps the number of a figure to a function (path, device, dpi) that writes a PNG file. The
first paragraph of its docstring is the caption. The figures need matplotlib, the extra `figures`.
"""

from __future__ import annotations

from collections.abc import Callable

from . import anatomy, artefacts, fusing, kernels, leaves, levels, rays, rendered, steps, z_order

FIGURES: dict[str, Callable[..., None]] = {
    "2.1": z_order.in_the_plane,
    "2.2": leaves.in_the_plane,
    "2.3": leaves.in_space,
    "2.4": kernels.one_metaball,
    "2.5": fusing.two_metaballs,
    "3.4": z_order.interleaving,
    "3.5": levels.keys_and_neighbors,
    "3.6": levels.quantised_positions,
    "3.7": z_order.in_space,
    "3.8": levels.dense_array,
    "3.9": kernels.all_kernels,
    "5.1": artefacts.step_size,
    "5.3": rays.exterior_spheres,
    "5.4": rays.ordered_events,
    "5.5": steps.several_thresholds,
    "5.6": artefacts.ghosts,
    "5.7": steps.skipped_neighbors,
    "5.8": artefacts.normals,
    "6.1": rendered.close_up,
    "6.2": rendered.scattered,
    "6.3": rendered.solid,
    "6.4": anatomy.brain,
    "6.5": rendered.border,
    "6.6": anatomy.colored_mesh,
}


def caption(name: str) -> str:
    """The caption of a figure, a key of `FIGURES`, in one sentence."""
    return (FIGURES[name].__doc__ or "").partition("\n\n")[0].replace("\n    ", " ")
