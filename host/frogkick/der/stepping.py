"""Implicit time steps, for one simulation or for many in SIMD lanes: generalised-alpha or backward Euler.

Each step factorises its matrix once and then corrects with that factor (a chord or modified Newton method):
after the first correction each further one reduces the residual a thousandfold, at a quarter of the cost of a
new factor. A lane stops correcting as soon as it has converged, and a lane that fails keeps its state before
the step, so no lane affects the others.

Generalised-alpha is of second order and is the default. Backward Euler is of first order and damps every
oscillation that a step does not resolve; the published simulations were made with it.

Source: Chung and Hulbert 1993, J. Appl. Mech. 60(2), generalised-alpha; here with forces evaluated at the
interpolated point. Both are one-step methods, so steps may differ in length.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from frogkick.core.compiled import INNER
from frogkick.der.body import set_sums
from frogkick.der.lanes import SimdArray, add, any_above, get, lane_zeros, put, sqrt, where_above
from frogkick.der.mesh import Mesh
from frogkick.der.plates import add_plate_forces, add_plate_masses, add_plate_stiffness
from frogkick.der.rods import Edges, add_forces, add_stiffness, edges_of
from frogkick.der.solve import (
    SymbolicFactorisation,
    factor,
    factor_mixed,
    solve,
    solve_mixed,
    unsymmetric_steps,
)

SPECTRAL_RADIUS = 0.9  # damping of frequencies above the step's reach: 1 none, 0 all in one step
ALPHA_M = (2.0 * SPECTRAL_RADIUS - 1.0) / (SPECTRAL_RADIUS + 1.0)
ALPHA_F = SPECTRAL_RADIUS / (SPECTRAL_RADIUS + 1.0)
GAMMA = 0.5 - ALPHA_M + ALPHA_F
BETA = 0.25 * (1.0 - ALPHA_M + ALPHA_F) ** 2


class Scheme(NamedTuple):
    """Coefficients of an implicit one-step method.

    Over a step of length h a node moves by d, from velocity v and acceleration a. Forces are evaluated after
    a share of d, at the velocity ``velocity_of_move * d / h + velocity_kept * v + velocity_of_acceleration *
    h a``. They balance the mass times ``mass_of_move * (d - h v) / h^2 + acceleration_balanced * a``.
    The next acceleration is a' = (d - h v) / (beta h^2) + acceleration_kept * a, and the next velocity
    v + h ((1 - gamma) a + gamma a').
    """

    share: float
    velocity_of_move: float
    velocity_kept: float
    velocity_of_acceleration: float
    mass_of_move: float
    acceleration_balanced: float
    beta: float
    acceleration_kept: float
    gamma: float


_SHARE = 1.0 - ALPHA_F
SCHEMES = {
    "generalised-alpha": Scheme(
        share=_SHARE,
        velocity_of_move=_SHARE * GAMMA / BETA,
        velocity_kept=1.0 - _SHARE * GAMMA / BETA,
        velocity_of_acceleration=_SHARE * (1.0 - 0.5 * GAMMA / BETA),
        mass_of_move=(1.0 - ALPHA_M) / BETA,
        acceleration_balanced=1.0 - (1.0 - ALPHA_M) * 0.5 / BETA,
        beta=BETA,
        acceleration_kept=1.0 - 0.5 / BETA,
        gamma=GAMMA,
    ),
    "backward-euler": Scheme(
        share=1.0,
        velocity_of_move=1.0,
        velocity_kept=0.0,
        velocity_of_acceleration=0.0,
        mass_of_move=1.0,
        acceleration_balanced=0.0,
        beta=1.0,
        acceleration_kept=0.0,
        gamma=1.0,
    ),
}
"""By the value of a robot file's ``integrator``."""

RESIDUAL_LIMIT = 1e-6  # root of the summed squares of all nodal residuals, over Mesh.force_scale_n
MAX_ITERATIONS = 16
FACTOR_EVERY = 5  # corrections with one factor; a step that needs a sixth has moved too far from its factor


class Nodes(NamedTuple):
    """The state of the nodes, (n, 2) each, world frame."""

    x_m: SimdArray  # positions
    v_mps: SimdArray  # velocities
    a_mps2: SimdArray  # accelerations


class Workspace(NamedTuple):
    """Work space of ``run_steps``; its content is not used after a call."""

    edges: Edges
    steps: int  # rows of the matrix that plates make unsymmetric
    x_m: SimdArray
    v_mps: SimdArray
    v_start: SimdArray
    force_start: SimdArray
    a_start: SimdArray
    move_m: SimdArray
    force_n: SimdArray
    diagonal: SimdArray
    pair: SimdArray
    scaled: SimdArray
    lower: SimdArray


def workspace_of(mesh: Mesh, symbolic: SymbolicFactorisation, width: int) -> Workspace:
    """Return work space for ``width`` lanes."""
    n, steps = len(mesh.mass_kg), unsymmetric_steps(symbolic, mesh.plate_edges)
    nodal = [lane_zeros((n, 2), width) for _ in range(7)]
    blocks = [
        lane_zeros(shape, width)
        for shape in (
            (n, 4 if steps else 3),
            (len(symbolic.neighbour), 4),
            (symbolic.widest, 4),
            (int(symbolic.start[steps]), 4),
        )
    ]
    return Workspace(edges_of(mesh, width), steps, *nodal, *blocks)


@njit(**INNER)
def set_accelerations(mesh: Mesh, work: Workspace, nodes: Nodes, active: SimdArray, water: SimdArray) -> None:
    """Set the accelerations from the forces at a state: the start of the integrator.

    Args:
        active: (1, 2 * (limbs + 1)), see ``frogkick.der.rods.add_forces``, also for ``water``.
    """
    x_m, v_mps, a_mps2 = nodes
    plates = mesh.plate_edges.shape[0] > 0
    for i in range(mesh.mass_kg.shape[0]):
        for d in range(2):
            put(a_mps2, i, d, 0.0)
    add_forces(mesh, work.edges, x_m, v_mps, active, np.int64(0), water, a_mps2)
    if plates:
        for i in range(mesh.mass_kg.shape[0]):
            for d in range(2):
                put(work.move_m, i, d, 0.0)
                put(work.a_start, i, d, 0.0)
            put(work.diagonal, i, 0, mesh.mass_kg[i])
            put(work.diagonal, i, 1, 0.0)
            put(work.diagonal, i, 2, mesh.mass_kg[i])
        add_plate_forces(mesh, work.edges, x_m, v_mps, water, work.move_m, work.a_start, 0.0, a_mps2)
        add_plate_masses(mesh, work.edges, work.diagonal)
    for i in range(mesh.mass_kg.shape[0]):
        if plates:
            xx, xy, yy = (get(work.diagonal, i, 0), get(work.diagonal, i, 1), get(work.diagonal, i, 2))
            fx, fy = get(a_mps2, i, 0), get(a_mps2, i, 1)
            whole = xx * yy - xy * xy
            put(a_mps2, i, 0, (yy * fx - xy * fy) / whole)
            put(a_mps2, i, 1, (xx * fy - xy * fx) / whole)
        else:
            for d in range(2):
                put(a_mps2, i, d, get(a_mps2, i, d) / mesh.mass_kg[i])


@njit(**INNER)
def set_residual(
    mesh: Mesh,
    work: Workspace,
    x_m: SimdArray,
    active: SimdArray,
    step: int,
    water: SimdArray,
    share: float,
    velocity_gain: Any,
    mass_gain: Any,
) -> Any:
    """Set work.force_n to the residual after moving by work.move_m; return its sum of squares."""
    for i in range(x_m.shape[0]):
        for d in range(2):
            move = get(work.move_m, i, d)
            put(work.x_m, i, d, get(x_m, i, d) + share * move)
            put(work.v_mps, i, d, velocity_gain * move + get(work.v_start, i, d))
            put(work.force_n, i, d, get(work.force_start, i, d) - mass_gain * mesh.mass_kg[i] * move)
    add_forces(mesh, work.edges, work.x_m, work.v_mps, active, step, water, work.force_n)
    if mesh.plate_edges.shape[0] > 0:
        add_plate_forces(
            mesh, work.edges, work.x_m, work.v_mps, water, work.move_m, work.a_start, mass_gain, work.force_n
        )
    total = 0.0 * get(work.force_n, 0, 0)
    for i in range(x_m.shape[0]):
        fx, fy = get(work.force_n, i, 0), get(work.force_n, i, 1)
        total += fx * fx + fy * fy
    return total


@njit(**INNER)
def set_factor(
    mesh: Mesh,
    symbolic: SymbolicFactorisation,
    work: Workspace,
    water: SimdArray,
    share: float,
    velocity_gain: Any,
    mass_gain: Any,
) -> None:
    """Factor the derivative of ``set_residual`` at the state of its last call."""
    for i in range(mesh.mass_kg.shape[0]):
        inertia = mass_gain * mesh.mass_kg[i]
        put(work.diagonal, i, 0, inertia)
        put(work.diagonal, i, 1, 0.0)
        put(work.diagonal, i, 2, inertia)
        if work.diagonal.shape[1] > 3:
            put(work.diagonal, i, 3, 0.0)
    for p in range(symbolic.neighbour.shape[0]):
        for c in range(4):
            put(work.pair, p, c, 0.0)
    add_stiffness(
        mesh,
        symbolic,
        work.edges,
        work.x_m,
        work.v_mps,
        water,
        share,
        velocity_gain,
        work.diagonal,
        work.pair,
    )
    if mesh.plate_edges.shape[0] > 0:
        for p in range(work.lower.shape[0]):
            for c in range(4):
                put(work.lower, p, c, get(work.pair, p, (c >> 1) + 2 * (c & 1)))
        add_plate_stiffness(
            mesh,
            symbolic,
            work.edges,
            work.x_m,
            work.v_mps,
            water,
            work.move_m,
            work.a_start,
            share,
            velocity_gain,
            mass_gain,
            work.diagonal,
            work.pair,
            work.lower,
        )
        factor_mixed(symbolic, work.steps, work.diagonal, work.pair, work.lower, work.scaled)
    else:
        factor(symbolic, work.diagonal, work.pair, work.scaled)


@njit(**INNER)
def run_steps(
    mesh: Mesh,
    symbolic: SymbolicFactorisation,
    work: Workspace,
    scheme: Scheme,
    nodes: Nodes,
    step_s: SimdArray,
    active: SimdArray,
    water: SimdArray,
    factor_every: int,
    report: SimdArray,
    sums: SimdArray,
) -> int:
    """Advance states in place by a row of steps.

    Args:
        mesh, symbolic, work: mesh, index lists and work space.
        scheme: one of ``SCHEMES``.
        nodes: the states, changed.
        step_s: (steps, 1) lengths; a lane does not move in a step that is not positive.
        active: (steps, 2 * (limbs + 1)), at ``scheme.share`` of each step; see frogkick.der.rods.add_forces.
        water: (WATER, 1) or (0, 1), constant over the steps; see there.
        factor_every: corrections with one factor: FACTOR_EVERY, or 1 (Newton's method) for a difficult step.
        report: (3, 1), written: row 0 the first step in which the lane failed, or -1; such a lane keeps its
            state before that step. Row 1 the residual of that step over the force scale. Row 2 the number of
            corrections.
        sums: (steps, frogkick.der.body.SUMS), written after each step; no rows if they are not wanted.

    Returns:
        Number of force evaluations of the slowest lane.
    """
    x_m, v_mps, a_mps2 = nodes
    n = x_m.shape[0]
    limit = (RESIDUAL_LIMIT * mesh.force_scale_n) ** 2
    evaluations = 0
    alive = 0.0 * get(step_s, 0, 0) + 1.0
    for row in range(3):
        put(report, row, 0, 0.0)
    put(report, 0, 0, -1.0)
    for step in range(step_s.shape[0]):
        given = get(step_s, step, 0)
        going = where_above(given, 0.0, alive, 0.0)
        if not any_above(going, 0.5):
            continue
        h = where_above(given, 0.0, given, 1.0)
        velocity_gain = scheme.velocity_of_move / h
        mass_gain = scheme.mass_of_move / (h * h)
        for i in range(n):
            for d in range(2):
                v, a = get(v_mps, i, d), get(a_mps2, i, d)
                # Guess: the acceleration stays.
                put(work.move_m, i, d, h * v + (0.5 * (h * h)) * a)
                start = scheme.velocity_kept * v + scheme.velocity_of_acceleration * (h * a)
                put(work.v_start, i, d, start)
                inertia = mass_gain * (h * v) - scheme.acceleration_balanced * a
                put(work.a_start, i, d, inertia)
                put(work.force_start, i, d, mesh.mass_kg[i] * inertia)
        open_ = going
        for iteration in range(MAX_ITERATIONS + 1):
            total = set_residual(mesh, work, x_m, active, step, water, scheme.share, velocity_gain, mass_gain)
            evaluations += 1
            open_ = where_above(total, limit, open_, 0.0)
            if iteration == MAX_ITERATIONS or not any_above(open_, 0.5):
                break
            if iteration % factor_every == 0:
                set_factor(mesh, symbolic, work, water, scheme.share, velocity_gain, mass_gain)
            if mesh.plate_edges.shape[0] > 0:
                solve_mixed(symbolic, work.steps, work.diagonal, work.pair, work.lower, work.force_n)
            else:
                solve(symbolic, work.diagonal, work.pair, work.force_n)
            add(report, 2, 0, open_)
            for i in range(n):
                for d in range(2):
                    correction = where_above(open_, 0.5, get(work.force_n, i, d), 0.0)
                    add(work.move_m, i, d, correction)
        if any_above(open_, 0.5):
            put(report, 0, 0, where_above(open_, 0.5, 1.0 * step, get(report, 0, 0)))
            left = sqrt(total) / mesh.force_scale_n
            put(report, 1, 0, where_above(open_, 0.5, left, get(report, 1, 0)))
            alive = where_above(open_, 0.5, 0.0, alive)
        moving = going - open_
        for i in range(n):
            for d in range(2):
                move, v, a = get(work.move_m, i, d), get(v_mps, i, d), get(a_mps2, i, d)
                new = (move - h * v) / (scheme.beta * (h * h)) + scheme.acceleration_kept * a
                kept = (1.0 - scheme.gamma) * a + scheme.gamma * new
                add(x_m, i, d, where_above(moving, 0.5, move, 0.0))
                put(v_mps, i, d, where_above(moving, 0.5, v + h * kept, v))
                put(a_mps2, i, d, where_above(moving, 0.5, new, a))
        if step < sums.shape[0]:
            set_sums(mesh, x_m, v_mps, step, sums)
    return evaluations
