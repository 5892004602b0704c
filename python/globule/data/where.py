"""Particles chosen by a condition on their values: `type == 1 and speed > 0.2`."""

from __future__ import annotations

import ast
import keyword
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from .._base.arrays import to_host
from .._base.checks import shown
from .attributes import attribute_names, attribute_values
from .particles import Particles

MOST = 2000  # characters
DEEPEST = 50  # of brackets and operators in each other

OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.true_divide,
    ast.Mod: np.mod, ast.Pow: np.float_power, ast.USub: np.negative, ast.UAdd: np.positive,
    ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal,
    ast.Eq: np.equal, ast.NotEq: np.not_equal, ast.And: np.logical_and, ast.Or: np.logical_or,
}  # fmt: skip
FUNCTIONS: dict[str, Callable[..., Any]] = {"abs": np.abs, "sqrt": np.sqrt, "isfinite": np.isfinite}


def where(particles: Particles, condition: str) -> Particles:
    """The particles for which a condition holds, in their order.

    Args:
        particles: N particles.
        condition: comparisons of numbers and names, joined by `and`, `or`, `not` and brackets:
            `type in (1, 3) and 0.2 < speed < 2`. Names are those of `attribute_values`; x, y and z
            are the file's coordinates, whatever the origin. A component of a vector is
            `velocity[0]`, and a name that Python would not take stands in backticks:
            `` `Temp [K]` > 300 ``. Also + - * / % **, abs, sqrt and isfinite. NaN is neither above
            nor below a number.

    Raises TypeError for a condition that is no text, ValueError that says what is wrong with it.
    """
    if not isinstance(condition, str):
        raise TypeError(f"where: expected a condition, got {shown(condition)}")
    try:
        with np.errstate(all="ignore"):
            mask = _Condition(particles, condition).mask()
    except ValueError as error:
        plain = re.sub("`[^`]*`", "", condition)
        odd = (n for n in attribute_names(particles) if n in plain and (not n.isidentifier() or keyword.iskeyword(n)))
        advice = next((f"; `{name}` stands in backticks" for name in odd), "")
        raise ValueError(f"where: {error}{advice}") from None
    return particles[mask]


