"""Damage to a file: bytes, numbers in text, members of archives, what is packed, and tails."""

import gzip
import io
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from random import Random

import numpy as np

NUMBERS = (
    b"0", b"-1", b"1", b"2", b"3", b"255", b"256", b"65536", b"100000", b"2147483647",
    b"2147483648", b"4294967295", b"9223372036854775807", b"99999999999999999999", b"1e9", b"-1e9",
    b"1e30", b"1e308", b"1e-308", b"1e999", b"nan", b"inf", b"-inf", b"", b"x", b"0.5", b"true",
    b"[]", b"{}", b'""', b"9" * 400,
)  # fmt: skip
WORDS = (b"", b"\0", b"\n", b" ", b"\xff\xfe", b"\xc3\x28", b"=", b"[", b"]", b'"', b"<", b">",
         b"#", b"NaN", b"..", b"/", b"%s", "é".encode(), b"\x1b[31m", b"A" * 5000)  # fmt: skip
INTEGERS = (0, 1, -1, 2, 127, 128, 255, 256, 32767, 65535, 2**31 - 1, -(2**31), 2**32 - 1,
            2**63 - 1, 10**6, 10**8)  # fmt: skip
FLOATS = (float("nan"), float("inf"), -1e38, 1e38, 1e-42, 0.0, -0.0, 1e10, -1.0)


def mutate(random: Random, content: bytes, others: list[bytes]) -> bytes:
    """A damaged copy of a file's content; `others`: files of the same kind, to splice with."""
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        if content[:4] == b"PK\3\4" and random.random() < 0.7:
            content = _in_archive(random, content)
        elif content[:2] == b"\x1f\x8b" and random.random() < 0.6:
            content = _in_gzip(random, content)
        else:
            content = _in_bytes(random, content, others)
    return content


def _in_bytes(random: Random, content: bytes, others: list[bytes]) -> bytes:
    way = random.choices(
        (_flip, _number, _integer, _float, _word, _cut, _remove, _repeat, _tail, _splice),
        (3, 5, 3, 2, 2, 1.5, 1.5, 1, 0.7, 0.7),
    )[0]
    if way is _splice:
        return _splice(random, content, others)
    return way(random, content)


def _at(random: Random, content: bytes) -> int:
    """A place, oftener in the header."""
    reach = min(len(content), random.choice((64, 400, 4000, len(content) or 1)))
    return random.randrange(reach) if reach else 0


def _flip(random: Random, content: bytes) -> bytes:
    new = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 8, 64))):
        if new:
            new[_at(random, content)] = random.randrange(256)
    return bytes(new)


