"""Modules that have moved stay importable by their old names for one version, with a warning."""

from __future__ import annotations

import importlib
import sys
import warnings
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.abc import Loader as _Loader
else:
    _Loader = object  # `importlib.abc` takes 15 ms to import

MOVED = {
    "attributes": "scene.attributes",
    "calibration": "ultrasound.calibration",
    "colormaps": "_base.colormaps",
    "legend": "render.legend",
    "slices": "volumes.slices",
    "trust": "ultrasound.trust",
    "volume_particles": "volumes.iso_surface",
}


class _Moved(_Loader):
    """A finder and loader."""

    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        package, _, module = name.partition(".")
        moved = package == "globule" and module in MOVED
        return ModuleSpec(name, self) if moved else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        new = "globule." + MOVED[spec.name.partition(".")[2]]
        warnings.warn(
            f"{spec.name} has moved to {new}; the old name goes with the next version",
            DeprecationWarning,
            stacklevel=2,  # the import system's own frames are not counted
        )
        self._module = importlib.import_module(new)
        self._spec = self._module.__spec__
        return self._module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec  # the import system has put the old name's there


def install() -> None:
    """Answer imports of old names from here on."""
    sys.meta_path.append(_Moved())
