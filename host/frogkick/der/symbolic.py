"""Symbolic factorisation of the rods' linear systems: the elimination order and the fill-in.

The matrix is symmetric and has one 2 x 2 block for each pair of nodes that share an edge or a bend. Only its
diagonal and one block of each pair are stored; the row is the node that is eliminated first. The fill-in
depends only on the mesh. The numerical factorisation is in ``frogkick.der.solve``.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from frogkick.core.arrays import Int32


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

    Source: George, Liu 1981, Computer Solution of Large Sparse Positive Definite Systems (separate symbolic
    and numeric phases).
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