def _number(random: Random, content: bytes) -> bytes:
    """A number in text becomes another."""
    reach = random.choice((400, 4000, 40_000))
    found = list(re.finditer(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?", content[:reach]))
    if not found:
        return _flip(random, content)
    hit = random.choice(found)
    value = random.choice(NUMBERS)
    if random.random() < 0.4:  # near what it was
        if b"." in hit[0]:
            value = repr(float(hit[0]) * random.choice((-1, 0.1, 0.5, 0.99, 1.01, 2, 10))).encode()
        else:
            value = b"%d" % (int(re.sub(rb"\D", b"", hit[0])[:15] or b"0") + random.choice((-1, 1)))
    return content[: hit.start()] + value + content[hit.end() :]


def _integer(random: Random, content: bytes) -> bytes:
    form = random.choice(["<B", "<H", ">H", "<I", ">I", "<i", ">i", "<Q", "<q"])
    size = struct.calcsize(form)
    at = _at(random, content)
    if len(content) < size or at + size > len(content):
        return content
    number = random.choice(INTEGERS) & ((1 << 8 * size) - 1)
    data = struct.pack(form.upper(), number)
    return content[:at] + data + content[at + size :]


def _float(random: Random, content: bytes) -> bytes:
    form = random.choice(("<f", "<d", ">f"))
    size = struct.calcsize(form)
    if len(content) < size:
        return content
    at = random.randrange(len(content) - size + 1)
    data = struct.pack(form, random.choice(FLOATS))
    return content[:at] + data + content[at + size :]


def _word(random: Random, content: bytes) -> bytes:
    at = _at(random, content)
    return content[:at] + random.choice(WORDS) + content[at + random.choice((0, 0, 1, 4)) :]


def _cut(random: Random, content: bytes) -> bytes:
    return content[: _at(random, content)]


def _remove(random: Random, content: bytes) -> bytes:
    at = _at(random, content)
    return content[:at] + content[at + random.choice((1, 2, 8, 100, 3000)) :]


def _repeat(random: Random, content: bytes) -> bytes:
    at = _at(random, content)
    part = content[at : at + random.choice((1, 10, 100, 2000))]
    return content[:at] + part * random.choice((2, 3, 50)) + content[at + len(part) :]


def _tail(random: Random, content: bytes) -> bytes:
    return content + random.choice((b"\0", b"\n", b"x" * 1000, bytes(1 << 20), content))


def _splice(random: Random, content: bytes, others: list[bytes]) -> bytes:
    other = random.choice(others)
    return content[: _at(random, content)] + other[_at(random, other) :]


def _in_archive(random: Random, content: bytes) -> bytes:
    """A member of a zip file is damaged, goes, comes twice, or gets another name; whole again."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except Exception:  # damaged by an earlier round
        return _flip(random, content)
    if not members:
        return content
    which = random.randrange(len(members))
    name, data = members[which]
    way = random.random()
    if way < 0.55:
        members[which] = name, _array(random, data)
    elif way < 0.75:
        members[which] = name, _in_bytes(random, data, [d for _, d in members])
    elif way < 0.85:
        del members[which]
    elif way < 0.9:
        members.append((name, random.choice(members)[1]))
    elif way < 0.97:
        members[which] = name, random.choice(members)[1]
    else:
        members[which] = random.choice(("positions.npy", "../x.npy", "a\nb.npy", ".npy")), data
    out = io.BytesIO()
    packing = random.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with warnings.catch_warnings(), zipfile.ZipFile(out, "w", packing) as archive:
        warnings.simplefilter("ignore")
        for member, inside in members:
            archive.writestr(member, inside)
    return out.getvalue()


def _array(random: Random, data: bytes) -> bytes:
    """An .npy: its values become strange, or its header is another that fits it."""
    try:
        array = np.load(io.BytesIO(data))
    except Exception:
        return _flip(random, data)
    if array.dtype.kind not in "biuf":
        return _flip(random, data)
    way = random.random()
    if way < 0.5 and array.size:
        array = array.copy()
        flat = array.reshape(-1)
        for _ in range(random.choice((1, 1, 5, array.size // 2 + 1))):
            values = FLOATS if array.dtype.kind == "f" else INTEGERS
            value = random.choice(values)
            with np.errstate(all="ignore"):
                if array.dtype.kind in "iu":
                    mask = 0xFF if array.itemsize == 1 else 0x7FFFFFFF
                    flat[random.randrange(flat.size)] = np.array(value & mask)
                elif array.dtype.kind == "f":
                    flat[random.randrange(flat.size)] = value
    elif way < 0.65:
        array = array[: array.shape[0] // 2] if array.ndim else array
    elif way < 0.75:
        array = np.concatenate([array, array]) if array.ndim else np.stack([array] * 3)
    elif way < 0.9:
        kind = random.choice(("u1", "i8", "f4", "f8", "u4", "U3", "c16", "b1", "f2", "i4"))
        with np.errstate(all="ignore"):
            array = array.astype(kind)
    elif way < 0.95:
        array = array.reshape(-1) if array.ndim != 1 else array[None]
    else:
        array = np.zeros(random.choice(((), (0,), (0, 3), (2, 0), (1, 1, 1))), array.dtype)
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def _in_gzip(random: Random, content: bytes) -> bytes:
    try:
        plain = gzip.decompress(content)
    except (OSError, EOFError, zlib.error):
        return _flip(random, content)
    return gzip.compress(_in_bytes(random, plain, [plain]), mtime=0)


def replaced_numbers(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Every number of a text replaced by each of NUMBERS: what, content."""
    for found in re.finditer(rb"(?<![\w.#-])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])", content):
        line = content.count(b"\n", 0, found.start()) + 1
        column = found.start() - content.rfind(b"\n", 0, found.start())
        for value in NUMBERS:
            what = f"line {line}, column {column}: {value[:20].decode()}"
            yield what, content[: found.start()] + value + content[found.end() :]


def damaged_arrays(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Every member of an .npz damaged in every way, each in a file of its own: what, content."""
    with np.load(io.BytesIO(content)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    for name, array in arrays.items():
        for what, new in _damages(array):
            changed = {k: new if k == name else a for k, a in arrays.items()}
            if what == "gone":
                del changed[name]
            out = io.BytesIO()
            np.savez(out, **changed)
            yield f"{name} {what}", out.getvalue()


def _damages(array: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    yield "gone", array
    yield "empty", array[:0] if array.ndim else np.empty(0, array.dtype)
    yield "halved", array[: len(array) // 2] if array.ndim else np.empty((), "u1")
    yield "doubled", np.concatenate([array, array]) if array.ndim else np.stack([array, array])
    yield "words", np.array("LPS")
    yield "float16", array[None].astype(np.float16)
    for what, value in (("0", 0), ("-1", -1)):
        with np.errstate(all="ignore"):
            yield f"all {what}", np.full_like(array, np.array(value).astype(array.dtype))
    if array.dtype.kind == "f":
        yield "all nan", np.full_like(array, np.nan)
        yield "all 1e38", np.full_like(array, 1e38)
    if array.dtype == np.uint8 and array.ndim == 1 and array.size >= 8:
        for number, at in ((0xFFFFFFFF, 0), (0x7FFFFFFF, array.size // 8 * 4)):  # one word of many
            words = array[: array.size // 4 * 4].copy()
            words.view(np.uint32)[min(at // 4, words.size // 4 - 1)] = number
            yield f"word {at // 4}", np.concatenate([words, array[words.size :]])
