"""XDMF and HDF5 as everyday writers make them: items of items, XInclude, attributes of any type."""

from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.cli import main
from globule.formats import FormatError, read_contents, triangles
from globule.formats.frames import FrameOf

h5py = pytest.importorskip("h5py")
N = 12
RNG = np.random.default_rng(43)
X = RNG.random((N, 3))
GEOMETRY = '<Geometry GeometryType="XYZ">{}</Geometry>'
GRID = '<Grid Name="g" GridType="Uniform"><Topology TopologyType="Polyvertex"/>{}</Grid>'


@pytest.fixture(autouse=True)
def in_a_folder(folder):
    with h5py.File("x.h5", "w") as file:
        file["p"], file["steps"] = X, np.stack([X, X + 1, X + 2])
        file["mass"] = np.stack([np.arange(N), np.arange(N) + 5.0])
        for k, axis in enumerate("xyz"):
            file[axis] = X[:, k]


def hdf(name: str, size: str) -> str:
    return f'<DataItem Format="HDF" Dimensions="{size}" NumberType="Float">x.h5:/{name}</DataItem>'


def xdmf(body: str, doctype: str = "", name: str = "a.xdmf") -> str:
    head = f'<?xml version="1.0"?>\n{doctype}<Xdmf Version="3.0"><Domain>'
    Path(name).write_text(f"{head}{body}</Domain></Xdmf>")
    return name


def slab(numbers: str, item: str, size: str = "") -> str:
    about = f'<DataItem Dimensions="3 {len(numbers.split()) // 3}" Format="XML">{numbers}</DataItem>'
    return f'<DataItem ItemType="HyperSlab" Dimensions="{size}">{about}{item}</DataItem>'


def joined(function: str) -> str:
    items = "".join(hdf(axis, f"{N}") for axis in "xyz")
    return f'<DataItem ItemType="Function" Function="{function}">{items}</DataItem>'


def grid(item: str, more: str = "") -> str:
    return GRID.format(GEOMETRY.format(item) + more)


POINTS = grid(hdf("p", f"{N} 3"))
STEP = slab(f"1 0 0 1 1 1 1 {N} 3", hdf("steps", f"3 {N} 3"), f"1 {N} 3")
MESH = 'xpointer(//Grid[@Name="g"]/*[self::Topology or self::Geometry])'
SHARED = "<Grid>" + f"<xi:include xpointer='{MESH}'/>" + '<Time Value="{}"/></Grid>'
TIMES = '<Grid CollectionType="Temporal">' + SHARED.format(1) + SHARED.format(2) + "</Grid>"
RIGHT = {
    "doctype": (POINTS, X),
    "slab": (grid(STEP), X + 1),
    "every other": (grid(slab("1 0 2 1 5 3", hdf("p", f"{N} 3"))), X[1:10:2]),
    "slab of a slab": (grid(slab("1 0 1 1 4 3", STEP)), X[1:5] + 1),
    "join": (grid(joined("JOIN($0, $1, $2)")), X),
    "join in another order": (grid(joined("JOIN($2 ; $1 ; $0)")), X[:, ::-1]),
    "reference": (
        hdf("p", f"{N} 3").replace("<DataItem", '<DataItem Name="pp"')
        + grid(
            '<DataItem Reference="XML">/Xdmf/Domain/DataItem[@Name="pp"]</DataItem>'),
        X,
    ),
    "reference to a grid": (POINTS + '<Grid Reference="/Xdmf/Domain/Grid[1]"/>', X),
    "include": (TIMES + POINTS, X),
}  # fmt: skip


@pytest.mark.parametrize("case", RIGHT)
def test_xdmf(case):
    body, expected = RIGHT[case]
    got = read_contents(xdmf(body, '<!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []>\n'))
    assert np.allclose(got.particles.positions, expected)
    if case == "include":
        assert (got.n_frames, read_contents("a.xdmf", frame=1).time) == (2, 2)


