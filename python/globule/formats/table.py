"""Tables of numbers: .xyz (blank-separated) and .csv (separated by commas, semicolons, tabs,
bars or blanks).

.xyz  columns x y z [more]; with a comment before the rows it is read as a .csv. A count and a title
      may come before the rows (XMol), and an element or type before each of them; a .pts has a
      count alone.
.csv  the first line may name the columns, with units: `x [m]`, `rho (kg/m3)`; columns that are not
      numbers are left out. Lines that begin with # or % are comments; the last of them with names
      of places names the columns where no other line does. A missing number of an attribute is NaN:
      a cell that is empty, `NA`, `N/A`, `null` or `None`.
      Decimal commas are understood where they do not separate.

Two columns x and y without z lie in the plane z = 0.

Columns without a name become attributes `column4`, `column5` and so on.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.files import atomic_write
from ..data.particles import Particles
from .asciinum import decoded, format_rows, is_number, lines_of, text_data
from .contents import Contents
from .elements import of_elements, type_names
from .errors import FormatError, bad, names_of, shown
from .fields import place_names, split_columns
from .frames import frame_by_column, tells_frames, text_frame
from .packed import is_packed, unpacked_head
from .rows import NO_NUMBER, NotPlainError, Rest, default_names, particles_of_rows
from .units import held_units, meters, split_units

# Columns of a .pts file, by their number: the intensity, and colors up to 255.
_POINTS = {
    3: ["x", "y", "z"],
    4: ["x", "y", "z", "intensity"],
    6: ["x", "y", "z", "red", "green", "blue"],
    7: ["x", "y", "z", "intensity", "red", "green", "blue"],
}
_PLAIN = 1 << 22  # bytes of a .csv that pays for loading pyarrow
_HEAD = 1 << 16  # bytes of it that tell its columns
_MOST_TITLES = 20  # lines before the names of the columns
_MOST_UNITS = 4  # lines behind them, up to that with the units
_MOST_WHOLE = 100  # rows in which a decimal comma is looked for
_MOST_BLANK = 10_000  # rows in which the first word of a column is looked for
_NOTE = re.compile(r"\s#(?!N/A)")  # behind a row
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:(?:\.\d{3})+,|(?:,\d{3})+\.)\d+")
_NAMED = 1 << 13  # bytes in which the names of columns are looked for


# The last table of several frames that was read: what tells its state, and all of it.
_table: tuple[tuple, Contents] | None = None


def read_csv(path: str | os.PathLike[str], columns: Mapping[str, str] | None = None, frame: int | None = 0) -> Contents:
    """Read a .csv. Columns of whole numbers without a point become int64, others float64.

    `columns`: field or attribute -> column; "x", "y" and "z" are the position. `frame`: of a table of
    several, which `frames_by_column` tells; None: all rows.
    """
    global _table
    state = os.stat(str(path))  # also of a packed one, which has another copy each time
    key = (os.path.abspath(str(path)), state.st_mtime_ns, state.st_size, tuple((columns or {}).items()))
    if frame is None:
        return _whole_csv(path, columns)
    known = _table
    if known is not None and known[0] == key:
        return frame_by_column(path, known[1], frame)
    contents = _whole_csv(path, columns)
    found = frame_by_column(path, contents, frame)
    _table = (key, contents) if found.n_frames > 1 else None
    return found


def may_have_frames(path: str | os.PathLike[str]) -> bool:
    """Whether a name in the first lines of a table may be that of a column that tells frames."""
    if is_packed(path):
        head = unpacked_head(path, _NAMED)
    else:
        with open(path, "rb") as file:
            head = file.read(_NAMED)
    lines = decoded(head).splitlines()[: _MOST_TITLES + 1]
    return any(tells_frames(word) for line in lines for word in re.split(r'[\s;,|"\[(]+', line))


def _whole_csv(path: str | os.PathLike[str], columns: Mapping[str, str] | None) -> Contents:
    data = text_data(path)
    if len(data) >= _PLAIN:
        head = data.find(b"\n", _HEAD) + 1
        try:
            return _read_csv(path, lines_of(path, data[:head]), columns, (data, head))
        except (FormatError, NotPlainError):
            pass  # as a whole, which says the line at fault
    return _read_csv(path, lines_of(path, data), columns)


def read_xyz(path: str | os.PathLike[str], frame: int | None = 0) -> Contents:
    """Read an .xyz. Columns of whole numbers without a point become int64, others float64."""
    found = text_frame(path, frame or 0, _frames_of_xyz)
    return Contents(_read_xyz(path, found.lines, found.before), n_frames=found.n_frames)


def _frames_of_xyz(_: Any, lines: list[str]) -> list[int]:
    """Where each frame's count stands, in a file that consists of a count, a title and as many
    rows again and again; else [0]."""
    starts: list[int] = []
    at = 0
    while at < len(lines):
        if not (line := lines[at].strip()) and starts:  # a blank line between frames
            at += 1
            continue
        if not (line.isascii() and line.isdigit() and len(line) < 16):
            return [0]
        starts.append(at)
        at += int(line) + 2
    return starts if len(starts) > 1 and at <= len(lines) else [0]


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write a table with one named column per number."""
    columns = split_columns(particles)
    separator = "," if _is_csv(path) else " "
    for name in columns:
        if not _is_csv(path) and (name.split() != [name] or name.startswith("#")):
            raise ValueError(f"attributes[{name!r}]: expected a name without blanks for {path}")
    with atomic_write(path) as file:
        if _is_csv(path):
            file.write(",".join(map(_quoted, columns)).encode() + b"\n")
        else:
            file.write(f"# {' '.join(columns)}\n".encode())
        file.writelines(format_rows(list(columns.values()), separator))


