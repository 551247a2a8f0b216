"""One implicit step in time, second order: generalised-alpha with Newton's method.

Source: Chung and Hulbert 1993, J. Appl. Mech. 60(2), generalised-alpha; here with forces taken at the
interpolated point. It steps alone from one state to the next, so steps may differ in length.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from frogkick.der.elimination import Elimination, factor_and_solve
from frogkick.der.forces import total_force
from frogkick.der.mesh import Mesh

FloatArray = NDArray[np.float64]

SPECTRAL_RADIUS = 0.5  # damping of frequencies above the step's reach: 1 none, 0 all in one step
RESIDUAL_LIMIT = 1e-6  # largest nodal residual over Mesh.force_scale_n
MAX_ITERATIONS = 12  # quadratic convergence takes 2 to 4; more means a step too long
MAX_HALVINGS = 8


@njit(cache=True, error_model="numpy")
def limb_activation(
    time_s: float, stroke_start_s: FloatArray, table: FloatArray, table_step_s: float, activation: FloatArray
) -> None:
    """Set ``activation`` (limbs,) at a time: the largest of each limb's strokes, 0 before and after them.

    Args:
        time_s: when.
        stroke_start_s: (limbs, k) when each stroke began; NaN where there is none.
        table: activation every table_step_s since the start of a stroke.
    """
    for limb in range(stroke_start_s.shape[0]):
        largest = 0.0
        for k in range(stroke_start_s.shape[1]):
            place = (time_s - stroke_start_s[limb, k]) / table_step_s
            if place > 0.0 and place < table.shape[0] - 1:  # false for NaN
                index = int(place)
                share = place - index
                largest = max(largest, (1.0 - share) * table[index] + share * table[index + 1])
        activation[limb] = largest


@njit(cache=True, error_model="numpy")
def rest_acceleration(
    mesh: Mesh,
    plan: Elimination,
    x_m: FloatArray,
    v_mps: FloatArray,
    activation: FloatArray,
    drop_per_m: float,
) -> FloatArray:
    """Acceleration (n, 2), m/s^2, that the forces on a state cause: the integrator's start."""
    force = np.empty_like(x_m)
    total_force(mesh, plan, x_m, v_mps, activation, drop_per_m, 0.0, 0.0, force, np.empty((0, 4)))
    return force / mesh.mass_kg.reshape(-1, 1)


