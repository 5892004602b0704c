"""Which of many cases `make test` runs."""

from collections.abc import Iterable
from typing import Any

import pytest


def every(step: int, cases: Iterable[Any], first: int = 0) -> list[Any]:
    """The cases, of which each so-many-th is quick: the others run in `make test-all`."""
    slow = pytest.mark.slow
    return [case if k % step == first else pytest.param(case, marks=slow) for k, case in enumerate(cases)]
