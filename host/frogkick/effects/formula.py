"""Formulas of a law: a small language that is parsed, checked for units and evaluated, never run as Python.

A formula consists of numbers, named variables and parameters, ``+ - * / **``, comparisons (1 if true, 0 if
not) and the functions of FUNCTIONS. Each quantity has a unit. Sums and comparisons need equal units,
functions such as ``sin`` need pure numbers, and the result must have the unit of its key. A plain 0 fits any
unit.
"""

from __future__ import annotations

import ast
import math
import operator
import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError, nearest_name

FloatArray = NDArray[np.float64]
Unit = tuple[float, float, float]
"""Exponents of kilogram, metre and second; radians are pure numbers."""

ONE: Unit = (0.0, 0.0, 0.0)
_BASE: Mapping[str, Unit] = {
    "1": ONE,
    "rad": ONE,
    "kg": (1.0, 0.0, 0.0),
    "m": (0.0, 1.0, 0.0),
    "s": (0.0, 0.0, 1.0),
    "min": (0.0, 0.0, 1.0),
    "N": (1.0, 1.0, -2.0),
}

LONGEST = 500
"""Largest number of characters of a formula."""

Values = Mapping[str, float]
_Run = Callable[[Values], float]

_ONE_AT_A_TIME = threading.Lock()
"""Held while Python builds a syntax tree: CPython 3.11 counts the depth of all threads in one number, and
raises SystemError where two threads build one at once (python/cpython issue 106905)."""


def unit_of(text: str) -> Unit:
    """Read a unit such as ``N s/m`` or ``m^2/s``: what follows each slash divides by one factor.

    Raises:
        InputError: it is none.
    """
    found = [0.0, 0.0, 0.0]
    for sign, name, power in re.findall(r"(/?)\s*([A-Za-z]+|1)(?:\^(-?\d+))?", text):
        if name not in _BASE:
            raise InputError(
                f"unit {text!r} has {name!r}: units are made of {', '.join(_BASE)}, as in 'N s/m'"
            )
        exponent = float(power or 1.0) * (-1.0 if sign else 1.0)
        for k, share in enumerate(_BASE[name]):
            found[k] += exponent * share
    if not text.strip() or re.sub(r"(/?)\s*([A-Za-z]+|1)(?:\^(-?\d+))?|[\s*]", "", text):
        raise InputError(
            f"unit {text!r} cannot be read: write it as in 'N s/m' or 'm^2/s', '1' for a pure number"
        )
    return found[0], found[1], found[2]


def in_words(unit: Unit) -> str:
    """Return a unit as text."""
    parts = [
        name if power == 1.0 else f"{name}^{power:g}"
        for name, power in zip(("kg", "m", "s"), unit, strict=True)
        if power
    ]
    return " ".join(parts) or "1"


def _finite(function: Callable[..., float]) -> Callable[..., float]:
    """Return the function with infinity or NaN instead of an error."""

    def run(*values: float) -> float:
        try:
            return function(*values)
        except OverflowError:
            return math.inf
        except ValueError:
            return math.nan

    return run


def _divide(a: float, b: float) -> float:
    """Divide; 0 / 0 is 0, such as the direction to a point at the robot."""
    if b:
        return a / b
    return math.copysign(math.inf, a) if a else 0.0


def _power(a: float, b: float) -> float:
    found = a**b if a or b >= 0.0 else math.inf
    return math.nan if isinstance(found, complex) else float(found)


FUNCTIONS: Mapping[str, tuple[int, Callable[..., float]]] = {
    "sin": (1, _finite(math.sin)),
    "cos": (1, _finite(math.cos)),
    "exp": (1, _finite(math.exp)),
    "log": (1, _finite(math.log)),
    "tanh": (1, math.tanh),
    "sqrt": (1, _finite(math.sqrt)),
    "abs": (1, abs),
    "sign": (1, lambda value: math.copysign(1.0, value) if value else 0.0),
    "min": (2, min),
    "max": (2, max),
    "hypot": (2, math.hypot),
    "atan2": (2, math.atan2),
}
"""Name -> number of arguments, and the function."""

