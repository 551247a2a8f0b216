"""Types of arrays, for annotations; products and solutions of linear systems that do not ask BLAS.

``a @ b`` and ``numpy.linalg`` call BLAS, which has other instructions for each kind of processor and so other
last bits. What decides the bytes of a library or a table uses the functions here. Their bits are the same on
x86-64 processors (``tests/der/test_machine.py``); other kinds of processor were not tried.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

AnyArray = npt.NDArray[Any]
Bool = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int16 = npt.NDArray[np.int16]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
UInt8 = npt.NDArray[np.uint8]
UInt16 = npt.NDArray[np.uint16]


def matmul(a: Float64, b: Float64) -> Float64:
    """Matrix product of (..., i, j) and (..., j, k), without BLAS."""
    return np.asarray(np.einsum("...ij,...jk->...ik", a, b))


def dot(a: Float64, b: Float64) -> float:
    """Scalar product of two vectors, without BLAS."""
    return float(np.einsum("i,i->", a, b))


def solve_positive(matrix: Float64, right: Float64, least: float = 1e-300) -> Float64:
    """Solution of linear systems by Cholesky's method, without BLAS.

    Args:
        matrix: (..., n, n) symmetric, positive definite.
        right: (..., n, c) right sides.
        least: lower bound of the squared pivots. The default only keeps roots real: a matrix that may be
            singular needs a ridge on its diagonal.

    Returns:
        (..., n, c).

    Source: Golub and Van Loan 2013, Matrix Computations, 4.2.
    """
    size = matrix.shape[-1]
    lower, found = np.zeros_like(matrix), right.copy()
    for i in range(size):
        for j in range(i + 1):
            rest = matrix[..., i, j].copy()
            for k in range(j):
                rest -= lower[..., i, k] * lower[..., j, k]
            lower[..., i, j] = np.sqrt(np.maximum(rest, least)) if i == j else rest / lower[..., j, j]
    for i in range(size):
        for k in range(i):
            found[..., i, :] -= lower[..., i, k, None] * found[..., k, :]
        found[..., i, :] /= lower[..., i, i, None]
    for i in reversed(range(size)):
        for k in range(i + 1, size):
            found[..., i, :] -= lower[..., k, i, None] * found[..., k, :]
        found[..., i, :] /= lower[..., i, i, None]
    return found
