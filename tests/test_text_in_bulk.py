"""Large texts in bulk: plain tables by pyarrow, frames of texts found once."""

import gzip
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.formats import FormatError, frames, read_contents, table
from globule.formats import rows as rows_of_tables
from globule.formats.frames import FrameOf

RNG = np.random.default_rng(41)
X = np.round(RNG.random((24, 3)), 6)
pytestmark = pytest.mark.usefixtures("folder")


def rows(separator: str = " ") -> list[str]:
    return [separator.join(f"{v:.6f}" for v in x) for x in X]


def by_rows(path: str) -> gb.Particles | str:
    """What a table reads as, or why it does not, by pyarrow where the text is plain."""
    try:
        return gb.read(path)
    except FormatError as error:
        return str(error)


def plain_tables() -> dict[str, str]:
    """Separated text, of which the marked ones are plain: all but the first rows by pyarrow."""
    sep = {mark: "\n".join(rows(mark)) + "\n" for mark in ",;\t|"}
    lines = rows(",")
    return {
        "plain": "x,y,z\n" + sep[","],
        "plain, no names": sep[";"],
        "plain, tabs": "x\ty\tz\n" + sep["\t"],
        "plain, bars and no end": "# Pos.x [m] | Pos.y [m] | Pos.z [m]\n" + sep["|"][:-1],
        "plain, line ends": ("x,y,z\n\n" + sep[","]).replace("\n", "\r\n"),
        "plain, whole and words": "name,id,x,y,z\n"
        + "".join(f"a{i}, {7 * i},{line}\n" for i, line in enumerate(lines)),
        "plain, any digits": "x,y,z,a\n"
        + "".join(f"{x:.17g},+{y:.3e},{z * 1e-310:g},{x * 1e300:.0f}\n" for x, y, z in X),
        "blanks": "x y z\n" + "\n".join(rows()),
        "quotes": "x,y,z\n" + sep[","] + '"1","2","3"\n',
        "comment": "x,y,z\n" + sep[","] + "# 1,2,3\n1,2,3\n",
        "percent": "a,x,y,z\n" + "".join(f"b,{line}\n" for line in lines) + "%c,1,2,3\n",
        "missing": "x,y,z,a\n" + "".join(f"{line},1\n" for line in lines) + "1,2,3,",
        "no number": "x,y,z,a\n" + "".join(f"{line},nan\n" for line in lines),
        "no number of C": "x,y,z\n" + sep[","] + "nan(1),2,3\n",
        "endless": "x,y,z\n" + sep[","] + "1e400,2,3\n",
        "short": "x,y,z\n" + sep[","] + "1,2\n",
        "long": "x,y,z\n" + sep[","] + "1,2,3,4\n" + sep[","],
        "word": "x,y,z\n" + sep[","] + "1,two,3\n",
        "commas": "x;y;z\n" + sep[";"].replace(".", ","),
        "one line": "x,y,z," + "a" * 2000,
    }


@pytest.mark.parametrize("name", plain_tables())
def test_large_tables_are_read_in_bulk_as_by_rows(name, monkeypatch):
    pytest.importorskip("pyarrow")
    Path("a.csv").write_bytes(plain_tables()[name].encode())
    expected = by_rows("a.csv")
    bulk, found = rows_of_tables.parse_plain, []
    monkeypatch.setattr(table, "_PLAIN", 0)
    monkeypatch.setattr(table, "_HEAD", 200)
    monkeypatch.setattr(rows_of_tables, "parse_plain", lambda *a: found.append(bulk(*a)) or found[-1])
    got = by_rows("a.csv")
    assert any(rows is not None for rows in found) == name.startswith("plain")
    if isinstance(expected, str):
        assert got == expected
        return
    assert isinstance(got, gb.Particles)
    assert got.positions.tobytes() == expected.positions.tobytes()
    assert got.attributes.keys() == expected.attributes.keys()
    for key, values in expected.attributes.items():
        assert (got.attributes[key].dtype, got.attributes[key].tobytes()) == (values.dtype, values.tobytes())


