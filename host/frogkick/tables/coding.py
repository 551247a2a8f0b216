"""Coding of a table's values: predictions from its states' codes, and residuals in few bits.

All numbers in an image come from integer sums and single float64 operations in a fixed order, so that every
processor and linear algebra library makes the same image.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64, Int16, Int64, solve_positive
from frogkick.tables import layout

ONE = 16384
"""Denominator of a state's codes in a prediction."""
_RIDGE = 1e-11
"""Ridge penalty relative to the diagonal, for blocks with fewer rows than coefficients."""


def bits_for(largest: Int64) -> Int64:
    return np.array([int(value).bit_length() for value in largest.ravel()], dtype=np.int64).reshape(
        largest.shape
    )


def put_residuals(residuals: Int64, bits: Int64) -> bytes:
    """Write rows (n, c) of unsigned numbers as bits, the least significant first.

    ``bits`` (c,), 0 to 16 each: the numbers are below 2**bits.
    """
    row_bytes = (int(bits.sum()) + 7) // 8
    rows = np.zeros((len(residuals), row_bytes + 4), dtype=np.uint8)
    offset = 0
    for column, width in enumerate(bits.tolist()):
        shifted = (residuals[:, column] << (offset & 7)).astype("<u4")
        rows[:, offset >> 3 : (offset >> 3) + 4] |= shifted[:, None].view(np.uint8)
        offset += width
    return rows[:, :row_bytes].tobytes()


def take_residuals(section: bytes, rows: int, row_bytes: int, bits: Int64) -> Int64:
    """Inverse of put_residuals: (rows, c); ``section`` has at least 3 more bytes."""
    padded = np.zeros((rows, row_bytes + 4), dtype=np.uint8)
    padded[:, :row_bytes] = np.frombuffer(section, np.uint8, rows * row_bytes).reshape(rows, row_bytes)
    found = np.empty((rows, len(bits)), dtype=np.int64)
    offset = 0
    for column, width in enumerate(bits.tolist()):
        word = np.ascontiguousarray(padded[:, offset >> 3 : (offset >> 3) + 4]).view("<u4")[:, 0]
        found[:, column] = (word.astype(np.int64) >> (offset & 7)) & ((1 << width) - 1)
        offset += width
    return found


def products(codes: Int16, up: Int64) -> Int64:
    """(n, 10) factors of a prediction's coefficients, for (n, 3) state codes."""
    u = codes.astype(np.int64) << up
    first, second = np.triu_indices(3)
    squares = (u[:, first] * u[:, second]) >> 14
    return np.concatenate([np.full((len(u), 1), ONE), u, squares], axis=1)


