"""Texts of arguments, as the fields of other programs take them."""

import pytest
from globule._base.structured import parse_arguments


def test_arguments():
    assert parse_arguments("Options", "") == parse_arguments("Options", "  ") == {}
    found = parse_arguments("Options", " where='type == 1', scale=-0.001, columns=('x', 'y'),")
    assert found == {"where": "type == 1", "scale": -0.001, "columns": ("x", "y")}
    assert parse_arguments("Options", "a=1  # one") == {"a": 1}


@pytest.mark.parametrize(
    "text", ["speed", "1", "a=", "a=b", "a=1), (2", "a=1)(b=2", "a=1).x(b=2", "**{'a': 1}", "((", "a='\0'",
             "a=1, a=2", "a=" + 9000 * "-" + "1", "a=" + "[" * 9000, 20_000 * " "],
)  # fmt: skip
def test_what_are_no_arguments(text):
    with pytest.raises(ValueError, match=r"Options: expected arguments such as where='type == 1', scale=0.001, got"):
        parse_arguments("Options", text)