def _is_csv(path: str | os.PathLike[str]) -> bool:
    return os.fspath(path).lower().endswith(".csv")


def _quoted(name: str) -> str:
    if any(mark in name for mark in '",;|\t\r\n') or name != name.strip():
        return '"' + " ".join(name.splitlines()).replace('"', '""') + '"'
    return name


def _read_csv(path: Any, lines: list[str], named: Mapping[str, str] | None = None, rest: Rest = None) -> Contents:
    """rest: plain rows behind the lines. Raises FormatError; NotPlainError where they are not."""
    start = next((i for i, line in enumerate(lines) if _is_row(line)), None)
    if start is None and (names_alone := named_line(lines)):
        lines, start = [names_alone], 0
    if start is None:
        raise bad(path, "line 1", "expected column names or numbers, got an empty file")
    start = _titles(lines, start)
    separator = separator_of(lines[start])
    names, head, unnamed = _csv_words(path, lines[start], start, separator), start, False
    comments = [i for i, line in enumerate(lines[:start]) if line.strip()]
    texts = ((i, _said_names(path, lines[i], i, separator, len(names))) for i in comments[:-_MOST_TITLES:-1])
    named_by = next((one for one in texts if place_names(split_units(one[1])[0])), None)
    numbers = sum(is_number(name) or has_comma(name) for name in names)
    if numbers == len(names) or (named_by and numbers > 1):
        said: list[str] = []
        if comments:
            head = comments[-1]
            head, said = named_by or (head, _said_names(path, lines[head], head, separator, len(names)))
        words_only = said and not any(map(is_number, said))
        names = said if words_only else default_names(len(names))
        unnamed = not words_only
    else:
        start += 1
        if all(re.fullmatch("'[^']*'", name) for name in names):
            names = [name.strip("'") for name in names]
        for i in [i for i in range(start, start + _MOST_UNITS) if i < len(lines) and _is_row(lines[i])]:
            said_below = _units_below(path, names, _csv_words(path, lines[i], i, separator))
            if said_below is not names:
                names, start = said_below, i + 1
                break
    first = next((i for i in range(start, len(lines)) if _is_row(lines[i])), None)
    words = ["0"] * len(names)
    if first is not None:
        words, start = _csv_words(path, lines[first], first, separator), first
        if len(words) == 1 < len(names) and words[0] == str(sum(map(_is_row, lines[first + 1 :])) or ""):
            first += 1  # behind how many follow, by CloudCompare
            words, start = _csv_words(path, lines[first], first, separator), first
        if len(words) == len(names) + 1:
            if not words[-1]:  # a separator ends each row
                names = [*names, ""]
            elif lines[first].startswith('"'):  # the name of a row, by R
                names = ["", *names]
    if len(words) != len(names):
        raise bad(path, f"line {start + 1}", f"expected {len(names)} columns, got {len(words)}")
    rows = lines[start:]
    missing = any(word in NO_NUMBER for word in words)
    if rest and (first is None or missing):
        raise NotPlainError
    if first is not None and missing:
        _fill_words(path, names, words, lines[first + 1 : first + _MOST_BLANK], separator)
    if any("#" in row or "%" in row for row in rows):
        rows = ["" if row.lstrip()[:1] in ("#", "%") else row for row in rows]
    names, units = split_units(said_names := names)
    plain_names = dict(zip(said_names, names, strict=True))
    if named is not None:
        unnamed = False
        named = {ours: plain_names.get(theirs, theirs) for ours, theirs in named.items()}
        names = _renamed(path, names, named)
        units = {ours: units[theirs] for ours, theirs in named.items() if theirs in units}
    else:
        axes = place_names(names)
        names = [axes.get(name, name) for name in names]
        units = {axes.get(name, name): unit for name, unit in units.items()}
    some = lines[first : first + _MOST_WHOLE] if first is not None else []
    cells = [word for row in some for word in _csv_words(path, row, 0, separator)] if "," in "".join(some) else []
    if cells and first is not None and named is None:
        _no_thousands(path, some, first + 1, separator)
    if comma := next(filter(has_comma, cells), ""):
        if point := next((word for word in cells if "." in word and is_number(word)), ""):
            problem = f"expected one decimal mark in all numbers, got {shown(comma)} and {shown(point)}"
            raise bad(path, f"line {start + 1}", problem)
        rows = [_with_points(row, separator) for row in rows]
        words = [word.replace(",", ".") if has_comma(word) else word for word in words]
    try:
        particles = particles_of_rows(path, names, words, rows, start + 1, separator, head + 1, rest=rest, units=units,
                              unnamed=unnamed)  # fmt: skip
    except FormatError:
        _no_thousands(path, lines[start:], start + 1, separator)
        raise
    return Contents(particles, units=held_units(particles, units))


