"""SIMD lanes: one value of W simulations in one vector, so that the same code runs for one or for many.

numba compiles a function for the types of its arguments. With arrays of float64 the rods' functions work on
one simulation. With arrays of ``lane_dtype(8)`` each ``get`` returns a vector of eight float64, and each + -
* / is one vector instruction if the processor has one of that width, otherwise several narrower ones. No
operation mixes lanes and none is reassociated or contracted, so the bits of a simulation depend neither on
the width nor on the other lanes nor on the processor.

LLVM does not vectorise loops over lanes by itself, because it cannot prove that the arrays do not overlap.
"""

# numba's own interfaces for extending it carry no types.
# mypy: disable-error-code="no-untyped-call, attr-defined"

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import cache
from math import prod
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, typing
from numba.core.datamodel import models, register_default
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import intrinsic, lower_builtin
from numba.np.arrayobj import make_array
from numpy.typing import DTypeLike

from frogkick.core.arrays import AnyArray, Float64

SimdArray = AnyArray
"""An array of lane_dtype(W); inside a compiled function also one vector of it."""

_FIELD = "lane"
_CACHE_LINE = 64


@cache
def lane_dtype(width: int) -> np.dtype[Any]:
    """Return the element type of arrays that hold one value of ``width`` simulations: float64 if it is 1."""
    scalar: DTypeLike = np.float64
    return np.dtype(scalar) if width == 1 else np.dtype([(_FIELD, scalar, (width,))])


def lane_zeros(shape: tuple[int, ...], width: int) -> AnyArray:
    """Return zeros of ``lane_dtype(width)``, aligned so that no row of lanes straddles two cache lines."""
    count = prod(shape) * width * 8
    raw = np.zeros(count + _CACHE_LINE, dtype=np.uint8)
    first = -raw.__array_interface__["data"][0] % _CACHE_LINE  # raw.ctypes takes several times as long
    return np.ndarray(shape, lane_dtype(width), raw, first)


def lane_floats(array: AnyArray) -> Float64:
    """Return the same memory as float64 with one more axis, the lanes."""
    return np.asarray(array[_FIELD] if array.dtype.names else array[..., None])


class SimdVector(types.Type):
    """A SIMD vector of ``width`` float64, as numba sees it inside a function."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(name=f"Lanes({width})")


@register_default(SimdVector)
class _SimdVectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: SimdVector) -> None:
        super().__init__(manager, lanes, ir.VectorType(ir.DoubleType(), lanes.width))


def _number(element: Any) -> types.Type | None:
    """Return the type that ``get`` returns for these elements; None if they are no numbers of lanes."""
    if element == types.float64:
        return types.float64
    if isinstance(element, types.Record) and list(element.fields) == [_FIELD]:
        return SimdVector(element.typeof(_FIELD).shape[0])
    return None


def _widest(*arguments: Any) -> Any:
    """Return the type of an operation on these types; None if they are no numbers or of two widths."""
    lanes = {a for a in arguments if isinstance(a, SimdVector)}
    if len(lanes) > 1 or not all(isinstance(a, SimdVector | types.Float) for a in arguments):
        return None
    return next(iter(lanes)) if lanes else types.float64


def _broadcast(context: Any, builder: Any, value: Any, given: Any, wanted: Any) -> Any:
    if given == wanted:
        return value
    if not isinstance(wanted, SimdVector):
        return context.cast(builder, value, given, wanted)
    vector = context.get_value_type(wanted)
    value = context.cast(builder, value, given, types.float64)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    order = ir.Constant(ir.VectorType(ir.IntType(32), wanted.width), [0] * wanted.width)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), order)


def _define_operator(symbol: Callable[..., Any], instruction: str) -> None:
    """Define a binary operator on SIMD vectors for numba; a float64 is broadcast."""

    class Typed(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            wanted = _widest(*args) if len(args) == 2 else None
            return typing.signature(wanted, *args) if isinstance(wanted, SimdVector) else None

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        left, right = (
            _broadcast(context, builder, value, given, sig.return_type)
            for value, given in zip(args, sig.args, strict=True)
        )
        return getattr(builder, instruction)(left, right)

    infer_global(symbol)(Typed)
    for pair in ((SimdVector, SimdVector), (SimdVector, types.Float), (types.Float, SimdVector)):
        lower_builtin(symbol, *pair)(lowered)


for _symbol, _in_place, _instruction in (
    (operator.add, operator.iadd, "fadd"),
    (operator.sub, operator.isub, "fsub"),
    (operator.mul, operator.imul, "fmul"),
    (operator.truediv, operator.itruediv, "fdiv"),
):
    _define_operator(_symbol, _instruction)
    _define_operator(_in_place, _instruction)


@infer_global(operator.neg)
class _Negated(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return typing.signature(args[0], *args) if isinstance(args[0], SimdVector) else None


@lower_builtin(operator.neg, SimdVector)
def _lower_negated(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0])


def _inlined(define: Callable[..., Any]) -> Callable[..., Any]:
    """Return numba's intrinsic: a function that writes LLVM instructions at its call in compiled code."""
    return cast(Callable[..., Any], intrinsic(define))


