"""Rows of a table to particles: which columns are numbers, and which of these are whole."""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..data.particles import Particles
from .asciinum import is_number, parse_plain, parse_rows, parse_words
from .errors import FormatError, bad, names_of, shown
from .fields import MOST_LOOKED_AT, columns_advice, find_positions, join_columns, names_with_id, particles_from
from .units import in_one_unit

NO_NUMBER = ("", "NA", "<NA>", "N/A", "#N/A", "n/a", "NULL", "null", "None", "--")  # in the place of a number
Rest = tuple[bytes, int] | None  # a text, and the byte from which its rows are plain


_TRUTH = {"true": 1, "false": 0}


class NotPlainError(Exception):
    """A table that needs more than its first rows to tell how it is read."""


def particles_of_rows(
    path: Any,
    names: list[str],
    words: list[str],
    lines: list[str],
    first_line: int,
    separator: str | None,
    names_line: int | None = None,
    extra: Mapping[str, np.ndarray] | None = None,
    rest: Rest = None,
    units: dict[str, str] | None = None,
    unnamed: bool = False,
) -> Particles:
    """Particles from rows; `words` is the first row, which tells the numbers from the words. rest:
    plain rows behind them. units: of columns, which are those after. unnamed: the file has no names.
    Raises FormatError, NotPlainError."""
    numeric = [
        i
        for i, word in enumerate(words)
        if (is_number(word) or names[i].lower() in ("x", "y", "z", "-z"))  # there, a word is a mistake
        and (names[i] or not any(names))
    ]
    found = names_of(names)
    advice = f"; {columns_advice(names)}" if names_line else ""
    where = f"line {names_line or first_line}"
    no_positions = bad(path, where, f"expected columns x, y and z, got {found}{advice}")
    # Two numbers beside a word without a name are not a place in a plane: one of three is damaged.
    if len(numeric) < 2 or (len(numeric) == 2 < len(words) and names_line is None):
        raise no_positions
    options: dict[str, Any] = {"delimiter": separator, "quotechar": '"'}
    if separator is None:
        options["comments"] = "#"
    if len(numeric) < len(words):
        options["usecols"] = numeric
    try:
        rows = parse_rows(path, lines, first_line, len(numeric), **options)
    except FormatError:  # a missing number of an attribute is NaN; a missing position is a mistake
        as_they_are = lines
        if separator:
            lines = [line if line.strip(f'{separator} \t\r"') else "" for line in lines]
        filled = _with_nan(lines, separator)
        if filled == as_they_are:
            raise
        rows, lines = parse_rows(path, filled, first_line, len(numeric), **options), filled
        places = [k for k, i in enumerate(numeric) if names[i].lower() in ("x", "y", "z")]
        if np.isnan(rows[:, places or [0, 1, 2]]).any():
            raise
    found_columns = list(rows.T)
    if rest:
        whole = parse_plain(*rest, separator, len(words), numeric, rows) if separator else None
        if whole is None:
            raise NotPlainError
        found_columns = whole
    columns: dict[str, np.ndarray] = {}
    for column, i in zip(found_columns, numeric, strict=True):
        name = names[i] or f"column{i + 1}"
        if name in columns:
            raise bad(path, "line 1", f"expected different column names, got {shown(name)} twice")
        if rest and is_long(column, words[i]):
            raise NotPlainError
        columns[name] = whole_numbers(path, name, column, words[i], lines, i, **options)
    for name, word, i in zip(names, words, range(len(words)), strict=True):
        if name and name not in columns and word.lower() in _TRUTH:
            if rest:
                raise NotPlainError
            found_words = [one.strip().lower() for one in parse_words(lines, i, **options)]
            if {*found_words} <= _TRUTH.keys():
                columns[name] = np.array([_TRUTH[one] for one in found_words])
    if units:
        units.update(in_one_unit(path, columns, units))
    if unnamed and is_whole(words[0]):
        columns = dict(zip(_names_with_id(path, columns), columns.values(), strict=True))
    arrays = join_columns(columns)
    points = find_positions(arrays)
    if points is None:
        raise no_positions
    more = {name: array for name, array in (extra or {}).items() if len(array) == len(points)}
    particles = particles_from(path, points, more | arrays)
    left_out = [name for i, name in enumerate(names) if name and i not in numeric and name not in columns]
    particles.names = {name: {} for name in left_out}
    return particles


def _names_with_id(path: Any, columns: Mapping[str, np.ndarray]) -> list[str]:
    first = next(iter(columns.values()))
    if len(first) < 3:
        return list(columns)
    head = np.stack([column[:MOST_LOOKED_AT] for column in columns.values()], axis=1)
    return names_with_id(path, list(columns), head, float(first[-1]), len(first))


def _with_nan(lines: list[str], separator: str | None) -> list[str]:
    """Lines with nan where there is no number between two separators."""
    mark = re.escape(separator) if separator else r"\s+"
    words = "|".join(map(re.escape, NO_NUMBER if separator else NO_NUMBER[1:]))
    nothing = re.compile(rf"(^|{mark}) *(?:{words}) *(?={mark}|$)")
    return [nothing.sub(r"\1nan", line) if line.strip() else line for line in lines]


def whole_numbers(
    path: Any, name: str, column: np.ndarray, first_word: str, lines: Sequence[str], i: int, **options: Any
) -> np.ndarray:
    """A column (N,) float64, as whole numbers where all are and the first is written without a
    point: int64, or uint64 beyond.

    Args:
        name: of the column, for the warning that float64 rounds its numbers.
        lines: the rows as text, from whose i-th words numbers come that float64 would round.
        options: those of numpy.loadtxt that the rows were read with.
    """
    if not is_long(column, first_word):
        exact = is_whole(first_word) and (column == np.rint(column)).all()
        return column.astype(np.int64) if exact else column
    words = parse_words(lines, i, **options)
    if all(map(is_whole, words)):
        for kind in (np.int64, np.uint64):
            with contextlib.suppress(OverflowError):
                return np.array([int(word) for word in words], kind)
    if rounded := next((w for w in words if is_whole(w) and float(w) != int(w)), ""):
        warnings.warn(f"{path}: column {shown(name)}: float64 rounds {shown(rounded)}", stacklevel=2)
    return column


def is_long(column: np.ndarray, first_word: str) -> bool:
    """Whether a column (N,) of whole numbers may have some that float64 does not hold."""
    return is_whole(first_word) and bool((np.abs(column) >= 2.0**53).any())


def is_whole(word: str) -> bool:
    """Whether a word is a whole number, perhaps with a sign."""
    return word.lstrip("+-").isdigit()


def default_names(n: int) -> list[str]:
    """The names of n columns of which no name is known."""
    return ["x", "y", "z", *(f"column{i}" for i in range(4, n + 1))][:n]
