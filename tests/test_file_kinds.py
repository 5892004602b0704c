"""Files as programs of many origins write them: counts, bounds, volume, frames, box and units."""

import contextlib
import re
import warnings
from importlib.util import find_spec
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.data.radii import find_radii
from globule.formats import Format, kind_of, read_contents
from globule.formats.frames import FrameOf
from globule.formats.registry import FORMATS
from globule.measure.track import facts
from globule.pieces.shown import shown_scene
from kinds import CENTERS, KINDS, RADII, Kind
from test_cells import area

MEASURED: dict[bytes, float] = {}


@pytest.fixture(params=KINDS, ids=[kind.name for kind in KINDS])
def kind(request, tmp_path, monkeypatch) -> Kind:
    """A kind whose file is in the folder where the test runs."""
    if request.param.package:
        pytest.importorskip(request.param.package)
    monkeypatch.chdir(tmp_path)
    request.param.make(tmp_path / request.param.file)
    return request.param


def test_what_is_read(kind):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        contents = read_contents(kind.file)
    assert len(said) == bool(kind.warns)
    assert kind.warns in "".join(str(one.message) for one in said)
    particles = contents.particles
    assert len(particles) == kind.n
    assert np.allclose(particles.bounds(), (kind.places.min(0), kind.places.max(0)), atol=2e-3)
    assert contents.n_frames == kind.frames
    assert contents.units.get("positions", "") == kind.unit
    box = contents.box
    assert (box and "".join(np.array([*"xyz"])[list(box.periodic)])) == kind.periodic
    assert {*kind.names} <= {*particles.attributes}
    if kind.area is not None:
        assert area(gb.Mesh(kind.file, device="cpu")) == pytest.approx(kind.area, rel=1e-6)
    if kind.frames > 1:
        second = gb.read(FrameOf(kind.file, 1))
        assert np.allclose(second.bounds()[0] - particles.bounds()[0], (1, 0, 0), atol=2e-3)
    if kind.volume is not None:
        assert volume_of(particles) == pytest.approx(kind.volume, rel=0.03)


def volume_of(particles: gb.Particles) -> float:
    """The volume that the surface encloses; that of the same particles is measured once."""
    radii = find_radii(particles)
    arrays = (particles.positions, radii, particles.support)
    what = b"".join(np.round(np.float64(a), 4).tobytes() for a in arrays if a is not None)
    if what not in MEASURED:
        scene = shown_scene(particles, device="cpu")
        MEASURED[what] = facts(scene)["volume"]
    return MEASURED[what]


def formats_of_kinds(folder: Path) -> dict[str, list[Kind]]:
    """The kinds by the names of their formats; files that cannot be made here by their endings."""
    found: dict[str, list[Kind]] = {form.name: [] for form in FORMATS}
    for k, one in enumerate(KINDS):
        (folder / str(k)).mkdir()
        path = folder / str(k) / one.file
        name = next((form.name for form in FORMATS if one.file.endswith(form.endings)), "")
        with contextlib.suppress(ImportError):
            one.make(path)
            name = name if name == "tsv" else kind_of(path).format  # a .csv by its content
        found[name].append(one)
    return found


def table_rows() -> list[list[str]]:
    """The cells of the reference's table of what each reader takes over."""
    text = (Path(__file__).parents[1] / "docs/reference/formats.md").read_text(encoding="utf-8")
    table = text.partition("### What each reader takes over")[2].partition("\n| files |")[2]
    lines = table.partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_reference_says_what_is_taken_over(tmp_path):
    rows = {frozenset(re.findall("`([^`]*)`", cells[0])): cells[1:] for cells in table_rows()}
    assert {frozenset(form.endings) for form in FORMATS} == rows.keys()
    known = formats_of_kinds(tmp_path)
    for form in FORMATS:
        options, radii, cells, ghosts, units, box, up = rows[frozenset(form.endings)]
        kinds = known[form.name]
        named = {word for word in re.findall("`([^`]*)`", options) if word.islower()}
        assert named == {*form.options}, form.name
        assert up == ("`upAxis`" if form.name == "usd" else form.up)
        assert not any(kind.frames > 1 for kind in kinds) or "frame" in form.options
        assert bool(units) == any(kind.unit for kind in kinds), form.name
        assert bool(box) == any(kind.periodic is not None for kind in kinds), form.name
        if cells != "as the parts":
            assert bool(cells) == any(kind.area for kind in kinds), form.name
            assert bool(radii) == gives_radii(form, kinds, tmp_path), form.name
            assert bool(ghosts) == any(kind.ghosts for kind in kinds), form.name


def gives_radii(form: Format, kinds: list[Kind], folder: Path) -> bool:
    """Whether files of a format can give the radii of spheres."""
    names = {name.lower() for kind in kinds for name in kind.names}
    if names & {"radius", "diameter"}:
        return True
    if not form.writes or (form.package and not find_spec({"usd-core": "pxr"}.get(form.package, form.package))):
        return bool(form.writes and form.package)
    path = folder / f"own{form.endings[0]}"
    gb.write(path, gb.Particles(CENTERS, attributes={"radius": RADII}))
    return find_radii(gb.read(path)) is not None


def test_there_are_enough():
    assert len(KINDS) >= 60
    assert len({kind.name for kind in KINDS}) == len(KINDS)