def test_attributes_of_one_step_and_an_include_of_another_file():
    mass = slab(f"1 0 1 1 1 {N}", hdf("mass", f"2 {N}"), f"1 {N}")
    held = f'<Attribute Name="mass" Center="Node">{mass}</Attribute>'
    Path("below").mkdir()
    Path("x.h5").rename("below/x.h5")  # beside the file that names it
    xdmf(grid(STEP, held), name="below/mesh.xdmf")
    pointer = "xpointer(/Xdmf/Domain/Grid)"
    particles = gb.read(xdmf(f'<xi:include href="below/mesh.xdmf" xpointer="{pointer}"/>'))
    assert np.allclose(particles.positions, X + 1)
    assert np.array_equal(particles.attributes["mass"], np.arange(N) + 5.0)


ITSELF = '<Grid Name="g"><xi:include xpointer="xpointer(//Grid)"/></Grid>'
LOOP = '<DataItem Name="a" Reference="XML">/Xdmf/Domain/DataItem[1]</DataItem>'


def doubled(n: int = 40) -> str:
    one = "<xi:include xpointer='xpointer(/Xdmf/Domain/Grid[{0}])'/>"
    return "".join(f"<Grid>{2 * one.format(i) if i else '<Time/>'}</Grid>" for i in range(n))


@pytest.mark.parametrize(("body", "said"), [
    (ITSELF, "expected no include of itself"),
    ('<xi:include href="a.xdmf"/>', "expected a file below the same folder"),
    ('<xi:include href="b.xdmf"/>', "expected no include of itself|below the same folder"),
    ('<xi:include href="../b.xdmf"/>', "expected a file below the same folder"),
    ('<xi:include href="/etc/passwd"/>', "expected a file below the same folder"),
    ('<xi:include xpointer="xpointer(//Nothing)"/>', "expected elements at '//Nothing', got none"),
    ('<xi:include xpointer="element(/1)"/>', "expected xpointer"),
    (doubled(), "expected at most 200,000 included elements"),
    (grid(slab(f"1 0 0 1 1 1 9 {N} 3", hdf("steps", "3 4 3"))), "rows up to 3"),
    (grid(slab("0 0 1 1 9 4", hdf("p", f"{N} 3"))), "HyperSlab up to"),
    (grid(slab("0 0 1 1 1e300 3", hdf("p", f"{N} 3"))), "rows up to|HyperSlab"),
    (grid(slab("-1 0 1 1 2 3", hdf("p", f"{N} 3"))), "counts from 1"),
    (grid(slab("0 0 1 1 2.5 3", hdf("p", f"{N} 3"))), "strides and counts"),
    (grid(joined("JOIN($0, $7)")), "expected JOIN"), (grid(joined("EXP($0)")), "expected JOIN"),
    (LOOP + grid(LOOP), "in itself"), (grid('<DataItem Reference="/Xdmf/No"/>'), "one DataItem, got 0"),
    (grid('<DataItem Reference="XML">a[b=c]()</DataItem>'), "expected a path"),
])  # fmt: skip
def test_hostile_xdmf(body, said):
    xdmf('<xi:include href="a.xdmf"/>', name="b.xdmf")
    with pytest.raises(FormatError, match=said):
        gb.read(xdmf(body))


@pytest.mark.parametrize("inside", [
    '<!ENTITY a "b">', '<!ENTITY % a SYSTEM "b"> %a;', '<!ATTLIST Grid Name CDATA "a">',
    "<!ELEMENT Xdmf ANY>", '<!NOTATION a SYSTEM "b">',
])  # fmt: skip
def test_declarations_and_entities_are_refused(inside):
    with pytest.raises(FormatError, match="expected a DOCTYPE without declarations"):
        gb.read(xdmf(POINTS, f"<!DOCTYPE Xdmf [{inside}]>\n"))
    with pytest.raises(FormatError, match=r"no entities|undefined entity"):
        gb.read(xdmf("&a;" + POINTS, '<!DOCTYPE Xdmf SYSTEM "Xdmf.dtd">\n'))


