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
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError, nearest_name

Unit = tuple[float, float, float]
"""Exponents of kilogram, metre and second; radians are pure numbers."""

ONE: Unit = (0.0, 0.0, 0.0)
_BASE: Mapping[str, Unit] = {
    "1": ONE,
    "rad": ONE,
    "kg": (1.0, 0.0, 0.0),
    "m": (0.0, 1.0, 0.0),
    "s": (0.0, 0.0, 1.0),
    "N": (1.0, 1.0, -2.0),
}

_FACTOR = re.compile(r"(/?)\s*([A-Za-z]+|1)(?:\^(-?\d+))?")

LONGEST = 500
"""Largest number of characters of a formula."""

_Run = Callable[[Mapping[str, Any]], Any]

_ONE_AT_A_TIME = threading.Lock()
"""Held while Python builds a syntax tree: CPython 3.11 counts the depth of all threads in one number, and
raises SystemError where two threads build one at once (python/cpython issue 106905)."""


def unit_of(text: str) -> Unit:
    """Read a unit such as ``N s/m`` or ``m^2/s``: what follows each slash divides by one factor.

    Raises:
        InputError: it is none.
    """
    found = [0.0, 0.0, 0.0]
    for sign, name, power in _FACTOR.findall(text):
        if name not in _BASE:
            raise InputError(
                f"unit {text!r} has {name!r}: units are made of {', '.join(_BASE)}, as in 'N s/m'"
            )
        exponent = float(power or 1.0) * (-1.0 if sign else 1.0)
        for k, share in enumerate(_BASE[name]):
            found[k] += exponent * share
    if not text.strip() or _FACTOR.sub("", text).replace("*", "").strip():
        raise InputError(
            f"unit {text!r} cannot be read: write it as in 'N s/m' or 'm^2/s', '1' for a pure number"
        )
    return found[0], found[1], found[2]


def in_words(unit: Unit) -> str:
    """Return a unit as text."""
    powers = [(name, power) for name, power in zip(("kg", "m", "s"), unit, strict=True) if power]
    return " ".join(name if power == 1.0 else f"{name}^{power:g}" for name, power in powers) or "1"


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

_PURE = ("sin", "cos", "exp", "log", "tanh")
_COMPARISONS = {ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge}
_SUMS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul}


def _divide_arrays(a: Float64, b: Float64) -> Float64:
    return np.where(b == 0.0, np.where(a == 0.0, 0.0, np.inf * np.sign(a)), a / b)


def _as_float(compare: Callable[[Any, Any], Any]) -> Callable[[Any, Any], float]:
    return lambda a, b: 1.0 if compare(a, b) else 0.0


def _as_floats(compare: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Float64]:
    return lambda a, b: np.asarray(compare(a, b), np.float64)


_Acts = Mapping[Any, Callable[..., Any]]
_OF_NUMBERS: _Acts = {
    **{name: act for name, (_, act) in FUNCTIONS.items()},
    **_SUMS, ast.Div: _divide, ast.Pow: _finite(_power), ast.Constant: float,
    **{kind: _as_float(compare) for kind, compare in _COMPARISONS.items()},
}  # fmt: skip
"""What a function's name, or a class of the syntax tree, does to numbers."""
_OF_ARRAYS: _Acts = {
    **{name: getattr(np, {"min": "minimum", "max": "maximum", "atan2": "arctan2"}.get(name, name))
       for name in FUNCTIONS},
    **_SUMS, ast.Div: _divide_arrays, ast.Pow: np.power, ast.Constant: np.float64,
    **{kind: _as_floats(compare) for kind, compare in _COMPARISONS.items()},
}  # fmt: skip
"""The same to arrays."""


def _compiled(tree: ast.expr, acts: _Acts) -> _Run:
    """Return the function of a formula, or a part of one, that was checked."""
    if isinstance(tree, ast.Constant):
        value = acts[ast.Constant](tree.value)
        return lambda _: value
    if isinstance(tree, ast.Name):
        return operator.itemgetter(tree.id)
    if isinstance(tree, ast.UnaryOp):
        inner = _compiled(tree.operand, acts)
        return lambda v: -inner(v)
    if isinstance(tree, ast.Call):
        assert isinstance(tree.func, ast.Name)
        act, parts = acts[tree.func.id], tree.args
    elif isinstance(tree, ast.Compare):
        act, parts = acts[type(tree.ops[0])], [tree.left, tree.comparators[0]]
    else:
        assert isinstance(tree, ast.BinOp)
        act, parts = acts[type(tree.op)], [tree.left, tree.right]
    first, *second = (_compiled(part, acts) for part in parts)
    if not second:
        return lambda v: act(first(v))
    other = second[0]
    return lambda v: act(first(v), other(v))


