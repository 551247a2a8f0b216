"""Direct solution of the rods' linear systems: the order is planned once, numbers flow through it.

The Jacobian has one 2 x 2 block for each pair of nodes that share an edge or a bend. Which blocks fill in
while eliminating node after node depends on the mesh alone, so ``eliminate`` lists, once, every block
product of a factorisation; ``factor_and_solve`` walks these lists. Drag makes the Jacobian unsymmetric
(a force that turns with the rod), so this is block L D U on a symmetric pattern.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

IntArray = NDArray[np.int32]
FloatArray = NDArray[np.float64]


class Elimination(NamedTuple):
    """Static index lists. A block is 4 floats, row by row: values[block] = (xx, xy, yx, yy).

    Attributes:
        blocks: how many blocks, fill-in included; block i < n is the diagonal of node i.
        order: (n,) nodes in the order of their elimination.
        start: (n + 1,) node order[k] has the neighbours neighbour[start[k] : start[k + 1]].
        neighbour: nodes that are eliminated later than order[k] and coupled to it then.
        lower: the block (neighbour, order[k]) of each.
        upper: the block (order[k], neighbour) of each.
        target_start: (n,) where the targets of step k begin.
        target: the blocks (neighbour i, neighbour j), i major, that step k updates.
        edge_block: (e, 4) blocks (i,i), (i,j), (j,i), (j,j) of each edge.
        bend_block: (b, 9) blocks of each bend's three nodes, row by row.
    """

    blocks: int
    order: IntArray
    start: IntArray
    neighbour: IntArray
    lower: IntArray
    upper: IntArray
    target_start: IntArray
    target: IntArray
    edge_block: IntArray
    bend_block: IntArray


def eliminate(nodes: int, edge_nodes: IntArray, bend_nodes: IntArray, order: IntArray) -> Elimination:
    """Plan the elimination of all nodes in ``order``.

    Args:
        nodes: number of nodes n.
        edge_nodes: (e, 2); bend_nodes: (b, 3): what couples.
        order: (n,) a permutation of the nodes; it decides how much fills in, not what comes out.
    """
    coupled: list[set[int]] = [set() for _ in range(nodes)]
    for group in (*edge_nodes.tolist(), *bend_nodes.tolist()):
        for i in group:
            coupled[i].update(j for j in group if j != i)
    block: dict[tuple[int, int], int] = {(i, i): i for i in range(nodes)}
    for i in range(nodes):
        for j in sorted(coupled[i]):
            block.setdefault((i, j), len(block))
    place = {int(node): k for k, node in enumerate(order)}
    start: list[int] = [0]
    neighbour: list[int] = []
    lower: list[int] = []
    upper: list[int] = []
    target_start: list[int] = []
    target: list[int] = []
    for node in order.tolist():
        later = sorted(coupled[node], key=place.__getitem__)
        for i in later:
            coupled[i].discard(node)
            coupled[i].update(j for j in later if j != i)
            neighbour.append(i)
            lower.append(block[i, node])
            upper.append(block[node, i])
        target_start.append(len(target))
        target += [block.setdefault((i, j), len(block)) for i in later for j in later]
        start.append(len(neighbour))

    def of(values: list[int]) -> IntArray:
        return np.array(values, dtype=np.int32)

    return Elimination(
        blocks=len(block),
        order=of(order.tolist()),
        start=of(start),
        neighbour=of(neighbour),
        lower=of(lower),
        upper=of(upper),
        target_start=of(target_start),
        target=of(target),
        edge_block=of([block[i, j] for edge in edge_nodes.tolist() for i in edge for j in edge]).reshape(
            -1, 4
        ),
        bend_block=of([block[i, j] for bend in bend_nodes.tolist() for i in bend for j in bend]).reshape(
            -1, 9
        ),
    )


@njit(cache=True, error_model="numpy")
def factor_and_solve(plan: Elimination, values: FloatArray, right: FloatArray) -> bool:
    """Solve values * solution = right in place, without pivoting.

    Args:
        plan: index lists of this mesh.
        values: (blocks, 4) the matrix; holds its factors afterwards.
        right: (n, 2) right-hand side; holds the solution afterwards.

    Returns:
        False where a pivot is singular or not finite; ``right`` is then worthless.

    Source: George, Liu 1981, Computer Solution of Large Sparse Positive Definite Systems (symbolic and
    numeric phases apart).
    """
    n = plan.order.shape[0]
    for k in range(n):
        node = plan.order[k]
        a, b, c, d = values[node, 0], values[node, 1], values[node, 2], values[node, 3]
        determinant = a * d - b * c
        if not abs(determinant) > 1e-300 or not np.isfinite(determinant):
            return False
        inverse = 1.0 / determinant
        a, b, c, d = d * inverse, -b * inverse, -c * inverse, a * inverse
        values[node, 0], values[node, 1], values[node, 2], values[node, 3] = a, b, c, d
        rx, ry = right[node, 0], right[node, 1]
        begin = plan.start[k]
        count = plan.start[k + 1] - begin
        position = plan.target_start[k]
        for i in range(begin, begin + count):
            low = plan.lower[i]
            l0, l1, l2, l3 = values[low, 0], values[low, 1], values[low, 2], values[low, 3]
            m0, m1 = l0 * a + l1 * c, l0 * b + l1 * d
            m2, m3 = l2 * a + l3 * c, l2 * b + l3 * d
            right[plan.neighbour[i], 0] -= m0 * rx + m1 * ry
            right[plan.neighbour[i], 1] -= m2 * rx + m3 * ry
            for j in range(begin, begin + count):
                up = plan.upper[j]
                goal = plan.target[position]
                position += 1
                u0, u1, u2, u3 = values[up, 0], values[up, 1], values[up, 2], values[up, 3]
                values[goal, 0] -= m0 * u0 + m1 * u2
                values[goal, 1] -= m0 * u1 + m1 * u3
                values[goal, 2] -= m2 * u0 + m3 * u2
                values[goal, 3] -= m2 * u1 + m3 * u3
    for k in range(n - 1, -1, -1):
        node = plan.order[k]
        rx, ry = right[node, 0], right[node, 1]
        for i in range(plan.start[k], plan.start[k + 1]):
            up, other = plan.upper[i], plan.neighbour[i]
            rx -= values[up, 0] * right[other, 0] + values[up, 1] * right[other, 1]
            ry -= values[up, 2] * right[other, 0] + values[up, 3] * right[other, 1]
        right[node, 0] = values[node, 0] * rx + values[node, 1] * ry
        right[node, 1] = values[node, 2] * rx + values[node, 3] * ry
    return True