def test_attributes_of_any_type():
    with h5py.File("a.h5", "w") as file:
        file["positions"] = X.astype(np.longdouble)
        file["density"] = np.arange(N, dtype=np.longdouble)
        for i, value in enumerate((
            np.longdouble(1.5), h5py.Empty("f4"), h5py.Empty("S9"), np.full(3, 2, np.longdouble),
            file["density"].ref, file["density"].regionref[:3], np.complex64(1j),
            np.array(["a", "b"], object), np.zeros(2, [("a", "f4"), ("b", "i4")]), np.bool_(1),
        )):  # fmt: skip
            kind = h5py.special_dtype(vlen=str) if getattr(value, "dtype", 0) == "O" else None
            file.attrs.create(f"a{i}", value, dtype=kind)
            file["density"].attrs.create(f"a{i}", value, dtype=kind)
        file.attrs["refs"] = np.array([file["density"].ref], dtype=h5py.ref_dtype)
        file.attrs["time"] = np.longdouble(2.5)
    got = read_contents("a.h5")
    assert np.allclose(got.particles.positions, X)
    assert (got.particles.attributes["density"].tolist(), got.time) == ([*range(N)], 2.5)


def openpmd(order: str, offsets: dict[str, object], constants: dict[str, float] | None = None) -> str:
    with h5py.File("run.h5", "w", track_order=True) as file:
        file.attrs["openPMD"], file.attrs["particlesPath"] = "1.1.0", "particles/"
        base = file.create_group("data/0/particles/e", track_order=True)
        for record, unit in (("position", 1e-6), ("positionOffset", 1e-3), ("momentum", 2.0)):
            group = base.create_group(record, track_order=True)
            for axis in order:
                values = X[:, "xyz".index(axis)]
                constant = (constants or {}).get(axis) if record == "position" else None
                if record == "positionOffset":
                    values, constant = None, offsets.get(axis, 0.0)
                    if isinstance(constant, np.ndarray):
                        values, constant = constant, None
                if constant is None:
                    group[axis] = values
                else:
                    part = group.create_group(axis)
                    part.attrs["value"], part.attrs["shape"] = np.longdouble(constant), [N]
                group[axis].attrs["unitSI"] = np.longdouble(unit)
    return "run.h5"


@pytest.mark.parametrize("order", ["xyz", "zyx", "yxz", "xz", "zx", "yz"])
def test_components_of_openpmd_in_any_order(order):
    offsets = {"x": 3.0, "y": 5.0, "z": np.arange(N, dtype=float)}
    particles, expected = gb.read(openpmd(order, offsets)), np.zeros((N, 3))
    for k, axis in enumerate("xyz"):
        if axis in order:
            expected[:, k] = 1e-6 * X[:, k] + 1e-3 * np.asarray(offsets[axis])
    assert np.allclose(particles.positions, expected, rtol=1e-5)
    columns = ["xyz".index(axis) for axis in sorted(order)]
    assert np.allclose(particles.attributes["momentum"], 2 * X[:, columns])


def test_constant_components_of_openpmd():
    particles, expected = gb.read(openpmd("zyx", {"y": 1.0}, {"y": 7.0})), 1e-6 * X
    expected[:, 1] = 7e-6 + 1e-3
    assert np.allclose(particles.positions, expected, rtol=1e-5)


# A unit square of two triangles below z = 1, and a cube of six tetrahedra.
CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
SQUARE = [[0, 1, 3], [0, 3, 2]]
KUHN = [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]


def item(values) -> str:
    values = np.asarray(values)
    text = " ".join(map(str, values.ravel().tolist()))
    return f'<DataItem Dimensions="{" ".join(map(str, values.shape))}">{text}</DataItem>'


def mesh(kind: str, connectivity: str, more: str = "", corners=CORNERS) -> str:
    geometry = GEOMETRY.format(item(corners))
    return f'<Grid><Topology TopologyType="{kind}">{connectivity}</Topology>{geometry}{more}</Grid>'


def area(path: str) -> float:
    found = triangles.read(path)
    a, b, c = np.asarray(found.vertices, float)[found.faces.T]
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


MIXED = [4, 0, 1, 3, 5, 4, 5, 7, 6, 3, 3, 0, 3, 2, 2, 2, 0, 7, 1, 1, 5]