def test_damaged_tables_read_the_same_in_bulk(monkeypatch):
    pytest.importorskip("pyarrow")
    whole = "x,y,z,id\n" + "".join(f"{line},{i}\n" for i, line in enumerate(rows(",")))
    pieces = [b"nan", b"inf", b"-", b"e5", b"+", b'"', b"#", b"\n", b"\r", b",", b" ", b"\t", b"\0",
              b"\xff", b"\xc2\xa0", b"_", b"0x", b"1e999", b".", b";", b"f", b"d0"]  # fmt: skip
    for _ in range(100):
        at, piece = int(RNG.integers(60, len(whole))), pieces[RNG.integers(len(pieces))]
        data = whole.encode()[:at] + piece + whole.encode()[at + int(RNG.integers(3)) :]
        Path("a.csv").write_bytes(data)
        read = []
        for plain in (1 << 22, 0):
            monkeypatch.setattr(table, "_PLAIN", plain)
            monkeypatch.setattr(table, "_HEAD", 50)
            found = by_rows("a.csv")
            arrays = {} if isinstance(found, str) else {"x": found.positions, **found.attributes}
            read.append((found if isinstance(found, str) else "", list(arrays),
                         [(a.dtype, a.tobytes()) for a in arrays.values()]))  # fmt: skip
        assert read[0] == read[1], data


def dump(k: int, n: int) -> str:
    time = f"ITEM: TIME\n{k / 2}\n" if k % 2 else ""
    body = "".join(f"{i + 1} {i}.5 {k} 1\n" for i in range(n))
    return (f"{time}ITEM: TIMESTEP\n{k}\nITEM: NUMBER OF ATOMS\n{n}\n"
            f"ITEM: BOX BOUNDS pp pp ff\n0 9\n0 9\n0 9\nITEM: ATOMS id x y z\n{body}")  # fmt: skip


def xyz(k: int, n: int) -> str:
    return f"{n}\nframe {k}\n" + "".join(f"H {i}.5 {k} 1\n" for i in range(n))


def extxyz(k: int, n: int) -> str:
    about = f"Properties=species:S:1:pos:R:3 time={k}"
    return f"{n}\n{about}\n" + "".join(f"H {i}.5 {k} 1\n" for i in range(n))


MANY = {"a.lammpstrj": dump, "a.xyz": xyz, "a.extxyz": extxyz}


@pytest.mark.parametrize("name", MANY)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", ".gz"])
def test_frames_of_texts_are_found_once(name, end, monkeypatch):
    counts = [3, 1, 4, 1, 5, 9]
    begin = "ITEM: UNITS\nlj\n" if name == "a.lammpstrj" else ""
    text = begin + "".join(MANY[name](k, n) for k, n in enumerate(counts))
    if end == ".gz":
        name += end
        Path(name).write_bytes(gzip.compress(text.encode()))
    else:
        Path(name).write_bytes(text.replace("\n", end).encode())
    scanned, lines_of = [], frames.lines_of
    monkeypatch.setattr(frames, "lines_of", lambda *a: scanned.append(len(a[1])) or lines_of(*a))
    for k in (0, 5, 2, 1, -2, 3):
        found = read_contents(FrameOf(name, k))
        k %= len(counts)
        assert found.n_frames == len(counts)
        expected = [[i + 0.5, k, 1] for i in range(counts[k])]
        assert np.array_equal(found.particles.positions, expected)
        if begin:
            assert (found.units, found.time) == ({"positions": "LAMMPS lj"}, k / 2 if k % 2 else k)
    if end != "\r":  # whose lines are no lines of bytes
        assert sum(scanned[1:]) < scanned[0]
    with pytest.raises(ValueError, match="frame: expected -6 to 5"):
        read_contents(name, frame=6)


@pytest.mark.parametrize("name", MANY)
def test_a_text_that_grew_is_scanned_again_and_damage_names_its_line(name):
    for n in (2, 3):
        Path(name).write_text("".join(MANY[name](k, 4) for k in range(n)))
        assert read_contents(name, frame=1).n_frames == n
        assert read_contents(name, frame=-1).particles.positions[0][1] == n - 1
    text = "".join(MANY[name](k, 4) for k in range(5))
    Path(name).write_text(text.replace("2.5 3 1", "2.5 three 1"))
    line = next(i for i, row in enumerate(Path(name).read_text().splitlines(), 1) if "three" in row)
    for k in (0, 4, 2):
        read_contents(name, frame=k)
    for _ in range(2):
        with pytest.raises(FormatError, match=rf"line {line}\b"):
            read_contents(name, frame=3)