def named_line(lines: list[str]) -> str:
    """The first comment that names places, without its mark; empty where none does."""
    plain = (line.strip().lstrip("#%/! ") for line in lines[:_MOST_TITLES])
    return next((line for line in plain if place_names(split_units(line.split(separator_of(line)))[0])), "")


def _said_names(path: Any, line: str, i: int, separator: str | None, n: int) -> list[str]:
    """The words of a comment that names n columns, perhaps behind a word for them or with their numbers;
    none of another comment. Names between blanks may have a unit behind them, or blanks of their own
    where two and more separate them: as of COMSOL."""
    text = re.sub(r"(?<!\S)(?:\[\d+\][=:]?|\d+[:=])(?=[^\W\d])", "", line.strip().lstrip("#%/! "))
    if re.fullmatch(r"format \S+", text):  # Yade's: `#format x_y_z_r_matId`
        text = re.sub(r"_r(?=_|$)", "_radius", text[7:]).replace("_", " ")
    for said in (re.sub(r"^(?i:c|columns|fields|names|variables)\b:? +", "", text), text):
        for mark in dict.fromkeys((separator, separator_of(said))):
            if len(words := _csv_words(path, said, i, mark)) == n:
                return words
        for words in (re.sub(r"\s+([\[(][^\])]*[\])])", r"\1", said).split(), re.split(r"\s{2,}", said.strip())):
            if len(words) == n:
                return words
    return []


def _units_below(path: Any, names: list[str], words: list[str]) -> list[str]:
    """Names with the units that the row below them has for each place, as loggers write them; the
    names as they are without such a row."""
    if any(map(is_number, words)) or len(words) != len(names):
        return names
    axes = place_names(names)
    places = [word.strip("[]()") for name, word in zip(names, words, strict=True) if axes.get(name, name) in ("x", "y")]
    if len(places) != 2 or not all(map(meters, places)):
        return names
    return [
        f"{name} [{plain}]" if (plain := word.strip("[]()")) else name for name, word in zip(names, words, strict=True)
    ]


def _titles(lines: list[str], start: int) -> int:
    """The line that names x and y behind titles that name no place, as EDEM and CFD-Post write
    them; `start` where there is none."""
    for i in range(start, min(start + _MOST_TITLES, len(lines) - 1)):
        words = [word.strip('" ') for word in lines[i].split(separator_of(lines[i]))]
        if all(map(is_number, words)):
            break
        if place_names(split_units(words)[0]):
            return i
    return start


def _is_row(line: str) -> bool:
    text = line.strip()
    return bool(text.strip(';,|\t"-=+ ')) and text[0] not in "#%"  # rows of separators alone; a line below names


def separator_of(line: str) -> str | None:
    """Semicolon, comma, tab, bar, or None for blanks; quoted text and the commas of numbers do not
    count."""
    plain = _NOTE.split(re.sub(r'"[^"]*"', "_", line), maxsplit=1)[0]
    if all(map(has_comma, plain.split())) and len(plain.split()) > 1:
        plain = plain.replace(",", ".")
    for mark in (";", ",", "\t", "|"):
        if mark in plain:
            return mark
    return None if len(plain.split()) > 1 else ","


def has_comma(word: str) -> bool:
    """Whether a word is a number with a decimal comma."""
    return re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?|[+-]?\d+,", word) is not None


def _no_thousands(path: Any, rows: list[str], first_line: int, separator: str | None) -> None:
    """Raises FormatError for a number such as 1.500,25."""
    for i, row in enumerate(rows, first_line):
        if word := next(filter(_THOUSANDS.fullmatch, _csv_words(path, row, i - 1, separator)), ""):
            problem = f"expected numbers without separators of thousands, got {shown(word)}"
            raise bad(path, f"line {i}", problem) from None


