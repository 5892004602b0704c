"""Settings: what a field says holds in Python, on the command line, in a file and in its schema."""

import argparse
import dataclasses
import math

import globule as gb
import pytest
from globule._base.settings import (
    RADIANCE,
    Choice,
    Color,
    Direction,
    Each,
    Number,
    Problem,
    Switch,
    Table,
    Vector,
    Whole,
    documented,
    read_table,
    same,
    schema_of,
    setting,
    settings_of,
)
from globule.scene.thesis import Thesis
from globule.ultrasound.options import Options
from globule.viewer.page.widgets import facts_of
from globule.viewer.state import GROUPS
from sim_helpers import tables

TABLES = [gb.RenderSettings, gb.Material, gb.Annotation, Thesis, Options, *GROUPS.values()]
TABLES += sorted(tables(), key=lambda table: table.__name__)


@documented
@dataclasses.dataclass(kw_only=True)
class Tap(Table):
    name: str = setting(Choice("hot", "cold"), help="which water it gives")
    rate: float = setting(Number(0.0, 2.0), 1.0, "flow. It is [steady](#x)", "l/s", usual="full")
    parts: list = setting(Each(Whole(1, 9), least=1, distinct=True), [], "numbers of its parts")


def test_one_field_makes_everything():
    rate = settings_of(Tap)["rate"]
    assert rate.words == "flow, l/s, 0 to 2. It is [steady](#x)"
    assert rate.brief == "flow, l/s, 0 to 2"
    assert "rate: flow, l/s, 0 to 2. It is steady; default: full." in Tap.__doc__
    assert facts_of(rate) | {"kind": "real", "least": 0.0, "most": 2.0, "label": "Rate"} == (facts_of(rate))
    schema = schema_of(Tap)
    assert schema["required"] == ["name"]
    assert schema["properties"]["rate"] == {
        "type": "number", "minimum": 0.0, "maximum": 2.0, "default": 1.0,
        "description": "flow, l/s, 0 to 2. It is steady",
    }  # fmt: skip
    assert same(Tap, "rate", default=0.5).default == 0.5
    for kind, wrong in ((Switch(), 1), (Number(), True), (Whole(0, 1), False)):
        with pytest.raises(TypeError):
            kind(wrong)


@pytest.mark.parametrize(("table", "message"), [
    ({"name": "warm"}, "name: expected hot or cold, got 'warm'"),
    ({"name": "hot", "rate": 3}, "rate: expected a number from 0 to 2, got 3"),
    ({"name": "hot", "rate": "x"}, "rate: expected a number from 0 to 2, got 'x'"),
    ({"name": "hot", "flow": 1}, "flow: expected one of name, rate, parts, got an unknown key"),
    ({"rate": 1}, "expected the key name, got none"),
    ({"name": "hot", "parts": [2, 2]}, "parts[1]: expected each once, got 2 again"),
    ({"name": "hot", "parts": [1.5]}, "parts[0]: expected a whole number from 1 to 9, got 1.5"),
    (3, "expected a table of names with values, got 3"),
])  # fmt: skip
def test_mistakes_name_the_key(table, message):
    with pytest.raises(Problem) as caught:
        read_table(Tap, table)
    assert str(caught.value) == message


@pytest.mark.parametrize(("kind", "word", "value"), [
    (Number(0.0, 1.0), "0.5", 0.5),
    (Whole(0, 32), "32", 32),
    (Vector(), "1,-2,3", (1.0, -2.0, 3.0)),
    (Direction(), "0,2,0", (0.0, 1.0, 0.0)),
    (RADIANCE, "2", (2.0, 2.0, 2.0)),
    (Color(), "#ffffff", (1.0, 1.0, 1.0)),
])  # fmt: skip
def test_words_of_a_command(kind, word, value):
    assert kind.parse(word) == value
    for wrong in ("?", "1,x", "nan", "99,99"):
        with pytest.raises(argparse.ArgumentTypeError, match=f"expected .*, got '{wrong}'|99"):
            kind.parse(wrong)


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_limits_are_the_same_everywhere(table):
    jsonschema = pytest.importorskip("jsonschema")
    for name, one in settings_of(table).items():
        assert one.help, name
        if not isinstance(one.kind, Number):
            continue
        check = jsonschema.Draft202012Validator(schema_of(one.kind)).is_valid
        for end, out in ((one.kind.least, -1), (one.kind.most, 1)):
            if not math.isfinite(end) or one.kind.above >= end:
                continue
            beyond = end + out if isinstance(one.kind, Whole) else math.nextafter(end, out * 1e308)
            assert one.kind(end) == end
            assert check(end)
            assert not check(beyond)
            if end >= 0:
                assert one.kind.parse(repr(end)) == end
            with pytest.raises(Problem, match=r"expected .*, got "):
                one.kind(beyond)
