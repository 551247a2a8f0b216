"""Block factorisation L D L^T of the rods' linear systems, symbolic and numeric, and their solution.

The matrix is symmetric and has one 2 x 2 block for each pair of nodes that share an edge or a bend. Only its
diagonal and one block of each pair are stored, row by row; the row is the node that is eliminated first. The
fill-in depends only on the mesh. The numeric functions work on one simulation or on many side by side: arrays
have the elements of ``frogkick.der.lanes``.

Plates make the matrix unsymmetric where limbs are. ``factor_mixed`` factors the rows that are eliminated
first into L D U. Of what they leave to the other rows it takes the symmetric part.

Source: George, Liu 1981, Computer Solution of Large Sparse Positive Definite Systems (separate symbolic and
numeric phases).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from frogkick.core.arrays import Int32
from frogkick.core.compiled import BARE, INNER
from frogkick.der.lanes import SimdArray, add, get, put


class SymbolicFactorisation(NamedTuple):
    """Index lists of a symbolic factorisation.

    Pair p couples the node order[k], start[k] <= p < start[k + 1], to neighbour[p].
    """

    order: Int32  # (n,) nodes in the order of their elimination
    start: Int32  # (n + 1,) first pair of each node
    neighbour: Int32  # (pairs,) the other node of each pair, which is eliminated later; includes fill-in
    target_start: Int32  # (n,) first target of step k
    target: Int32  # for step k, for each two neighbours i before j, the pair (i, j) that it updates
    edge_pair: Int32  # (e,) the pair of each edge's two nodes
    edge_flip: Int32  # (e,) 1 if the second of them is eliminated first (its row), else 0
    bend_pair: Int32  # (b, 3) the pairs of each bend's nodes a b, a c, b c
    bend_flip: Int32  # (b, 3) 1 if the second of these nodes is eliminated first (its row), else 0
    widest: int  # largest number of neighbours of a node


def factorise_symbolically(
    nodes: int, edge_nodes: Int32, bend_nodes: Int32, order: Sequence[int]
) -> SymbolicFactorisation:
    """Return the elimination of all nodes, with fill-in.

    Args:
        nodes: number of nodes n.
        edge_nodes: (e, 2) nodes that edges couple.
        bend_nodes: (b, 3) nodes that bends couple.
        order: (n,) a permutation of the nodes; it determines the fill-in, not the solution.
    """
    coupled: list[set[int]] = [set() for _ in range(nodes)]
    for group in (*edge_nodes.tolist(), *bend_nodes.tolist()):
        for i in group:
            coupled[i].update(j for j in group if j != i)
    place = {node: k for k, node in enumerate(order)}
    later: list[list[int]] = []
    start = [0]
    pair: dict[tuple[int, int], int] = {}
    for node in order:
        others = sorted(coupled[node], key=place.__getitem__)
        for i in others:
            pair[node, i] = len(pair)
            coupled[i].discard(node)
            coupled[i].update(j for j in others if j != i)
        later.append(others)
        start.append(len(pair))
    target_start: list[int] = []
    target: list[int] = []
    for others in later:
        target_start.append(len(target))
        target += [pair[i, j] for i, j in combinations(others, 2)]

    def of(values: Sequence[object]) -> Int32:
        return np.array(values, dtype=np.int32)

    def found(i: int, j: int) -> int:
        return pair[i, j] if (i, j) in pair else pair[j, i]

    bend_sides = [list(combinations(bend, 2)) for bend in bend_nodes.tolist()]
    return SymbolicFactorisation(
        order=of(order),
        start=of(start),
        neighbour=of([i for others in later for i in others]),
        target_start=of(target_start),
        target=of(target),
        edge_pair=of([found(i, j) for i, j in edge_nodes.tolist()]),
        edge_flip=of([(i, j) not in pair for i, j in edge_nodes.tolist()]),
        bend_pair=of([[found(i, j) for i, j in sides] for sides in bend_sides]).reshape(-1, 3),
        bend_flip=of([[(i, j) not in pair for i, j in sides] for sides in bend_sides]).reshape(-1, 3),
        widest=max((len(others) for others in later), default=0),
    )


@njit(**INNER)
def put_four(array: SimdArray, row: int, a: Any, b: Any, c: Any, d: Any) -> None:
    """Set the four numbers of a row."""
    put(array, row, 0, a)
    put(array, row, 1, b)
    put(array, row, 2, c)
    put(array, row, 3, d)


@njit(**INNER)
def add_four(array: SimdArray, row: int, a: Any, b: Any, c: Any, d: Any) -> None:
    """Add to the four numbers of a row."""
    add(array, row, 0, a)
    add(array, row, 1, b)
    add(array, row, 2, c)
    add(array, row, 3, d)


@njit(**BARE)
def factor(
    symbolic: SymbolicFactorisation, diagonal: SimdArray, pair: SimdArray, scaled: SimdArray, first: int = 0
) -> None:
    """Factor a matrix in place into L D L^T, without pivoting.

    A singular pivot gives non-finite values, which the caller finds in the solution.

    Args:
        symbolic: index lists of the mesh.
        diagonal: (n, 3) xx, xy, yy of each node's block; replaced by the inverse of its pivot.
        pair: (pairs, 4) block of each pair; replaced by the inverse pivot of its first node times the block.
        scaled: (symbolic.widest, 4) work space.
        first: the elimination begins with this step.
    """
    for k in range(first, symbolic.order.shape[0]):
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
            w0, w1, w2, w3 = xx * u0 + xy * u2, xx * u1 + xy * u3, xy * u0 + yy * u2, xy * u1 + yy * u3
            put_four(scaled, i - begin, w0, w1, w2, w3)
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
                v0, v1, v2, v3 = u0 * w0 + u2 * w2, u0 * w1 + u2 * w3, u1 * w0 + u3 * w2, u1 * w1 + u3 * w3
                add_four(pair, goal, -v0, -v1, -v2, -v3)
        for i in range(begin, end):
            j = i - begin
            put_four(pair, i, get(scaled, j, 0), get(scaled, j, 1), get(scaled, j, 2), get(scaled, j, 3))


@njit(**BARE)
def solve(
    symbolic: SymbolicFactorisation, diagonal: SimdArray, pair: SimdArray, right: SimdArray, first: int = 0
) -> None:
    """Solve a factored system in place.

    Args:
        symbolic, diagonal, pair, first: results and argument of ``factor``.
        right: (n, 2) right-hand side; replaced by the solution.
    """
    n = symbolic.order.shape[0]
    for k in range(first, n):
        node = symbolic.order[k]
        rx, ry = get(right, node, 0), get(right, node, 1)
        for i in range(symbolic.start[k], symbolic.start[k + 1]):
            other = symbolic.neighbour[i]
            add(right, other, 0, -(get(pair, i, 0) * rx + get(pair, i, 2) * ry))
            add(right, other, 1, -(get(pair, i, 1) * rx + get(pair, i, 3) * ry))
    for k in range(n - 1, first - 1, -1):
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


def unsymmetric_steps(symbolic: SymbolicFactorisation, edges: Int32) -> int:
    """Return the number of elimination steps up to the last one whose row has a pair of these edges."""
    pairs = symbolic.edge_pair[edges]
    return int(np.searchsorted(symbolic.start, pairs.max(), side="right")) if len(pairs) else 0


@njit(**BARE)
def factor_mixed(
    symbolic: SymbolicFactorisation,
    steps: int,
    diagonal: SimdArray,
    pair: SimdArray,
    lower: SimdArray,
    scaled: SimdArray,
) -> None:
    """Factor a matrix in place, without pivoting: its first rows into L D U, the others as ``factor`` does.

    The antisymmetric part of what the first rows leave to the others is left out.

    Args:
        symbolic: index lists of the mesh.
        steps: number of the first rows.
        diagonal: (n, 4) xx, xy, yy, yx - xy of each node's block; replaced by the inverse of its pivot, in
            the first rows as xx, xy, yy, yx.
        pair: see ``factor``.
        lower: (symbolic.start[steps], 4) of pairs of the first rows the block in the row of the second node.
        scaled: (symbolic.widest, 4) work space.
    """
    inner = lower.shape[0]
    for k in range(steps):
        node = symbolic.order[k]
        xx, xy, yy = get(diagonal, node, 0), get(diagonal, node, 1), get(diagonal, node, 2)
        yx = xy + get(diagonal, node, 3)
        inverse = 1.0 / (xx * yy - xy * yx)
        xx, xy, yy, yx = yy * inverse, -(xy * inverse), xx * inverse, -(yx * inverse)
        put_four(diagonal, node, xx, xy, yy, yx)
        begin, end = symbolic.start[k], symbolic.start[k + 1]
        for i in range(begin, end):
            u0, u1, u2, u3 = get(pair, i, 0), get(pair, i, 1), get(pair, i, 2), get(pair, i, 3)
            w0, w1, w2, w3 = xx * u0 + xy * u2, xx * u1 + xy * u3, yx * u0 + yy * u2, yx * u1 + yy * u3
            put_four(pair, i, w0, w1, w2, w3)
        position = symbolic.target_start[k]
        for i in range(begin, end):
            a0, a1, a2, a3 = get(lower, i, 0), get(lower, i, 1), get(lower, i, 2), get(lower, i, 3)
            w0, w1, w2, w3 = get(pair, i, 0), get(pair, i, 1), get(pair, i, 2), get(pair, i, 3)
            other = symbolic.neighbour[i]
            mixed = a0 * w1 + a1 * w3
            add_four(
                diagonal,
                other,
                -(a0 * w0 + a1 * w2),
                -mixed,
                -(a2 * w1 + a3 * w3),
                mixed - (a2 * w0 + a3 * w2),
            )
            for j in range(i + 1, end):
                goal = symbolic.target[position]
                position += 1
                u0, u1, u2, u3 = get(pair, j, 0), get(pair, j, 1), get(pair, j, 2), get(pair, j, 3)
                b0, b1, b2, b3 = get(lower, j, 0), get(lower, j, 1), get(lower, j, 2), get(lower, j, 3)
                xx, xy, yx, yy = a0 * u0 + a1 * u2, a0 * u1 + a1 * u3, a2 * u0 + a3 * u2, a2 * u1 + a3 * u3
                c0, c1, c2, c3 = b0 * w0 + b1 * w2, b0 * w1 + b1 * w3, b2 * w0 + b3 * w2, b2 * w1 + b3 * w3
                if goal < inner:
                    add_four(pair, goal, -xx, -xy, -yx, -yy)
                    add_four(lower, goal, -c0, -c1, -c2, -c3)
                else:
                    add_four(
                        pair, goal, -0.5 * (xx + c0), -0.5 * (xy + c2), -0.5 * (yx + c1), -0.5 * (yy + c3)
                    )
    for k in range(steps, symbolic.order.shape[0]):
        add(diagonal, symbolic.order[k], 1, 0.5 * get(diagonal, symbolic.order[k], 3))
    factor(symbolic, diagonal, pair, scaled, steps)


@njit(**BARE)
def solve_mixed(
    symbolic: SymbolicFactorisation,
    steps: int,
    diagonal: SimdArray,
    pair: SimdArray,
    lower: SimdArray,
    right: SimdArray,
) -> None:
    """Solve a system factored by ``factor_mixed`` in place."""
    for k in range(steps):
        node = symbolic.order[k]
        rx, ry = get(right, node, 0), get(right, node, 1)
        sx = get(diagonal, node, 0) * rx + get(diagonal, node, 1) * ry
        sy = get(diagonal, node, 3) * rx + get(diagonal, node, 2) * ry
        put(right, node, 0, sx)
        put(right, node, 1, sy)
        for i in range(symbolic.start[k], symbolic.start[k + 1]):
            other = symbolic.neighbour[i]
            add(right, other, 0, -(get(lower, i, 0) * sx + get(lower, i, 1) * sy))
            add(right, other, 1, -(get(lower, i, 2) * sx + get(lower, i, 3) * sy))
    solve(symbolic, diagonal, pair, right, steps)
    for k in range(steps - 1, -1, -1):
        node = symbolic.order[k]
        sx, sy = get(right, node, 0), get(right, node, 1)
        for i in range(symbolic.start[k], symbolic.start[k + 1]):
            ox, oy = get(right, symbolic.neighbour[i], 0), get(right, symbolic.neighbour[i], 1)
            sx = sx - (get(pair, i, 0) * ox + get(pair, i, 1) * oy)
            sy = sy - (get(pair, i, 2) * ox + get(pair, i, 3) * oy)
        put(right, node, 0, sx)
        put(right, node, 1, sy)
