"""Numbers in text, parsed and written in bulk."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from .errors import FormatError, bad, shown
from .size import check_text, whole_file

_CHUNK = 1 << 22
_LOOKED_AT = 4096  # bytes of a text
_CONTROL = re.compile(rb"[\0-\x08\x0e-\x1f]")  # what is in no text
_FORTRAN = r"(\d\.\d*|\.\d+)[dD]([+-]?\d{1,3})\b"  # 1.5D-03


def parse_numbers(text: bytes, dtype: np.dtype) -> np.ndarray:
    """All blank-separated numbers of `text`. Raises ValueError, "got …", if one of them is not a
    number of this type."""
    text = text.strip()
    if not text:
        return np.empty(0, dtype)
    wide = dtype if dtype.kind == "f" or dtype.itemsize == 8 else np.dtype(np.int64)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # NumPy before 2.3 only warns of what is not a number
        try:
            values = np.fromstring(text, dtype=wide, sep=" ")
        except (DeprecationWarning, ValueError):
            raise ValueError("got other text") from None
    if dtype.kind in "iu" and len(values):
        low, high = np.iinfo(dtype).min, np.iinfo(dtype).max
        if values.min() < low or values.max() > high:
            raise ValueError(f"got {values[(values < low) | (values > high)][0]}")
        at_end = dtype.itemsize == 8 and (values.max() == high or values.min() == low)  # NumPy stops there
        if at_end and (beyond := [word for word in text.split() if not low <= int(word) <= high]):
            raise ValueError(f"got {shown(beyond[0])}")
    return values.astype(dtype, copy=False)


def numbers_of_words(words: Iterable[str | bytes]) -> np.ndarray:
    """Words as float64; none where one of them is no number."""
    try:
        return np.array([float(word) for word in words])
    except ValueError:
        return np.empty(0)


def is_number(word: str | bytes) -> bool:
    """Whether a word is a number, also NaN or an infinity."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def cast(values: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Numbers in the type that a file gives them. Raises ValueError, "got …", for one that this
    type of whole numbers does not hold."""
    with np.errstate(all="ignore"):
        found = values.astype(dtype)
    if dtype.kind in "iu" and (wrong := found != values).any():
        raise ValueError(f"got {values[wrong][0]:g}")
    return found


def end_of_tokens(data: bytes, start: int, n: int) -> int:
    """The position behind the n-th blank-separated token from `start`; -1 if there are fewer."""
    if n == 0:
        return start
    for begin in range(start, len(data), _CHUNK):
        # One byte more than the chunk: a token ends where a blank or the file's end follows it.
        piece = np.frombuffer(data, np.uint8, min(_CHUNK + 1, len(data) - begin), begin)
        solid = np.append(piece > 32, False) if begin + len(piece) == len(data) else piece > 32
        ends = np.flatnonzero(solid[:-1] & ~solid[1:])
        if len(ends) >= n:
            return begin + int(ends[n - 1]) + 1
        n -= len(ends)
    return -1


def parse_rows(path: Any, lines: Sequence[str], first_line: int, n_columns: int, **options: Any) -> np.ndarray:
    """Rows of numbers (n, n_columns) float64. `first_line` is the number of lines[0] in the file.

    `options` are those of numpy.loadtxt. Raises FormatError with the line and column at fault.
    """
    if not any(line.strip() for line in lines):
        return np.empty((0, n_columns))
    options.setdefault("comments", None)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "no data" shows in the number of rows
            rows = np.loadtxt(lines, dtype=np.float64, ndmin=2, **options)
        if rows.shape[1] == n_columns or rows.size == 0:
            return rows.reshape(-1, n_columns)
        problem = f"expected {n_columns} numbers a line, got {rows.shape[1]}"
    except ValueError as error:
        problem = str(error).splitlines()[0]
    fault = _find_fault(path, lines, first_line, n_columns, options)
    raise fault or bad(path, f"line {first_line}", f"expected rows of numbers, got {problem}")


def parse_words(lines: Sequence[str], column: int, **options: Any) -> list[str]:
    """The words of a column of rows that `parse_rows` has read with these options."""
    options = {"comments": None, **options, "usecols": [column], "ndmin": 1}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of lines without a row
        return np.loadtxt(lines, str, **options).tolist()


def parse_plain(
    data: bytes, start: int, separator: str, n_columns: int, used: Sequence[int], before: np.ndarray
) -> list[np.ndarray] | None:
    """The rows `before` (m, len(used)), and behind them those of separated text from a byte on: the
    columns `used`, each (m + n,) float64, as `parse_rows` reads them but in a fifth of the time, by
    pyarrow; None without it, and for a text that is not plain: quotes, comments, and what is no
    finite number in these columns."""
    if any(data.find(mark, start) >= 0 for mark in (b'"', b"#", b"%")):
        return None
    try:
        import pyarrow
        import pyarrow.csv
    except ImportError:
        return None
    names = [str(i) for i in range(n_columns)]
    kept = [names[i] for i in used]
    try:
        table = pyarrow.csv.read_csv(
            pyarrow.py_buffer(data).slice(start),
            pyarrow.csv.ReadOptions(column_names=names, use_threads=False),
            pyarrow.csv.ParseOptions(delimiter=separator, quote_char=False),
            pyarrow.csv.ConvertOptions(
                column_types=dict.fromkeys(kept, pyarrow.float64()), include_columns=kept,
                null_values=[], check_utf8=False),
        )  # fmt: skip
    except pyarrow.ArrowInvalid:
        return None
    columns = []
    for first, column in zip(before.T, table.columns, strict=True):
        chunks = [  # not to_numpy, which loads pandas for half a second
            np.frombuffer(chunk.buffers()[1], np.float64)[chunk.offset :][: len(chunk)] for chunk in column.chunks
        ]
        columns.append(np.concatenate([first, *chunks]))
    # NumPy takes fewer words for them.
    return columns if all(np.isfinite(column[len(before) :].sum()) for column in columns) else None


def _find_fault(
    path: Any, lines: Sequence[str], first_line: int, n_columns: int, options: dict[str, Any]
) -> FormatError | None:
    """The first line that does not hold numbers; only walked when the fast way failed."""
    for number, line in enumerate(lines, first_line):
        if options["comments"]:
            line = line.partition(options["comments"])[0]
        words = line.split(options.get("delimiter")) if line.strip() else []
        if not words:
            continue
        used = options.get("usecols", range(n_columns))
        if len(words) <= max(used) or ("usecols" not in options and len(words) > n_columns):
            return bad(path, f"line {number}", f"expected {n_columns} numbers, got {len(words)}")
        for column in used:
            try:
                if "_" in words[column] or not words[column].strip().isascii():  # as Python's numbers may be
                    raise ValueError
                float(words[column])
            except ValueError:
                where = f"line {number}, column {column + 1}"
                return bad(path, where, f"expected a number, got {shown(words[column])}")
    return None


def format_rows(columns: Sequence[np.ndarray], separator: str) -> Iterator[bytes]:
    """Lines of text with one number of each column, in the shortest digits that read back."""
    step = 100_000  # rows at a time bound the memory
    for begin in range(0, len(columns[0]), step):
        words = []
        for column in columns:
            part = column[begin : begin + step]
            words.append((part.astype("i1") if part.dtype == bool else part).astype("U").tolist())
        lines = map(separator.join, zip(*words, strict=True))
        yield ("\n".join(lines) + "\n").encode()


def text_lines(path: Any) -> list[str]:
    """A text file's lines, whatever the line ends. Raises FormatError for one that is too large
    for memory."""
    return lines_of(path, text_data(path))


def text_data(path: Any) -> bytes:
    """A text file's bytes. Raises FormatError where it is too large for memory as lines."""
    data = whole_file(path, 7.0)
    check_text(path, data)
    return data