@njit(cache=True, error_model="numpy")
def try_step(
    mesh: Mesh,
    plan: Elimination,
    x_m: FloatArray,
    v_mps: FloatArray,
    a_mps2: FloatArray,
    activation: FloatArray,
    drop_per_m: float,
    step_s: float,
    jacobian: FloatArray,
) -> tuple[int, float]:
    """Advance a state by one step in place, or leave it as it was.

    Args:
        x_m, v_mps, a_mps2: (n, 2) positions, velocities, accelerations, world frame.
        activation: (limbs,) at the time evaluation_share() * step_s into the step.
        drop_per_m: see forces.bend_parameters.
        step_s: length of the step.
        jacobian: (blocks, 4) work space.

    Returns:
        Iterations taken (0 where it did not converge), and the last residual over the force scale.
    """
    n = x_m.shape[0]
    radius = SPECTRAL_RADIUS
    alpha_m = (2.0 * radius - 1.0) / (radius + 1.0)
    alpha_f = radius / (radius + 1.0)
    gamma = 0.5 - alpha_m + alpha_f
    beta = 0.25 * (1.0 - alpha_m + alpha_f) ** 2
    position_gain = 1.0 - alpha_f
    velocity_gain = (1.0 - alpha_f) * gamma / (beta * step_s)
    mass_gain = (1.0 - alpha_m) / (beta * step_s * step_s)
    # Unknown: the displacement over the step. Guess: the acceleration stays.
    move = step_s * v_mps + (0.5 * step_s * step_s) * a_mps2
    x_at, v_at = np.empty_like(x_m), np.empty_like(x_m)
    force = np.empty_like(x_m)
    residual = np.inf
    previous = np.inf
    for iteration in range(1, MAX_ITERATIONS + 1):
        for i in range(n):
            for d in range(2):
                x_at[i, d] = x_m[i, d] + position_gain * move[i, d]
                v_at[i, d] = (
                    velocity_gain * move[i, d]
                    + (1.0 - (1.0 - alpha_f) * gamma / beta) * v_mps[i, d]
                    + (1.0 - alpha_f) * step_s * (1.0 - 0.5 * gamma / beta) * a_mps2[i, d]
                )
        jacobian[:] = 0.0
        total_force(
            mesh, plan, x_at, v_at, activation, drop_per_m, position_gain, velocity_gain, force, jacobian
        )
        residual = 0.0
        for i in range(n):
            mass = mesh.mass_kg[i]
            jacobian[i, 0] += mass_gain * mass
            jacobian[i, 3] += mass_gain * mass
            for d in range(2):
                inertia = mass * (
                    mass_gain * (move[i, d] - step_s * v_mps[i, d])
                    + (1.0 - (1.0 - alpha_m) * 0.5 / beta) * a_mps2[i, d]
                )
                force[i, d] -= inertia
                residual = max(residual, abs(force[i, d]))
        residual /= mesh.force_scale_n
        if not np.isfinite(residual):
            return 0, residual
        if residual <= RESIDUAL_LIMIT:
            for i in range(n):
                for d in range(2):
                    new_a = (move[i, d] - step_s * v_mps[i, d]) / (beta * step_s * step_s) + (
                        1.0 - 0.5 / beta
                    ) * a_mps2[i, d]
                    x_m[i, d] += move[i, d]
                    v_mps[i, d] += step_s * ((1.0 - gamma) * a_mps2[i, d] + gamma * new_a)
                    a_mps2[i, d] = new_a
            return iteration, residual
        if iteration > 4 and residual > 10.0 * previous:
            return 0, residual
        previous = residual
        if not factor_and_solve(plan, jacobian, force):
            return 0, residual
        move += force
    return 0, residual


@njit(cache=True, error_model="numpy")
def advance(
    mesh: Mesh,
    plan: Elimination,
    x_m: FloatArray,
    v_mps: FloatArray,
    a_mps2: FloatArray,
    time_s: float,
    until_s: float,
    step_s: float,
    stroke_start_s: FloatArray,
    table: FloatArray,
    table_step_s: float,
    drop_per_m: float,
) -> tuple[float, float, int]:
    """Advance a state in place from ``time_s`` to ``until_s`` in equal steps of at most ``step_s``.

    A step that does not converge is cut in halves, up to MAX_HALVINGS times; the next one starts whole.

    Returns:
        The time reached (less than until_s where even the shortest step failed), the last residual over the
        force scale, and the Newton iterations taken.
    """
    jacobian = np.empty((plan.blocks, 4))
    activation = np.empty(stroke_start_s.shape[0])
    steps = max(1, int(np.ceil((until_s - time_s) / step_s - 1e-6)))
    full = (until_s - time_s) / steps
    alpha_f = SPECTRAL_RADIUS / (SPECTRAL_RADIUS + 1.0)
    iterations = 0
    residual = 0.0
    for index in range(steps):
        begin = time_s + index * full
        pieces = 1  # the step is cut into this many
        done = 0
        while done < pieces:
            length = full / pieces
            at = begin + (done + 1.0 - alpha_f) * length
            limb_activation(at, stroke_start_s, table, table_step_s, activation)
            used, residual = try_step(
                mesh, plan, x_m, v_mps, a_mps2, activation, drop_per_m, length, jacobian
            )
            if used > 0:
                iterations += used
                done += 1
                continue
            if pieces >= 1 << MAX_HALVINGS:
                return begin + done * length, residual, iterations
            pieces *= 2
            done *= 2
    return until_s, residual, iterations
