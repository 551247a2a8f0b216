"""Rods for analytic checks, and their forces and matrices as plain arrays."""

from __future__ import annotations

import numpy as np

from frogkick.der.lanes import lane_floats, lane_zeros
from frogkick.der.mesh import Mesh, build_mesh
from frogkick.der.rods import add_forces, add_stiffness, edges_of
from frogkick.der.solve import SymbolicFactorisation, factorise_symbolically
from frogkick.robot import Actuation, load_robot

ROBOT = load_robot("frog2022")
STILL = Actuation(1.0, 0.5, 0.0, np.array([0.0, 1.0, 0.0]))
"""A stroke that does nothing, for rods without limbs."""


def straight_rod(
    nodes: int,
    length_m: float,
    *,
    mass_per_length: float = 1.0,
    bending_n_m2: float = 1e-3,
    stretching_n: float = 1e4,
    drag_normal: float = 0.0,
    natural_per_m: float = 0.0,
) -> tuple[Mesh, SymbolicFactorisation]:
    """A free rod along x about the origin; drag_normal in N / (m/s)^2 per metre across it."""
    dl = length_m / (nodes - 1)
    x = np.linspace(-0.5 * length_m, 0.5 * length_m, nodes)
    edges = np.column_stack([np.arange(nodes - 1), np.arange(1, nodes)]).astype(np.int32)
    bends = np.column_stack([np.arange(k, nodes - 2 + k) for k in range(3)]).astype(np.int32)
    e, b = len(edges), len(bends)
    mass = np.full(nodes, mass_per_length * dl)
    mass[[0, -1]] *= 0.5
    mesh, _ = build_mesh(ROBOT)
    mesh = mesh._replace(
        frame_nodes=nodes,
        rest_m=np.column_stack([x, np.zeros(nodes)]),
        mass_kg=mass,
        edge_nodes=edges,
        edge_length_m=np.full(e, dl),
        edge_inverse_per_m=np.full(e, 1.0 / dl),
        edge_stiffness_n=np.full(e, stretching_n),
        edge_drag_normal=np.full(e, 0.5 * drag_normal * dl),
        edge_drag_tangential=np.zeros(e),
        bend_nodes=bends,
        bend_edges=np.column_stack([np.arange(b), np.arange(1, b + 1)]).astype(np.int32),
        bend_sense=np.ones(b),
        bend_length_m=np.full(b, dl),
        bend_stiffness_n_m2=np.full(b, bending_n_m2),
        bend_active_gain=np.zeros(b),
        bend_natural_per_m=np.full(b, natural_per_m),
        bend_curl=np.zeros(b),
        bend_column=np.zeros(b, dtype=np.int32),
        force_scale_n=bending_n_m2 / length_m**2,
    )
    return mesh, factorise_symbolically(nodes, edges, bends, list(range(nodes)))


def numbers(values: np.ndarray, width: int = 1) -> np.ndarray:
    """Values (.., W) or, for width 1, (..) as lane numbers."""
    wide = values[..., None] if width == 1 else values
    array = lane_zeros(wide.shape[:-1], width)
    lane_floats(array)[...] = wide
    return array


def forces(mesh: Mesh, x: np.ndarray, v: np.ndarray, activation: np.ndarray, drop_per_m: float) -> np.ndarray:
    """(n, 2) sum of all forces on one state."""
    force, _ = forces_and_edges(mesh, x, v, activation, drop_per_m)
    return force


def forces_and_edges(mesh: Mesh, x: np.ndarray, v: np.ndarray, activation: np.ndarray, drop_per_m: float):
    edges = edges_of(mesh, 1)
    active = np.zeros((1, 2 * len(activation) + 2))
    active[0, :-2:2], active[0, 1:-2:2] = activation, drop_per_m * activation
    force = lane_zeros((len(x), 2), 1)
    add_forces(mesh, edges, numbers(x), numbers(v), active, 0, lane_zeros((0, 1), 1), force)
    return np.array(force), edges


def stiffness(
    mesh: Mesh,
    symbolic: SymbolicFactorisation,
    x,
    v,
    activation,
    drop_per_m: float,
    position_gain: float,
    velocity_gain: float,
) -> np.ndarray:
    """Minus the derivative of the forces as one dense (2n, 2n) matrix, as the solver sees it."""
    _, edges = forces_and_edges(mesh, x, v, activation, drop_per_m)
    diagonal, pair = lane_zeros((len(x), 3), 1), lane_zeros((len(symbolic.neighbour), 4), 1)
    still = lane_zeros((0, 1), 1)
    add_stiffness(
        mesh, symbolic, edges, numbers(x), numbers(v), still, position_gain, velocity_gain, diagonal, pair
    )
    return dense(symbolic, diagonal, pair)


def dense(
    symbolic: SymbolicFactorisation, diagonal: np.ndarray, pair: np.ndarray, lower: np.ndarray | None = None
) -> np.ndarray:
    """A matrix of the solver, before it is factored, as one array; with ``lower`` as ``factor_mixed`` has
    it."""
    n = len(diagonal)
    full = np.zeros((2 * n, 2 * n))
    for i, (xx, xy, yy, *skew) in enumerate(diagonal):
        full[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[xx, xy], [xy + sum(skew), yy]]
    for k, node in enumerate(symbolic.order):
        for p in range(symbolic.start[k], symbolic.start[k + 1]):
            other, block = symbolic.neighbour[p], pair[p].reshape(2, 2)
            full[2 * node : 2 * node + 2, 2 * other : 2 * other + 2] = block
            below = lower[p].reshape(2, 2) if lower is not None and p < len(lower) else block.T
            full[2 * other : 2 * other + 2, 2 * node : 2 * node + 2] = below
    return full


def central(function, at: np.ndarray, step: float) -> np.ndarray:
    """Derivative by central differences: columns are inputs."""
    columns = []
    for i in range(at.size):
        d = np.zeros(at.size)
        d[i] = step
        d = d.reshape(at.shape)
        columns.append((np.asarray(function(at + d)) - np.asarray(function(at - d))).ravel() / (2 * step))
    return np.array(columns).T
