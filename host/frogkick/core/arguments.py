"""Arguments of wrong types in Python: one line that names the argument, whichever function was called."""

from __future__ import annotations

import collections.abc
import functools
import inspect
import numbers
import re
import reprlib
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

from frogkick.core.errors import FrogkickError, InputError

Called = TypeVar("Called", bound=Callable[..., Any])

_PLAIN = {
    "ArrayLike": "numbers of one shape",
    "Given": "a run or its file",
    "Int64": "a NumPy array of whole numbers",
    "Operators": "a function that gives an operator",
    "Progress": "True, False or a function of (done, all)",
    "Then": "'PATH@SECONDS'",
}
"""What is said for the name of a type that says little to a user."""


class ArgumentError(InputError, TypeError):
    """A call lacks an argument, has one too many, or has one of another type than is declared."""


def typed(called: Called) -> Called:
    """Name arguments that do not have their declared types in an error; decorates a function or a class.

    A switch or a function is checked before the call: any text is true, even 'False', and a callback is
    called late. Any other argument is only looked at if the call fails by an error that is not frogkick's:
    what works stays allowed, and a function's own words about a value reach the caller. As the body of a
    generator runs after the call, all arguments of one are checked before.

    Of a class, this holds for its constructor and its public methods.

    Raises:
        ArgumentError: by what is decorated.
    """
    if not isinstance(called, type):
        return typing.cast(Called, _checked(called, called.__qualname__))
    for name, method in list(vars(called).items()):
        shown = called.__name__ if name == "__init__" else f"{called.__name__}.{name}"
        if name != "__init__" and name.startswith("_"):
            continue
        if isinstance(method, classmethod):
            setattr(called, name, classmethod(_checked(method.__func__, shown)))
        elif inspect.isfunction(method):
            setattr(called, name, _checked(method, shown))
    return called


def _checked(function: Callable[..., Any], shown: str) -> Callable[..., Any]:
    signature = inspect.signature(function)
    early_only = inspect.isgeneratorfunction(inspect.unwrap(function))

    @functools.cache
    def declared() -> tuple[dict[str, Any], bool]:
        hints = {name: _hint(function, of.annotation) for name, of in signature.parameters.items()}
        return hints, any(map(_is_switch, hints.values()))

    def require(args: tuple[Any, ...], given: Mapping[str, Any], early: bool) -> None:
        try:
            bound = signature.bind(*args, **given).arguments
        except TypeError as error:
            raise ArgumentError(f"{shown}: {error}") from None
        hints, _ = declared()
        for name, value in bound.items():
            parameter = signature.parameters[name]
            if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                continue
            if (not early or early_only or _is_switch(hints[name])) and not fits(value, hints[name]):
                wanted = "".join(
                    _PLAIN.get(word, word) for word in re.split(r"\b", str(parameter.annotation))
                )
                raise ArgumentError(f"{shown}: {name} is {reprlib.repr(value)}, give {wanted}")

    @functools.wraps(function)
    def call(*args: Any, **given: Any) -> Any:
        if early_only or declared()[1]:
            require(args, given, early=True)
        try:
            return function(*args, **given)
        except Exception as error:
            # An inner function names its own argument, which may have another name here.
            if not isinstance(error, FrogkickError) or isinstance(error, ArgumentError):
                try:
                    require(args, given, early=False)
                except ArgumentError as wrong:
                    raise wrong from error
            raise

    return call


def _hint(function: Callable[..., Any], annotation: Any) -> Any:
    """The type that an annotation stands for; Any if it has none, or a name that is not there at run time."""
    if annotation is inspect.Parameter.empty:
        return Any
    holder = types.SimpleNamespace(__annotations__={"it": annotation})
    try:
        return typing.get_type_hints(holder, inspect.unwrap(function).__globals__)["it"]
    except NameError:
        return Any


def _members(hint: Any) -> Iterator[Any]:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        for member in typing.get_args(hint):
            yield from _members(member)
    else:
        yield hint


def _is_switch(hint: Any) -> bool:
    """Whether a type is True or False, or a function, or either."""
    return all(
        member is bool or typing.get_origin(member) is collections.abc.Callable for member in _members(hint)
    )


def fits(value: Any, hint: Any) -> bool:
    """Whether a value may be meant by a type; True for a type that cannot be checked at run time."""
    members = list(_members(hint))
    if any(str(getattr(member, "__module__", "")).startswith("numpy._typing") for member in members):
        return (value is None and type(None) in members) or _are_numbers(value)  # ArrayLike
    return any(_fits_one(value, member) for member in members)


def _are_numbers(value: Any) -> bool:
    import numpy as np

    try:
        np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return value is not None


def _fits_one(value: Any, hint: Any) -> bool:
    kind, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind is collections.abc.Callable:
        return callable(value)
    if hint is bool:
        return type(value).__name__ in ("bool", "bool_")  # numpy's own too
    if hint in (int, float):
        known = numbers.Integral if hint is int else numbers.Real
        return isinstance(value, known) and not isinstance(value, bool)
    if kind is collections.abc.Sequence:
        rows = hasattr(value, "__len__") and hasattr(value, "__getitem__")  # numpy's arrays are no Sequence
        return (
            rows
            and getattr(value, "ndim", 1) > 0  # an array of one number without a row has no length
            and not isinstance(value, str | bytes | Mapping)
            and all(fits(each, *inner) for each in value)
        )
    if hint is Any or not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return True
    return isinstance(value, kind)
