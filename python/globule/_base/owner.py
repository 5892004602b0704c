"""Objects that own memory of the core."""

from __future__ import annotations

from typing import Any


class Owner:
    """Base of what owns memory of the core: two such objects would change each other's."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        """What `copy` and `pickle` call. Raises TypeError."""
        name = type(self).__name__
        raise TypeError(
            f"{name}: cannot be copied or pickled, since it owns memory of the core; "
            "make another one from the same data"
        )
