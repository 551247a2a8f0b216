"""Pose and velocity of a robot's body from its nodes; for one simulation or many side by side.

The position is the mass-weighted mean of all nodes (Huang 2022, Eqs. 10, 12), the heading the signed
mass-weighted rotation of the frame's nodes (Eq. 11 loses the sign). Masses include added mass.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from frogkick.core.arrays import Float64
from frogkick.core.compiled import INNER, cached_njit
from frogkick.core.poses import body_from_world
from frogkick.der.lanes import SimdArray, get, put
from frogkick.der.mesh import Mesh

SUMS = 10
MOTION = 8


@njit(**INNER)
def set_sums(mesh: Mesh, x_m: SimdArray, v_mps: SimdArray, row: int, sums: SimdArray) -> None:
    """Set a row of (rows, SUMS), the input of ``body_motion``.

    Centre x, y (m), its velocity (m/s), cross and dot product of the frame's arms at rest with those now, the
    frame's spin and its inertia, and the unweighted mean x, y of all nodes (m). Sums run over the nodes in
    their order, so they do not depend on the number of lanes.
    """
    zero = 0.0 * get(x_m, 0, 0)
    x, y, vx, vy, mean_x, mean_y = zero, zero, zero, zero, zero, zero
    frame_x, frame_y, frame_vx, frame_vy = zero, zero, zero, zero
    rest_x, rest_y, total, frame_total = 0.0, 0.0, 0.0, 0.0
    nodes = mesh.mass_kg.shape[0]
    for i in range(nodes):
        mass = mesh.mass_kg[i]
        total += mass
        x += mass * get(x_m, i, 0)
        y += mass * get(x_m, i, 1)
        vx += mass * get(v_mps, i, 0)
        vy += mass * get(v_mps, i, 1)
        mean_x += get(x_m, i, 0)
        mean_y += get(x_m, i, 1)
        if i < mesh.frame_nodes:  # they come first
            rest_x += mass * mesh.rest_m[i, 0]
            rest_y += mass * mesh.rest_m[i, 1]
        if i + 1 == mesh.frame_nodes:
            frame_x, frame_y, frame_vx, frame_vy, frame_total = x, y, vx, vy, total
    frame_x, frame_y = frame_x / frame_total, frame_y / frame_total
    frame_vx, frame_vy = frame_vx / frame_total, frame_vy / frame_total
    rest_x, rest_y = rest_x / frame_total, rest_y / frame_total
    cross, dot, spin, inertia = zero, zero, zero, zero
    for i in range(mesh.frame_nodes):
        mass, rx, ry = mesh.mass_kg[i], mesh.rest_m[i, 0] - rest_x, mesh.rest_m[i, 1] - rest_y
        ax, ay = get(x_m, i, 0) - frame_x, get(x_m, i, 1) - frame_y
        ux, uy = get(v_mps, i, 0) - frame_vx, get(v_mps, i, 1) - frame_vy
        cross += mass * (rx * ay - ry * ax)
        dot += mass * (rx * ax + ry * ay)
        spin += mass * (ax * uy - ay * ux)
        inertia += mass * (ax * ax + ay * ay)
    put(sums, row, 0, x / total)
    put(sums, row, 1, y / total)
    put(sums, row, 2, vx / total)
    put(sums, row, 3, vy / total)
    put(sums, row, 4, cross)
    put(sums, row, 5, dot)
    put(sums, row, 6, spin)
    put(sums, row, 7, inertia)
    put(sums, row, 8, mean_x / (1.0 * nodes))
    put(sums, row, 9, mean_y / (1.0 * nodes))


@cached_njit(error_model="numpy")
def body_motion(sums: Float64) -> Float64:
    """Return poses and velocities from rows of ``set_sums``.

    Args:
        sums: (rows, SUMS) float64 of one lane.

    Returns:
        (rows, MOTION) x, y (m), heading (rad, in (-pi, pi]), forward, left (m/s) and turn rate (rad/s) in the
        body frame, unweighted mean x, y of all nodes (m).
    """
    motion = np.empty((sums.shape[0], MOTION))
    for k in range(sums.shape[0]):
        heading = math.atan2(sums[k, 4], sums[k, 5])
        c, s = math.cos(heading), math.sin(heading)
        motion[k, 0], motion[k, 1], motion[k, 2] = sums[k, 0], sums[k, 1], heading
        motion[k, 3] = c * sums[k, 2] + s * sums[k, 3]
        motion[k, 4] = c * sums[k, 3] - s * sums[k, 2]
        motion[k, 5] = sums[k, 6] / sums[k, 7]
        motion[k, 6], motion[k, 7] = sums[k, 8], sums[k, 9]
    return motion


def place_nodes(mesh: Mesh, heading_rad: Float64, velocity_body: Float64) -> tuple[Float64, Float64]:
    """Return positions about the centre and velocities, (n, 2, k) each, world frame, of rigidly moving
    robots.

    Args:
        mesh: of the robots.
        heading_rad: (k,).
        velocity_body: (k, 3) forward, left (m/s), turn rate (rad/s).
    """
    c = np.array([math.cos(h) for h in heading_rad.tolist()])
    s = np.array([math.sin(h) for h in heading_rad.tolist()])
    rest_x, rest_y = mesh.rest_m[:, 0, None], mesh.rest_m[:, 1, None]
    forward, left, omega = velocity_body.T
    x = np.stack([c * rest_x - s * rest_y, s * rest_x + c * rest_y], axis=1)
    v = np.stack([c * forward - s * left - omega * x[:, 1], s * forward + c * left + omega * x[:, 0]], axis=1)
    return x, v


def cubic(
    p: Float64, q: Float64, v: Float64, w: Float64, length_s: Float64, share: Float64
) -> tuple[Float64, Float64]:
    """Return value and slope of the cubic Hermite interpolant from p with slope v to q with slope w.

    Args:
        p, q: (k, d) values at both ends; v, w: (k, d) slopes there, per second.
        length_s: (k, 1) time between the ends; share: (k, 1) place in between, 0 to 1.
    """
    bend = 3.0 * (q - p) - length_s * (2.0 * v + w)
    twist = length_s * (v + w) - 2.0 * (q - p)
    value = p + share * (length_s * v + share * (bend + share * twist))
    return value, v + share * (2.0 * bend + share * (3.0 * twist)) / length_s


def interpolate(ends_s: Float64, rows: Float64, time_s: Float64) -> tuple[Float64, Float64]:
    """Interpolate poses and body velocities between the ends of steps (cubic Hermite).

    Args:
        ends_s: (k,) increasing times.
        rows: (k, MOTION) of ``body_motion`` at these.
        time_s: (s,) times within.

    Returns:
        (s, 3) poses, heading continuous, and (s, 3) velocities, body frame. At the end of a step they are
            exactly those of its row.
    """
    pose = rows[:, :3].copy()
    pose[:, 2] = np.unwrap(pose[:, 2])
    rate = body_from_world(-pose[:, 2], rows[:, 3:6])
    left = np.clip(np.searchsorted(ends_s, time_s, side="right") - 1, 0, len(ends_s) - 2)
    length = (ends_s[left + 1] - ends_s[left])[:, None]
    u = (time_s[:, None] - ends_s[left, None]) / length
    at, slope = cubic(pose[left], pose[left + 1], rate[left], rate[left + 1], length, u)
    velocity = body_from_world(at[:, 2], slope)
    for end, row in ((u[:, 0] == 0.0, left), (u[:, 0] == 1.0, left + 1)):
        at[end], velocity[end] = pose[row[end]], rows[row[end], 3:6]
    return at, velocity