@pytest.mark.parametrize(
    ("kind", "connectivity", "expected"),
    [
        ("Triangle", SQUARE, 1), ("Quadrilateral", [[0, 1, 3, 2]], 1), ("Tetrahedron", KUHN, 6),
        ("Hexahedron", [[0, 1, 3, 2, 4, 5, 7, 6]], 6), ("Mixed", MIXED, 2),
    ],
)  # fmt: skip
def test_cells_of_xdmf_are_a_mesh(kind, connectivity, expected, capsys):
    xdmf(mesh(kind, item(connectivity)))
    assert main(["info", "a.xdmf"]) == 0
    assert "surface    triangles (faces of the file)" in capsys.readouterr().out
    assert triangles.has_faces("a.xdmf")
    assert area("a.xdmf") == pytest.approx(expected, rel=1e-6)
    assert len(gb.read("a.xdmf")) == 8  # its points, for who asks for particles


def test_a_dolfinx_run_is_a_sequence_of_meshes_and_lines_stay_particles():
    with h5py.File("x.h5", "a") as file:
        file["cells"] = np.array(KUHN)
        file["u"] = np.arange(8.0)
    cells = '<DataItem Format="HDF" Dimensions="6 4">x.h5:/cells</DataItem>'
    u = f'<Attribute Name="u" Center="Node">{hdf("u", "8 1")}</Attribute>'
    steps = "".join(mesh("tetrahedron", cells, f'<Time Value="{t}"/>{u}', CORNERS * t) for t in (1, 2, 3))
    xdmf(f'<Grid CollectionType="Temporal">{steps}</Grid>', "<!DOCTYPE Xdmf SYSTEM 'Xdmf.dtd' []>")
    for k in range(3):
        assert gb.Mesh(FrameOf("a.xdmf", k), device="cpu").bounds()[1].tolist() == [k + 1] * 3
    assert triangles.read("a.xdmf").attributes["u"].ravel().tolist() == list(range(8))
    for kind, cells in (("Polyvertex", ""), ("Polyline", [[0, 1]]), ("Mixed", [1, 1, 5])):
        xdmf(mesh(kind, item(cells) if cells else ""))
        assert not triangles.has_faces("a.xdmf")
        assert len(gb.read("a.xdmf")) == 8


@pytest.mark.parametrize(("kind", "cells", "said"), [
    ("Triangle", [[0, 1, 8]], "expected indices from 0 to 7, got 0 to 8"),
    ("Triangle", [[0, 1, np.nan]], "expected indices from 0 to 7, got "),
    ("Triangle", [[0, 1]], "expected 3 points a cell, got 2 in all"),
    ("Mixed", [4, 0, 1], "expected the points of mixed cells, got too few numbers"),
    ("Mixed", [4, 0, 1, 2, 99], "expected the number of a kind of cell, got 99"),
    ("Mixed", [3, -1, 2], "expected the points of mixed cells, got too few numbers"),
    ("Polygon", [0, 1, 2], "expected NodesPerElement from 3, got ''"),
])  # fmt: skip
def test_damaged_cells_of_xdmf(kind, cells, said):
    xdmf(mesh(kind, item(cells)))
    with pytest.raises(FormatError, match=said):
        triangles.read("a.xdmf")
    triangles.has_faces("a.xdmf")  # says what it can


@pytest.mark.parametrize(("kind", "numbers", "expected"), [
    ("HyperSlab", "0.5 0.25 2", [0.5, 0.75]), ("List", "1 7", [1, 7]), ("Range", "0 1", [None, None]),
    ("List", "1", [1, None]), ("HyperSlab", "a b", [None, None]),
])  # fmt: skip
def test_times_of_a_collection(kind, numbers, expected):
    time = f'<Time TimeType="{kind}"><DataItem Format="XML">{numbers}</DataItem></Time>'
    xdmf(f'<Grid GridType="Collection" CollectionType="Temporal">{time}{2 * POINTS}</Grid>')
    assert [read_contents("a.xdmf", frame=k).time for k in range(2)] == expected