_OF_ARRAYS: Mapping[str, Callable[..., FloatArray]] = {
    "min": np.minimum,
    "max": np.maximum,
    "hypot": np.hypot,
    "atan2": np.arctan2,
    **{name: getattr(np, name) for name in ("sin", "cos", "exp", "log", "tanh", "sqrt", "abs", "sign")},
}

_PURE = ("sin", "cos", "exp", "log", "tanh")
_PAIRS: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: _divide,
    ast.Pow: _finite(_power),
}
_COMPARISONS: Mapping[type[ast.cmpop], Callable[[float, float], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


@dataclass(frozen=True)
class _Node:
    """A part of a formula: its function, its unit (None: a plain 0, of any unit), its value if constant."""

    run: _Run
    unit: Unit | None
    constant: float | None = None


@dataclass(frozen=True)
class Formula:
    """A checked formula.

    Attributes:
        names: variables and parameters in it.
    """

    text: str
    names: frozenset[str]
    _run: _Run
    _tree: ast.expr

    def __call__(self, values: Values) -> float:
        """Return its value; infinite or NaN if it has none.

        Args:
            values: values of all its names.
        """
        return float(self._run(values))

    def over(self, values: Mapping[str, FloatArray | float]) -> FloatArray:
        """Return its values for arrays of all its names, of one shape each, or numbers."""
        with np.errstate(all="ignore"):
            return np.asarray(_over(self._tree, values), dtype=np.float64)


def _over(tree: ast.expr, values: Mapping[str, FloatArray | float]) -> FloatArray:
    """The values of a part of a formula that was checked."""
    if isinstance(tree, ast.Constant):
        return np.array(tree.value, dtype=np.float64)
    if isinstance(tree, ast.Name):
        return np.asarray(values[tree.id], dtype=np.float64)
    if isinstance(tree, ast.UnaryOp):
        return -_over(tree.operand, values)
    if isinstance(tree, ast.Call):
        assert isinstance(tree.func, ast.Name)
        return _OF_ARRAYS[tree.func.id](*(_over(each, values) for each in tree.args))
    if isinstance(tree, ast.Compare):
        act: Any = _COMPARISONS[type(tree.ops[0])]
        return np.asarray(act(_over(tree.left, values), _over(tree.comparators[0], values)), np.float64)
    assert isinstance(tree, ast.BinOp)
    one, other = _over(tree.left, values), _over(tree.right, values)
    if isinstance(tree.op, ast.Div):
        return np.where(other == 0.0, np.where(one == 0.0, 0.0, np.inf * np.sign(one)), one / other)
    act = np.power if isinstance(tree.op, ast.Pow) else _PAIRS[type(tree.op)]
    return np.asarray(act(one, other), np.float64)


def parse(text: str, units: Mapping[str, Unit], wanted: Unit) -> Formula:
    """Read and check a formula.

    Args:
        units: unit of each name that it may use.
        wanted: unit of its result.

    Raises:
        InputError: invalid syntax, an unknown name, or units that do not fit.
    """
    if len(text) > LONGEST:
        raise InputError(f"formula {text[:40]!r}... has {len(text)} characters: {LONGEST} are allowed")
    try:
        with _ONE_AT_A_TIME:
            tree = ast.parse(" ".join(text.split()), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"formula {text!r} cannot be read: {getattr(error, 'msg', error)}") from None
    names: set[str] = set()
    node = _Reader(text, units, names).node(tree)
    if node.unit not in (None, wanted):
        raise InputError(
            f"formula {text!r} comes out in {in_words(node.unit or ONE)}, needed is {in_words(wanted)}: "
            "check its units"
        )
    return Formula(text, frozenset(names), node.run, tree)


class _Reader:
    """Turns a syntax tree into functions; anything outside the language raises an error."""

    def __init__(self, text: str, units: Mapping[str, Unit], names: set[str]) -> None:
        self.text, self.units, self.names = text, units, names

    def refuse(self, why: str) -> InputError:
        return InputError(f"formula {self.text!r}: {why}")

    def node(self, tree: ast.expr) -> _Node:
        if isinstance(tree, ast.Constant) and type(tree.value) in (int, float):
            value = float(tree.value)  # type: ignore[arg-type]
            if not math.isfinite(value):
                raise self.refuse("a number is infinite")
            return _Node(lambda _: value, ONE if value else None, value)
        if isinstance(tree, ast.Name):
            return self.name(tree.id)
        if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
            inner = self.node(tree.operand)
            run = inner.run
            return _Node(lambda v: -run(v), inner.unit, None if inner.constant is None else -inner.constant)
        if isinstance(tree, ast.BinOp) and type(tree.op) in _PAIRS:
            return self.pair(tree)
        if isinstance(tree, ast.Compare) and len(tree.ops) == 1 and type(tree.ops[0]) in _COMPARISONS:
            one, other = self.node(tree.left), self.node(tree.comparators[0])
            self.same(one, other, "compares")
            compare, a, b = _COMPARISONS[type(tree.ops[0])], one.run, other.run
            return _Node(lambda v: 1.0 if compare(a(v), b(v)) else 0.0, ONE)
        if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) and not tree.keywords:
            return self.call(tree.func.id, tree.args)
        raise self.refuse(
            f"{ast.unparse(tree)!r} is not of the language: it has numbers, names, + - * / **, < and "
            + ", ".join(FUNCTIONS)
        )

    def name(self, name: str) -> _Node:
        if name not in self.units:
            raise self.refuse(
                f"there is no {name!r}{nearest_name(name, self.units)}: give {', '.join(sorted(self.units))}"
            )
        self.names.add(name)
        return _Node(operator.itemgetter(name), self.units[name])

    def pair(self, tree: ast.BinOp) -> _Node:
        one, other = self.node(tree.left), self.node(tree.right)
        act, a, b = _PAIRS[type(tree.op)], one.run, other.run
        constant = None
        if one.constant is not None and other.constant is not None:
            constant = act(one.constant, other.constant)
        unit: Unit | None
        if isinstance(tree.op, ast.Add | ast.Sub):
            self.same(one, other, "adds")
            unit = one.unit if one.unit is not None else other.unit
        elif isinstance(tree.op, ast.Pow):
            if other.unit not in (None, ONE):
                raise self.refuse(f"an exponent is in {in_words(other.unit or ONE)}, and must be pure")
            if one.unit not in (None, ONE) and other.constant is None:
                raise self.refuse("an exponent that is no plain number needs a pure number below it")
            unit = None if one.unit is None else _scaled(one.unit, other.constant or 0.0)
        elif one.unit is None:
            unit = None
        else:
            sign = -1.0 if isinstance(tree.op, ast.Div) else 1.0
            more = _scaled(other.unit or ONE, sign)
            unit = (one.unit[0] + more[0], one.unit[1] + more[1], one.unit[2] + more[2])
            unit = None if other.unit is None and sign > 0.0 else unit
        return _Node(lambda v: act(a(v), b(v)), unit, constant)

    def call(self, name: str, arguments: list[ast.expr]) -> _Node:
        if name not in FUNCTIONS:
            raise self.refuse(
                f"there is no function {name!r}{nearest_name(name, FUNCTIONS)}: there are "
                + ", ".join(FUNCTIONS)
            )
        count, act = FUNCTIONS[name]
        if len(arguments) != count:
            raise self.refuse(f"{name} takes {count} arguments, {len(arguments)} are given")
        parts = [self.node(each) for each in arguments]
        first = parts[0]
        if name in _PURE and first.unit not in (None, ONE):
            raise self.refuse(f"{name} takes a pure number, not one in {in_words(first.unit or ONE)}")
        if count == 2:
            self.same(parts[0], parts[1], f"{name} takes")
            a, b = parts[0].run, parts[1].run
            unit = parts[0].unit if parts[0].unit is not None else parts[1].unit
            return _Node(lambda v: act(a(v), b(v)), ONE if name == "atan2" else unit)
        a = first.run
        unit = ONE if name in (*_PURE, "sign") else first.unit
        if name == "sqrt" and unit is not None:
            unit = _scaled(unit, 0.5)
        return _Node(lambda v: act(a(v)), unit)

    def same(self, one: _Node, other: _Node, what: str) -> None:
        if one.unit is not None and other.unit is not None and one.unit != other.unit:
            raise self.refuse(f"{what} {in_words(one.unit)} and {in_words(other.unit)}: units must be equal")


def _scaled(unit: Unit, factor: float) -> Unit:
    return unit[0] * factor, unit[1] * factor, unit[2] * factor
