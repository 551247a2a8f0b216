"""Coding of a table's values: residuals in a bit stream, and predictions."""

from __future__ import annotations

import numpy as np

from frogkick.core.arrays import Int16, Int64

ONE = 16384
"""Denominator of a state's codes in a prediction."""


def bits_for(largest: Int64) -> Int64:
    """Number of bits for 0 up to each number."""
    return np.array([int(value).bit_length() for value in largest.ravel()], dtype=np.int64).reshape(
        largest.shape
    )


def put_residuals(residuals: Int64, bits: Int64) -> bytes:
    """Write rows of unsigned numbers as bits, the least significant first.

    Args:
        residuals: (n, c) below 2**bits.
        bits: (c,) 0 to 16 each.

    Returns:
        n rows of ceil(sum(bits) / 8) bytes.
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
    """Predicted values of a block, without residuals.

    Args:
        factors: (n, 10) of products().
        coefficients: (10, c).
        shift: (c,).

    Returns:
        (n, c) codes.
    """
    return np.asarray((factors @ coefficients) >> shift, dtype=np.int64)
