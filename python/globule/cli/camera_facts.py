"""A camera in reports, so that flags can give it back."""

from __future__ import annotations

from typing import Any

from ..render.camera import Camera


def facts(camera: Camera) -> dict[str, Any]:
    """Eye, look_at and up, world; fov, degrees, or height, world units; and the flags for them."""
    angle = {"fov": camera.fov} if camera.height is None else {"height": camera.height}
    place = {"eye": camera.eye, "look_at": camera.look_at, "up": camera.up}
    return {**place, **angle, "flags": words(camera)}


def words(camera: Camera) -> str:
    """The flags of `globule render` that give this camera, in float32's precision."""
    angle = ("--fov", camera.fov) if camera.height is None else ("--ortho", camera.height)
    places = {"--eye": camera.eye, "--look-at": camera.look_at, "--up": camera.up}
    text = [f"{flag} {','.join(f'{v:.9g}' for v in value)}" for flag, value in places.items()]
    return " ".join([*text, f"{angle[0]} {angle[1]:.9g}"])