def lines_of(path: Any, data: bytes) -> list[str]:
    """The lines of a text. Raises FormatError for what is none."""
    text = decoded(data)
    if "\0" in text[:_LOOKED_AT]:
        raise bad(path, "", "expected text, got binary data")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def decoded(data: bytes) -> str:
    """A text in UTF-16 or UTF-32 that says so, or has zeros beside each letter of its beginning; else in
    UTF-8, or where some bytes are none, in Windows' code 1252. Fortran's exponents become e."""
    begin = data[:_LOOKED_AT]
    code = "utf-8-sig"
    of_four = [any(begin[k::4]) for k in range(4)] if b"\0" in begin else []
    if begin[:4] in (b"\xff\xfe\0\0", b"\0\0\xfe\xff"):
        code = "utf-32"
    elif begin[:2] in (b"\xff\xfe", b"\xfe\xff"):
        code = "utf-16"
    elif of_four in ([True, False, False, False], [False, False, False, True]):
        code = "utf-32-le" if of_four[0] else "utf-32-be"
    elif of_four:
        even, odd = of_four[0] or of_four[2], of_four[1] or of_four[3]
        code = "utf-16-le" if even and not odd else "utf-16-be" if odd and not even else code
    text = data.decode(code, errors="replace")
    if "\ufffd" in text and not _CONTROL.search(begin) and b"\xef\xbf\xbd" not in data:
        text = data.decode("cp1252", errors="replace")  # of Windows, and most of Latin-1
    return re.sub(_FORTRAN, r"\1e\2", text) if re.search(_FORTRAN, text[:_LOOKED_AT]) else text
