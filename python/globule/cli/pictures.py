"""The images of a volume that `reconstruct` writes: three planes, and the surface."""

from __future__ import annotations

import argparse

from ..volumes.volume import Volume


def wanted(options: argparse.Namespace) -> bool:
    """Whether the options ask for an image."""
    return bool(options.three_view or options.surface_image)


def draw(volume: Volume, options: argparse.Namespace, messages: list[str]) -> None:
    """Write the images that the options ask for; a volume without a surface adds a message."""
    if options.three_view:
        from ..volumes.slices import save_three_view

        save_three_view(options.three_view, volume, projections=options.projections)
    if options.surface_image:
        from ..volumes.iso_surface import save_surface

        try:
            save_surface(options.surface_image, volume, device=options.device, threads=options.threads)
        except ValueError as error:
            messages.append(f"--surface-image: no image written: {error}")