def _with_points(row: str, separator: str | None) -> str:
    """A row with decimal points in place of commas; where commas separate, in quotes alone."""
    if separator != ",":
        return row.replace(",", ".")
    return re.sub(r'"([+-]?\d*),(\d*(?:[eE][+-]?\d+)?)"', r"\1.\2", row)


def _renamed(path: Any, names: list[str], named: Mapping[str, str]) -> list[str]:
    """Names by those that a caller gives; the others are left out, as empty names."""
    if not {"x", "y"} <= named.keys():
        problem = f"expected a column for x and for y among those named, got {names_of(named)}"
        raise bad(path, "", f"{problem}; its columns are {names_of(names)}")
    for column in named.values():
        if column not in names:
            raise bad(path, "line 1", f"expected the column {shown(column)}, got {names_of(names)}")
    wanted = {column: name for name, column in named.items()}
    if twice := [name for name, column in named.items() if wanted[column] != name]:
        column = named[twice[0]]
        problem = f"expected different columns, got {shown(column)} for {twice[0]} and {wanted[column]}"
        raise bad(path, "line 1", problem)
    return [wanted.get(name, "") for name in names]


def _csv_words(path: Any, line: str, i: int, separator: str | None) -> list[str]:
    if separator is None:
        line = _NOTE.split(line, maxsplit=1)[0]
        return [word.strip('"') for word in re.findall(r'"[^"]*"|\S+', line)] if '"' in line else line.split()
    try:
        return [word.strip() for word in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error as error:
        raise bad(path, f"line {i + 1}", f"expected separated values, got {error}") from None


def _fill_words(path: Any, names: list[str], words: list[str], lines: list[str], separator: str | None) -> None:
    """For named columns that miss a number in the first row, the first word of a later row."""
    blank = [i for i, word in enumerate(words) if word in NO_NUMBER and names[i]]
    for line in lines:
        if not blank:
            return
        row = _csv_words(path, line, 0, separator) if _is_row(line) else []
        for i in [i for i in blank if i < len(row) and row[i] not in NO_NUMBER]:
            words[i] = row[i]
            blank.remove(i)


def _read_xyz(path: Any, lines: list[str], before: int = 0) -> Particles:
    """before: how many lines of the file come before these."""
    start, count = 0, None
    head = lines[0].split()
    if len(head) == 1 and head[0].isascii() and head[0].isdigit() and len(head[0]) < 16:
        count, start = int(head[0]), 2  # XMol: a count, a title
        if os.fspath(path).lower().endswith(".pts") or _is_points(lines, count):
            start = 1
    first = next((line for line in lines[start:] if line.strip() and not line.strip().startswith("#")), "")
    words = first.partition("#")[0].split()
    if not words and count != 0:
        raise bad(path, f"line {len(lines)}", "expected rows x y z, got none")
    rows = lines[start:]
    if count is not None and any("#" in line for line in rows):
        rows = [line.partition("#")[0] for line in rows]
    elements: dict[str, np.ndarray] = {}
    kinds: dict[str, dict[int, str]] = {}
    names = _POINTS.get(len(words), default_names(len(words)))
    if start != 1:
        first_words = _first_words(rows, words, count)
        if first_words and first_words[0].isdigit():
            elements = {"type": np.array(first_words, np.int64)}
        elif first_words:
            elements = of_elements(first_words)
            kinds = type_names(first_words, elements)
        skip = 1 if first_words else 0
        names = ["element"] * skip + default_names(len(words) - skip)
        words[:skip] = ["element"] * skip
    if count == 0:
        names = words = default_names(3)
    particles = particles_of_rows(
        path, names, words, rows, before + start + 1, None, extra=elements, unnamed=start != 1
    )
    particles.names = kinds
    if count is not None and len(particles) != count:
        problem = f"expected {count} particles (line {before + 1}), got {len(particles)}"
        raise bad(path, f"line {before + len(lines)}", problem)
    return particles


def _is_points(lines: list[str], count: int) -> bool:
    """Whether the rows follow the count at once, as in .pts files of scanners."""
    row = lines[1].split() if len(lines) > 1 else []
    whole = sum(bool(line.strip()) for line in lines[1:]) == count
    return whole and len(row) in _POINTS and all(map(is_number, row))


def _first_words(rows: list[str], words: list[str], count: int | None) -> list[str]:
    """The first words of all rows if they are elements or types; else none.

    Types are whole numbers before places with a point, below a count: so LAMMPS writes .xyz.
    """
    if len(words) < 4:
        return []
    if is_number(words[0]):
        points = all("." in word or "e" in word.lower() for word in words[1:4])
        if count is None or len(words) != 4 or not (words[0].isdigit() and points):
            return []
    found = [row.split(None, 1)[0] for row in rows if row.strip() and row.lstrip()[0] != "#"]
    numbers = is_number(words[0])
    return found if all(word.isdigit() for word in set(found)) == numbers else []
