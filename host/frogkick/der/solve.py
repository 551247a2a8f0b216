"""Numeric block factorisation L D L^T of the rods' linear systems, and their solution.

The functions work on one simulation or on many side by side: arrays have the elements of
``frogkick.der.lanes``. The four components of a 2 x 2 block are stored row by row.

Source: George, Liu 1981, Computer Solution of Large Sparse Positive Definite Systems.
"""

from __future__ import annotations

from numba import njit

from frogkick.core.compiled import BARE
from frogkick.der.lanes import SimdArray, add, get, put
from frogkick.der.symbolic import SymbolicFactorisation


@njit(**BARE)
def factor(symbolic: SymbolicFactorisation, diagonal: SimdArray, pair: SimdArray, scaled: SimdArray) -> None:
    """Factor a matrix in place into L D L^T, without pivoting.

    A singular pivot gives non-finite values, which the caller finds in the solution.

    Args:
        symbolic: index lists of the mesh.
        diagonal: (n, 3) xx, xy, yy of each node's block; replaced by the inverse of its pivot.
        pair: (pairs, 4) block of each pair; replaced by the inverse pivot of its first node times the block.
        scaled: (symbolic.widest, 4) work space.
    """
    for k in range(symbolic.order.shape[0]):
        node = symbolic.order[k]
        xx, xy, yy = get(diagonal, node, 0), get(diagonal, node, 1), get(diagonal, node, 2)
        inverse = 1.0 / (xx * yy - xy * xy)
        xx, xy, yy = yy * inverse, -(xy * inverse), xx * inverse
        put(diagonal, node, 0, xx)
        put(diagonal, node, 1, xy)
        put(diagonal, node, 2, yy)
        begin, end = symbolic.start[k], symbolic.start[k + 1]
        for i in range(begin, end):
            u0, u1, u2, u3 = get(pair, i, 0), get(pair, i, 1), get(pair, i, 2), get(pair, i, 3)
            put(scaled, i - begin, 0, xx * u0 + xy * u2)
            put(scaled, i - begin, 1, xx * u1 + xy * u3)
            put(scaled, i - begin, 2, xy * u0 + yy * u2)
            put(scaled, i - begin, 3, xy * u1 + yy * u3)
        position = symbolic.target_start[k]
        for i in range(begin, end):
            u0, u1, u2, u3 = get(pair, i, 0), get(pair, i, 1), get(pair, i, 2), get(pair, i, 3)
            w0, w1 = get(scaled, i - begin, 0), get(scaled, i - begin, 1)
            w2, w3 = get(scaled, i - begin, 2), get(scaled, i - begin, 3)
            other = symbolic.neighbour[i]
            add(diagonal, other, 0, -(u0 * w0 + u2 * w2))
            add(diagonal, other, 1, -(u0 * w1 + u2 * w3))
            add(diagonal, other, 2, -(u1 * w1 + u3 * w3))
            for j in range(i + 1 - begin, end - begin):
                goal = symbolic.target[position]
                position += 1
                w0, w1, w2, w3 = get(scaled, j, 0), get(scaled, j, 1), get(scaled, j, 2), get(scaled, j, 3)
                add(pair, goal, 0, -(u0 * w0 + u2 * w2))
                add(pair, goal, 1, -(u0 * w1 + u2 * w3))
                add(pair, goal, 2, -(u1 * w0 + u3 * w2))
                add(pair, goal, 3, -(u1 * w1 + u3 * w3))
        for i in range(begin, end):
            put(pair, i, 0, get(scaled, i - begin, 0))
            put(pair, i, 1, get(scaled, i - begin, 1))
            put(pair, i, 2, get(scaled, i - begin, 2))
            put(pair, i, 3, get(scaled, i - begin, 3))


@njit(**BARE)
def solve(symbolic: SymbolicFactorisation, diagonal: SimdArray, pair: SimdArray, right: SimdArray) -> None:
    """Solve a factored system in place.

    Args:
        symbolic, diagonal, pair: results of ``factor``.
        right: (n, 2) right-hand side; replaced by the solution.
    """
    n = symbolic.order.shape[0]
    for k in range(n):
        node = symbolic.order[k]
        rx, ry = get(right, node, 0), get(right, node, 1)
        for i in range(symbolic.start[k], symbolic.start[k + 1]):
            other = symbolic.neighbour[i]
            add(right, other, 0, -(get(pair, i, 0) * rx + get(pair, i, 2) * ry))
            add(right, other, 1, -(get(pair, i, 1) * rx + get(pair, i, 3) * ry))
    for k in range(n - 1, -1, -1):
        node = symbolic.order[k]
        rx, ry = get(right, node, 0), get(right, node, 1)
        xy = get(diagonal, node, 1)
        sx, sy = get(diagonal, node, 0) * rx + xy * ry, xy * rx + get(diagonal, node, 2) * ry
        for i in range(symbolic.start[k], symbolic.start[k + 1]):
            ox, oy = get(right, symbolic.neighbour[i], 0), get(right, symbolic.neighbour[i], 1)
            sx = sx - (get(pair, i, 0) * ox + get(pair, i, 1) * oy)
            sy = sy - (get(pair, i, 2) * ox + get(pair, i, 3) * oy)
        put(right, node, 0, sx)
        put(right, node, 1, sy)
