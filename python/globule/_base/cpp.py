"""The folders in which C++ programs find globule: its headers, its library, and the
files for CMake."""

from __future__ import annotations

from pathlib import Path

_HERE = Path(__file__).resolve().parents[1]  # the package


def cmake_dir() -> str:
    """The folder of globuleConfig.cmake, for `find_package(globule)`:

        cmake -B build -Dglobule_DIR="$(python -c 'import globule as g; print(g.cmake_dir())')"

    Raises FileNotFoundError where this package was installed without it.
    """
    return _existing(_HERE / "cmake", "globuleConfig.cmake")


def include_dir() -> str:
    """The include folder of `<globule/globule.hpp>`. The library libglobule.so is in the package's
    own folder.

    Raises FileNotFoundError where this package was installed without it.
    """
    return _existing(_HERE / "include", "globule/globule.hpp")


def _existing(folder: Path, file: str) -> str:
    if not (folder / file).is_file():
        raise FileNotFoundError(
            f"{folder / file}: expected the file of an installed globule; install it again with pip"
        )
    return str(folder)