def predictions(factors: Int64, coefficients: Int64, shift: Int64) -> Int64:
    """Return the (n, c) predicted codes of a block, without residuals.

    They follow from (n, 10) products(), (10, c) coefficients and (c,) shifts.
    """
    return np.asarray((factors @ coefficients) >> shift, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Coefficients of blocks of rows, and residuals."""

    levels: int  # 2**levels blocks
    up: Int64  # (3,) left shift of the state codes
    shift: Int64  # (c,) of each value
    coefficients: Int64  # (2**levels, c, 10)
    residuals: Int64  # (n, c) unsigned units
    decoded: Int64  # (n, c) codes that a reader gets, not clamped

    def byte_count(self) -> int:
        """Bytes of coefficients and transitions."""
        bits = int(bits_for(self.residuals.max(axis=0)).sum())
        return 2 * self.coefficients.size + len(self.residuals) * ((bits + 7) // 8)


def best_prediction(codes: Int16, wanted: Float64, unit: Int64) -> Prediction:
    """The prediction with the number of blocks that needs the fewest bytes.

    Args:
        codes: (n, 3) states in k-d order.
        wanted: (n, c) values in codes; c a multiple of 6, of which every sixth column shares a shift.
        unit: (c,) codes per unit of a residual.
    """
    largest = np.maximum(np.abs(codes.astype(np.int64)).max(axis=0), 1)
    up = np.array([14 - int(code).bit_length() for code in largest], dtype=np.int64)
    factors = products(codes, up)
    best = _constant(factors, wanted, unit, up)
    for levels in range(layout.BLOCK_LEVELS_MAX + 1):
        if 2**levels * 4 > len(codes) and levels:
            break
        found = _fitted(factors, wanted, unit, up, levels)
        if found is not None and found.byte_count() < best.byte_count():
            best = found
    return best


def _constant(factors: Int64, wanted: Float64, unit: Int64, up: Int64) -> Prediction:
    """Constant prediction by the least of each value, which is always possible."""
    shift = np.full(wanted.shape[1], layout.PREDICTION_SHIFTS[0], dtype=np.int64)
    coefficients = np.zeros((1, wanted.shape[1], layout.COEFFICIENTS), dtype=np.int64)
    coefficients[0, :, 0] = np.maximum(np.floor(wanted.min(axis=0)), -32767)
    return _with_residuals(factors, wanted, unit, up, shift, coefficients)


def _fitted(factors: Int64, wanted: Float64, unit: Int64, up: Int64, levels: int) -> Prediction | None:
    """A quadratic for each block; None if a number leaves its range."""
    first = layout.first_rows(len(factors), levels)
    rounded = np.floor(wanted + 0.5).astype(np.int64)
    # Blocks, 10, c: codes.
    solved = np.stack([_least_squares(factors[a:b], rounded[a:b]) for a, b in itertools.pairwise(first)])
    shift = _shift(solved)
    if shift is None:
        return None
    coefficients = np.floor(solved * 2.0 ** (shift - 14) + 0.5).astype(np.int64).transpose(0, 2, 1)
    found = _with_residuals(factors, wanted, unit, up, shift, coefficients)
    sums = np.abs(found.coefficients).sum(axis=2)
    fits = int(np.abs(found.coefficients).max()) <= 32767 and int(sums.max()) <= layout.COEFFICIENT_SUM_MAX
    return found if fits and int(found.residuals.max()) < 2**layout.BITS_MAX else None


def _shift(solved: Float64) -> Int64 | None:
    """(c,) the largest shift at which the coefficients stay in range with the residuals' least added."""
    largest = np.abs(solved).max(axis=(0, 1)).reshape(-1, 6).max(axis=0)
    sums = np.abs(solved).sum(axis=1).max(axis=0).reshape(-1, 6).max(axis=0)
    low, high = layout.PREDICTION_SHIFTS
    for_value = []
    for most, total in zip(largest.tolist(), sums.tolist(), strict=True):
        shift = high
        while shift >= low and (
            most * 2.0 ** (shift - 14) > 30000.0 or total * 2.0 ** (shift - 14) > 120000.0
        ):
            shift -= 1
        if shift < low:
            return None
        for_value.append(shift)
    return np.tile(np.array(for_value, dtype=np.int64), solved.shape[2] // 6)


def _with_residuals(
    factors: Int64, wanted: Float64, unit: Int64, up: Int64, shift: Int64, coefficients: Int64
) -> Prediction:
    """A prediction with its residuals, whose least is added to the first coefficient."""
    levels = len(coefficients).bit_length() - 1
    first = layout.first_rows(len(factors), levels)
    moved = coefficients.copy()
    residuals = np.empty(wanted.shape, dtype=np.int64)
    decoded = np.empty(wanted.shape, dtype=np.int64)
    for block in range(len(coefficients)):
        rows = slice(first[block], first[block + 1])
        predicted = predictions(factors[rows], coefficients[block].T, shift)
        units = np.floor((wanted[rows] - predicted) / unit + 0.5).astype(np.int64)
        least = units.min(axis=0)
        moved[block, :, 0] += (least * unit) << (shift - 14)
        residuals[rows] = units - least
        decoded[rows] = predicted + units * unit
    return Prediction(levels, up, shift, moved, residuals, decoded)


def _least_squares(factors: Int64, targets: Int64) -> Float64:
    """(10, c) solution of factors / 16384 @ x = targets, by Cholesky on exact integer sums."""
    normal = (factors.T @ factors).astype(np.float64)
    right = (factors.T @ targets).astype(np.float64) * 16384.0
    diagonal = np.arange(len(normal))
    normal[diagonal, diagonal] *= 1.0 + _RIDGE
    normal[diagonal, diagonal] += 1.0
    return solve_positive(normal, right, least=1e-3)
