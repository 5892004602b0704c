"""What the tests of the command line share: a cube of particles, commands, refusals."""

import json
import os
import sys
from collections.abc import Callable
from typing import Any

import globule as gb
import numpy as np
import pytest
from globule.cli import main

COMMAND = [sys.executable, "-m", "globule"]
SMALL = ["--size", "40x30", "--device", "cpu"]


def cube(n: int = 6, **fields) -> gb.Particles:
    axis = np.arange(n, dtype=np.float32) / n
    return gb.Particles(np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3), **fields)


def volume(path) -> None:
    """A bright ball in a dark volume."""
    import SimpleITK as sitk

    z, y, x = np.mgrid[-1:1:16j, -1:1:16j, -1:1:16j]
    sitk.WriteImage(sitk.GetImageFromArray(200 * np.exp(-(x * x + y * y + z * z) * 2)), str(path))


def refused(capsys, *words: str) -> str:
    """The one line that a mistake is answered with; nothing may have been written."""
    before = sorted(os.listdir())
    assert main(list(words)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("globule: error: "), err
    assert err.count("\n") == 1, err
    assert sorted(os.listdir()) == before
    return err


def refuses(message: str, call: Callable[..., object], /, *args: Any, error: Any = ValueError, **options: Any) -> None:
    """A call with these arguments raises an error of one line that matches."""
    with pytest.raises(error, match=message) as caught:
        call(*args, **options)
    assert "\n" not in str(caught.value)


def output_of(capsys, *words: str) -> Any:
    """What a command that succeeds says: out and err."""
    assert main([*words]) == 0
    return capsys.readouterr()


def run_json(capsys, *words: str) -> dict:
    """What a command says of itself with --json."""
    assert main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def at_edge(mask: np.ndarray) -> bool:
    """Whether a mask has anything at the border of the image."""
    return bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())
