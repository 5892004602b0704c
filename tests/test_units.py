"""Units of length in the names of columns: one for all lengths of a file."""

import globule as gb
import numpy as np
import pytest
from globule.formats import read_contents

pytestmark = pytest.mark.usefixtures("folder")
ROWS = "0,0,0,400\n1,0,0,400\n1,1,0,400\n"


def contents(header: str, rows: str = ROWS, name: str = "a.csv", **options):
    with open(name, "w", encoding="utf-8") as file:
        file.write(f"{header}\n{rows}")
    return read_contents(name, **options)


@pytest.mark.parametrize("word", ["radius [mm]", "Particle Radius (millimeters)", "RADIUS[mm]"])
def test_lengths_take_the_unit_of_the_coordinates(word):
    name = word[: word.index("(") if "(" in word else word.index("[")].strip()
    with pytest.warns(UserWarning, match=f"{name} is in .* and becomes m, as x is"):
        found = contents(f"x [m],y [m],z [m],{word}")
    np.testing.assert_allclose(found.particles.attributes[name], 0.4)
    np.testing.assert_allclose(found.particles.support, 1.6, rtol=1e-6)
    assert found.units == {"positions": "m", name: "m"}


def test_axes_of_two_units_and_packed_tables():
    with pytest.warns(UserWarning, match="z is in cm and becomes m"):
        found = contents("x [m],y [m],z [cm],p [Pa]", "0,0,100,400\n1,0,0,400\n")
    np.testing.assert_allclose(found.particles.positions, [[0, 0, 1], [1, 0, 0]])
    assert found.units["p"] == "Pa"
    text = 'VARIABLES = "X [mm]" "Y [mm]" "Z [mm]" "diameter [um]"\nZONE'
    with pytest.warns(UserWarning, match="diameter is in um and becomes mm"):
        found = contents(text, ROWS.replace(",", " "), "a.plt")
    np.testing.assert_allclose(found.particles.attributes["diameter"], 0.4)
    pyarrow = pytest.importorskip("pyarrow")
    table = pyarrow.table({name: [0.0, 1.0, 2.0] for name in ("x", "y", "z", "radius")})
    units = {"x": b"m", "y": b"m", "z": b"m", "radius": b"mm"}
    fields = [field.with_metadata({b"unit": units[field.name]}) for field in table.schema]
    import pyarrow.parquet

    pyarrow.parquet.write_table(table.cast(pyarrow.schema(fields)), "a.parquet")
    with pytest.warns(UserWarning, match="radius is in mm"):
        np.testing.assert_allclose(gb.read("a.parquet").attributes["radius"], [0, 1e-3, 2e-3])


def test_what_cannot_be_reconciled_is_refused_with_the_mend():
    with pytest.raises(ValueError, match="'m' for x and 'furlong' for 'radius'; rename one, or --columns"):
        contents("x [m],y [m],z [m],radius [furlong]")
    found = contents("x [m],y [m],z [m],radius [furlong]", columns={"x": "x", "y": "y", "z": "z"})
    assert found.particles.support is None
    found = contents("x [m],y [m],z [m],h [J/kg]")  # an enthalpy
    assert found.particles.support is None
    assert [*found.particles.attributes] == ["h [J/kg]"]


def test_units_follow_the_scale():
    header = "x [m],y [m],z [m],radius [m]"
    assert contents(header, scale=1000).units == {"positions": "mm", "radius": "mm"}
    assert contents(header, scale=2).units["positions"] == "0.5 m"
    assert contents(header.replace("[m]", "[R_sun]"), scale=4).units["radius"] == "0.25 R_sun"
    found = contents("x [mm],y [mm],z [mm],p [mm]", scale=0.001, where="x > 0.5e-3")  # scaled first
    assert len(found.particles) == 2
    assert found.units == {"positions": "m", "p": "mm"}


@pytest.mark.parametrize("up", ["Height", "Elevation", "Alt", "H", "Z"])
def test_easting_northing_and_what_is_up(up):
    found = contents(f"Easting,Northing,{up},p", "1,2,3,9\n4,5,6,9\n")
    np.testing.assert_array_equal(found.particles.positions, [[1, 2, 3], [4, 5, 6]])
    found = contents("Easting [m],Northing [m],Depth [m]", "1,2,3\n4,5,6\n")
    np.testing.assert_array_equal(found.particles.positions, [[1, 2, -3], [4, 5, -6]])
    with pytest.raises(ValueError, match="--columns"):
        contents("Lat,Lon,Alt", "1,2,3\n4,5,6\n")