def _function(make: Callable[..., Any], given: tuple[Any, ...]) -> Any:
    """Return signature and code of a function on numbers of one width, from a function on LLVM values."""
    wanted = _widest(*given)
    if wanted is None:
        return None

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return make(
            builder,
            *(_broadcast(context, builder, a, t, wanted) for a, t in zip(args, sig.args, strict=True)),
        )

    return typing.signature(wanted, *given), code


def _llvm(builder: Any, name: str, value: Any) -> Any:
    kind = value.type
    suffix = f"v{kind.count}f64" if isinstance(kind, ir.VectorType) else "f64"
    return builder.call(
        cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(kind, [kind]), f"llvm.{name}.{suffix}"
        ),
        [value],
    )


@_inlined
def sqrt(typing_context: Any, x: Any) -> Any:
    """Square root of a number; NaN in the lanes where it is negative."""
    return _function(lambda builder, value: _llvm(builder, "sqrt", value), (x,))


@_inlined
def absolute(typing_context: Any, x: Any) -> Any:
    """Absolute value of a number."""
    return _function(lambda builder, value: _llvm(builder, "fabs", value), (x,))


@_inlined
def where_above(typing_context: Any, x: Any, limit: Any, yes: Any, no: Any) -> Any:
    """``yes`` in the lanes where x > limit or either is NaN, ``no`` in the others."""

    def make(builder: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
        return builder.select(builder.fcmp_unordered(">", a, b), c, d)

    return _function(make, (x, limit, yes, no))


@_inlined
def any_above(typing_context: Any, x: Any, limit: Any) -> Any:
    """Whether x > limit, or either is NaN, in any lane."""
    wanted = _widest(x, limit)
    if wanted is None:
        return None

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (_broadcast(context, builder, v, t, wanted) for v, t in zip(args, sig.args, strict=True))
        above = builder.fcmp_unordered(">", a, b)
        if isinstance(wanted, SimdVector):
            bits = builder.bitcast(above, ir.IntType(wanted.width))
            above = builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))
        return context.cast(builder, above, types.boolean, sig.return_type)

    return typing.signature(types.boolean, x, limit), code


def _pointer(context: Any, builder: Any, kind: Any, array: Any, indices: Any) -> Any:
    view = make_array(kind)(context, builder, array)
    pointer = cgutils.get_item_pointer(context, builder, kind, view, indices, wraparound=False)
    return builder.bitcast(pointer, context.get_value_type(_number(kind.dtype)).as_pointer())


_ALIGN = 8  # numpy aligns an array to its float64s, not to a whole row of lanes


@_inlined
def get(typing_context: Any, array: Any, i: Any, j: Any) -> Any:
    """Return array[i, j] as a number; indices must not be negative."""
    number = _number(array.dtype)
    if number is None or array.ndim != 2:
        return None

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_pointer(context, builder, sig.args[0], args[0], args[1:]), align=_ALIGN)

    return number(array, types.intp, types.intp), code


def _storing(array: Any, x: Any, new: Callable[[Any, Any, Any], Any]) -> Any:
    """Return signature and code of a function that sets array[i, j] to ``new(builder, place, x)``."""
    number = _number(array.dtype)
    if number is None or array.ndim != 2:
        return None

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value = _broadcast(context, builder, args[3], sig.args[3], number)
        place = _pointer(context, builder, sig.args[0], args[0], args[1:3])
        builder.store(new(builder, place, value), place, align=_ALIGN)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, x), code


@_inlined
def put(typing_context: Any, array: Any, i: Any, j: Any, x: Any) -> Any:
    """Set array[i, j] to a number; a float64 is set in each lane."""
    return _storing(array, x, lambda _builder, _place, value: value)


@_inlined
def add(typing_context: Any, array: Any, i: Any, j: Any, x: Any) -> Any:
    """array[i, j] += x; a float64 is added in each lane."""
    return _storing(
        array, x, lambda builder, place, value: builder.fadd(builder.load(place, align=_ALIGN), value)
    )
