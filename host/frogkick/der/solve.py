"""Block factorisation L D L^T of the rods' linear systems, symbolic and numeric, and their solution.

The matrix is symmetric and has one 2 x 2 block for each pair of nodes that share an edge or a bend. Only its
diagonal and one block of each pair are stored, row by row; the row is the node that is eliminated first. The
fill-in depends only on the mesh. The numeric functions work on one simulation or on many side by side: arrays
have the elements of ``frogkick.der.lanes``.

Source: George, Liu 1981, Computer Solution of Large Sparse Positive Definite Systems (separate symbolic and
numeric phases).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numba import njit

from frogkick.core.arrays import Int32
from frogkick.core.compiled import BARE
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
        bend_pair=of([[found(i, j) for i, j in sides] for sides in bend_sides]).reshape(-1, 3),
        bend_flip=of([[(i, j) not in pair for i, j in sides] for sides in bend_sides]).reshape(-1, 3),
        widest=max((len(others) for others in later), default=0),
    )


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