class _Condition:
    """A condition on given particles, evaluated without Python's own `eval`."""

    def __init__(self, particles: Particles, text: str):
        self.particles, self.text = particles, text
        self.quoted: list[str] = []

    def mask(self) -> np.ndarray:
        """(N,) bool."""
        if len(self.text) > MOST:
            raise ValueError(f"expected at most {MOST} characters, got {len(self.text)}")
        if self.text.count("`") % 2:
            raise ValueError(f"expected backticks in pairs, got {self.text!r}")
        plain = re.sub(r"`([^`]*)`", self._placeholder, self.text).strip()
        try:
            tree = ast.parse(plain, mode="eval")
        except (SyntaxError, ValueError, MemoryError, RecursionError):
            example = "like 'type == 1 and speed > 0.2'"
            raise ValueError(f"expected a condition {example}, got {self.text!r}") from None
        value = self._value(tree.body, 0)
        if np.asarray(value).dtype != bool:
            raise ValueError(f"expected a comparison, as 'speed > 0.2' is, got {self.text!r}")
        return np.broadcast_to(value, len(self.particles))

    def _placeholder(self, found: re.Match[str]) -> str:
        self.quoted.append(found[1])
        return f" _quoted_{len(self.quoted) - 1} "

    def _value(self, node: ast.AST, depth: int) -> Any:
        if depth > DEEPEST:
            raise ValueError(f"expected at most {DEEPEST} brackets in each other, got more")
        of = lambda inner: self._value(inner, depth + 1)  # noqa: E731
        if isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float)):
            return self._number(node.value)
        if isinstance(node, ast.Name):
            return self._named(node.id)
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name):
            return self._component(node)
        if isinstance(node, ast.BoolOp):
            join, values = OPERATORS[type(node.op)], [self._truth(of(v), v) for v in node.values]
            return _folded(join, values)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return np.logical_not(self._truth(of(node.operand), node.operand))
        if isinstance(node, ast.UnaryOp) and type(node.op) in OPERATORS:
            return OPERATORS[type(node.op)](*self._terms(of, node.operand))
        if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
            return OPERATORS[type(node.op)](*self._terms(of, node.left, node.right))
        if isinstance(node, ast.Compare):
            return self._compared(node, of)
        if isinstance(node, ast.Call) and (function := self._function(node)):
            return function(of(node.args[0]))
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            raise ValueError(f"expected numbers, and names without quotes, got {self._words(node)}")
        known = "names, numbers, comparisons, and, or, not, + - * / % **, " + ", ".join(FUNCTIONS)
        raise ValueError(f"expected {known}; got {self._words(node)}")

    def _function(self, node: ast.Call) -> Callable[..., Any] | None:
        if not isinstance(node.func, ast.Name) or len(node.args) != 1 or node.keywords:
            return None
        return FUNCTIONS.get(node.func.id)

    def _compared(self, node: ast.Compare, of: Callable[[ast.AST], Any]) -> Any:
        parts, left = [], of(node.left)
        for op, right in zip(node.ops, node.comparators, strict=True):
            if isinstance(op, (ast.In, ast.NotIn)):
                if not isinstance(right, (ast.Tuple, ast.List, ast.Set)) or not right.elts:
                    raise ValueError(f"expected 'in (1, 2)', got {self._words(node)}")
                found = _folded(np.logical_or, [left == of(item) for item in right.elts])
                parts.append(found if isinstance(op, ast.In) else np.logical_not(found))
            elif type(op) in OPERATORS:
                now = of(right)
                parts.append(OPERATORS[type(op)](left, now))
                left = now
            else:
                raise ValueError(f"expected a comparison of numbers, got {self._words(node)}")
        return _folded(np.logical_and, parts)

    def _number(self, value: float) -> Any:
        if isinstance(value, int) and not -(2**63) <= value < 2**64:
            raise ValueError(f"expected numbers up to 2**64, got {shown(value)}")
        return value

    def _terms(self, of: Callable[[ast.AST], Any], *nodes: ast.AST) -> list[Any]:
        """Numbers to calculate with; whole ones in a type that neither wraps around nor rounds."""
        terms = [of(node) for node in nodes]
        for term, node in zip(terms, nodes, strict=True):
            if np.asarray(term).dtype == bool:
                raise ValueError(f"expected a number, got {self._words(node)}")
        whole = all(np.asarray(term).dtype.kind in "iu" for term in terms)
        return [np.asarray(term, np.longdouble) for term in terms] if whole else terms

    def _truth(self, value: Any, node: ast.AST) -> Any:
        if np.asarray(value).dtype != bool:
            raise ValueError(f"expected a comparison, got {self._words(node)}")
        return value

    def _name(self, word: str) -> str:
        found = re.fullmatch(r"_quoted_(\d+)", word)
        return self.quoted[int(found[1])] if found and int(found[1]) < len(self.quoted) else word

    def _named(self, word: str) -> Any:
        """The values of a name; whole numbers stay whole, as ids above 2**53 must."""
        name = self._name(word)
        array = self.particles.attributes.get(name)
        if array is None and name in ("x", "y", "z"):
            return self.particles.world_positions()[:, "xyz".index(name)].astype(np.float64)
        if array is None or array.ndim != 1 or array.dtype.kind not in "iub":
            return attribute_values(self.particles, name)
        array = to_host(array)
        return array if array.dtype == np.uint64 else array.astype(np.int64)

    def _component(self, node: ast.Subscript) -> Any:
        assert isinstance(node.value, ast.Name)
        if not isinstance(node.slice, ast.Constant) or type(node.slice.value) is not int:
            raise ValueError(f"expected the number of a component, got {self._words(node)}")
        return attribute_values(self.particles, f"{self._name(node.value.id)}:{node.slice.value}")

    def _words(self, node: ast.AST) -> str:
        said = re.sub(r"_quoted_(\d+)", lambda m: f"`{self._name(m[0])}`", ast.unparse(node))
        return shown(said)


def _folded(join: Callable[[Any, Any], Any], values: list[Any]) -> Any:
    whole = values[0]
    for value in values[1:]:
        whole = join(whole, value)
    return whole