@dataclass(frozen=True)
class Formula:
    """A checked formula.

    Attributes:
        names: variables and parameters in it.
    """

    text: str
    names: frozenset[str]
    _run: _Run
    _run_arrays: _Run

    def __call__(self, values: Mapping[str, float]) -> float:
        """Return its value; infinite or NaN if it has none.

        Args:
            values: values of all its names.
        """
        return float(self._run(values))

    def over(self, values: Mapping[str, Float64 | float]) -> Float64:
        """Return its values for arrays of all its names, of one shape each, or numbers."""
        arrays = {name: np.asarray(values[name], np.float64) for name in self.names}
        with np.errstate(all="ignore"):
            return np.asarray(self._run_arrays(arrays), np.float64)


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
    reader = _Reader(text, units)
    unit = reader.unit(tree)
    if unit not in (None, wanted):
        raise InputError(
            f"formula {text!r} comes out in {in_words(unit or ONE)}, needed is {in_words(wanted)}: "
            "check its units"
        )
    return Formula(text, frozenset(reader.names), _compiled(tree, _OF_NUMBERS), _compiled(tree, _OF_ARRAYS))


class _Reader:
    """Finds the unit of a syntax tree, None for a plain 0; anything outside the language raises an error."""

    def __init__(self, text: str, units: Mapping[str, Unit]) -> None:
        self.text, self.units = text, units
        self.names: set[str] = set()

    def refuse(self, why: str) -> InputError:
        return InputError(f"formula {self.text!r}: {why}")

    def unit(self, tree: ast.expr) -> Unit | None:
        if isinstance(tree, ast.Constant) and type(tree.value) in (int, float):
            if not abs(tree.value) <= sys.float_info.max:  # type: ignore[arg-type]
                raise self.refuse("a number is infinite")
            return ONE if tree.value else None
        if isinstance(tree, ast.Name):
            if tree.id not in self.units:
                near, known = nearest_name(tree.id, self.units), ", ".join(sorted(self.units))
                raise self.refuse(f"there is no {tree.id!r}{near}: give {known}")
            self.names.add(tree.id)
            return self.units[tree.id]
        if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
            return self.unit(tree.operand)
        if isinstance(tree, ast.BinOp) and type(tree.op) in _OF_NUMBERS:
            return self.pair(tree)
        if isinstance(tree, ast.Compare) and len(tree.ops) == 1 and type(tree.ops[0]) in _COMPARISONS:
            self.same(self.unit(tree.left), self.unit(tree.comparators[0]), "compares")
            return ONE
        if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) and not tree.keywords:
            return self.call(tree.func.id, tree.args)
        raise self.refuse(
            f"{ast.unparse(tree)!r} is not of the language: it has numbers, names, + - * / **, < and "
            + ", ".join(FUNCTIONS)
        )

    def pair(self, tree: ast.BinOp) -> Unit | None:
        one, other = self.unit(tree.left), self.unit(tree.right)
        if isinstance(tree.op, ast.Add | ast.Sub):
            return self.same(one, other, "adds")
        if isinstance(tree.op, ast.Pow):
            if other not in (None, ONE):
                raise self.refuse(f"an exponent is in {in_words(other or ONE)}, and must be pure")
            parts = ast.walk(tree.right)
            is_plain = not any(isinstance(part, ast.Name | ast.Call | ast.Compare) for part in parts)
            if one not in (None, ONE) and not is_plain:
                raise self.refuse("an exponent that is no plain number needs a pure number below it")
            exponent = _compiled(tree.right, _OF_NUMBERS)({}) if is_plain else 0.0
            return None if one is None else _scaled(one, exponent)
        if one is None or (other is None and isinstance(tree.op, ast.Mult)):
            return None
        more = _scaled(other or ONE, -1.0 if isinstance(tree.op, ast.Div) else 1.0)
        return one[0] + more[0], one[1] + more[1], one[2] + more[2]

    def call(self, name: str, arguments: list[ast.expr]) -> Unit | None:
        if name not in FUNCTIONS:
            near, known = nearest_name(name, FUNCTIONS), ", ".join(FUNCTIONS)
            raise self.refuse(f"there is no function {name!r}{near}: there are {known}")
        count, _ = FUNCTIONS[name]
        if len(arguments) != count:
            raise self.refuse(f"{name} takes {count} arguments, {len(arguments)} are given")
        first, *second = (self.unit(each) for each in arguments)
        if name in _PURE and first not in (None, ONE):
            raise self.refuse(f"{name} takes a pure number, not one in {in_words(first or ONE)}")
        unit = self.same(first, second[0], f"{name} takes") if second else first
        if name in (*_PURE, "sign", "atan2"):
            return ONE
        return _scaled(unit, 0.5) if name == "sqrt" and unit is not None else unit

    def same(self, one: Unit | None, other: Unit | None, what: str) -> Unit | None:
        """Return the unit that both have."""
        if one is not None and other is not None and one != other:
            raise self.refuse(f"{what} {in_words(one)} and {in_words(other)}: units must be equal")
        return one if one is not None else other


def _scaled(unit: Unit, factor: float) -> Unit:
    return unit[0] * factor, unit[1] * factor, unit[2] * factor
