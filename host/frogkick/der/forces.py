"""Forces on the rods and their exact derivatives: stretching, bending, drag.

Every function adds to ``force`` (n, 2), N, and, where ``jacobian`` (blocks, 4) has rows, subtracts the
force's derivative from it: the Newton matrix is mass / dt^2 - dF/dx - dF/dv / dt. ``position_gain`` and
``velocity_gain`` are d(position)/d(unknown) and d(velocity)/d(unknown) of the time integrator.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from frogkick.der.elimination import Elimination
from frogkick.der.mesh import Mesh

FloatArray = NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def stretching_energy(mesh: Mesh, x_m: FloatArray) -> float:
    """Sum of EA e^2 dl / 2 over the edges, J, with the strain e = |edge| / dl - 1."""
    energy = 0.0
    for edge in range(mesh.edge_nodes.shape[0]):
        i, j = mesh.edge_nodes[edge, 0], mesh.edge_nodes[edge, 1]
        length = np.hypot(x_m[j, 0] - x_m[i, 0], x_m[j, 1] - x_m[i, 1])
        strain = length / mesh.edge_length_m[edge] - 1.0
        energy += 0.5 * mesh.edge_stiffness_n[edge] * strain * strain * mesh.edge_length_m[edge]
    return energy


@njit(cache=True, error_model="numpy")
def add_stretching(
    mesh: Mesh,
    plan: Elimination,
    x_m: FloatArray,
    position_gain: float,
    force: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Add the stretching force of every edge: EA e along the edge (gradient of stretching_energy)."""
    for edge in range(mesh.edge_nodes.shape[0]):
        i, j = mesh.edge_nodes[edge, 0], mesh.edge_nodes[edge, 1]
        ex, ey = x_m[j, 0] - x_m[i, 0], x_m[j, 1] - x_m[i, 1]
        length = np.sqrt(ex * ex + ey * ey)
        tx, ty = ex / length, ey / length
        stiffness = mesh.edge_stiffness_n[edge]
        tension = stiffness * (length / mesh.edge_length_m[edge] - 1.0)
        force[i, 0] += tension * tx
        force[i, 1] += tension * ty
        force[j, 0] -= tension * tx
        force[j, 1] -= tension * ty
        if jacobian.shape[0] == 0:
            continue
        along = position_gain * stiffness / mesh.edge_length_m[edge]
        across = position_gain * tension / length
        xx = along * tx * tx + across * ty * ty
        xy = (along - across) * tx * ty
        yy = along * ty * ty + across * tx * tx
        for corner in range(4):
            sign = 1.0 if corner in (0, 3) else -1.0
            block = plan.edge_block[edge, corner]
            jacobian[block, 0] += sign * xx
            jacobian[block, 1] += sign * xy
            jacobian[block, 2] += sign * xy
            jacobian[block, 3] += sign * yy


@njit(cache=True, error_model="numpy")
def bend_parameters(mesh: Mesh, bend: int, activation: FloatArray, drop_per_m: float) -> tuple[float, float]:
    """EI (N m^2) and natural curvature (1/m) of a bend while its limb is active to ``activation`` (0 to 1).

    An active limb's natural curvature falls by ``drop_per_m`` in size, and its modulus rises linearly.
    """
    limb = mesh.bend_limb[bend]
    if limb < 0:
        return mesh.bend_stiffness_n_m2[bend], mesh.bend_natural_per_m[bend]
    active = activation[limb]
    natural = mesh.bend_natural_per_m[bend]
    return (
        mesh.bend_stiffness_n_m2[bend] * (1.0 + mesh.bend_active_gain[bend] * active),
        natural - np.copysign(drop_per_m * active, natural),
    )


@njit(cache=True, error_model="numpy")
def bending_energy(mesh: Mesh, x_m: FloatArray, activation: FloatArray, drop_per_m: float) -> float:
    """Sum of EI (k - k0)^2 dl / 2 over the bends, J, with k = 2 tan(phi / 2) / dl."""
    energy = 0.0
    for bend in range(mesh.bend_nodes.shape[0]):
        a, b, c = mesh.bend_nodes[bend, 0], mesh.bend_nodes[bend, 1], mesh.bend_nodes[bend, 2]
        ex, ey = x_m[b, 0] - x_m[a, 0], x_m[b, 1] - x_m[a, 1]
        fx, fy = x_m[c, 0] - x_m[b, 0], x_m[c, 1] - x_m[b, 1]
        dl = mesh.bend_length_m[bend]
        curvature = 2.0 * np.tan(0.5 * np.arctan2(ex * fy - ey * fx, ex * fx + ey * fy)) / dl
        stiffness, natural = bend_parameters(mesh, bend, activation, drop_per_m)
        energy += 0.5 * stiffness * (curvature - natural) ** 2 * dl
    return energy


@njit(cache=True, error_model="numpy")
def add_bending(
    mesh: Mesh,
    plan: Elimination,
    x_m: FloatArray,
    activation: FloatArray,
    drop_per_m: float,
    position_gain: float,
    force: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Add the bending force of every bend (gradient of bending_energy), without trigonometry.

    phi is the angle of edge f minus that of edge e; d(angle of e)/de = (-e_y, e_x) / |e|^2.
    Source: Bergou 2008, discrete elastic rods, in the plane.
    """
    gx, gy = np.empty(3), np.empty(3)
    for bend in range(mesh.bend_nodes.shape[0]):
        a, b, c = mesh.bend_nodes[bend, 0], mesh.bend_nodes[bend, 1], mesh.bend_nodes[bend, 2]
        ex, ey = x_m[b, 0] - x_m[a, 0], x_m[b, 1] - x_m[a, 1]
        fx, fy = x_m[c, 0] - x_m[b, 0], x_m[c, 1] - x_m[b, 1]
        ee, ff = ex * ex + ey * ey, fx * fx + fy * fy
        half_tangent = (ex * fy - ey * fx) / (np.sqrt(ee * ff) + ex * fx + ey * fy)
        dl = mesh.bend_length_m[bend]
        stiffness, natural = bend_parameters(mesh, bend, activation, drop_per_m)
        curvature = 2.0 * half_tangent / dl
        slope = (1.0 + half_tangent * half_tangent) / dl  # dk / dphi
        moment = stiffness * (curvature - natural) * dl * slope  # dE / dphi
        ux, uy = -ey / ee, ex / ee
        wx, wy = -fy / ff, fx / ff
        gx[0], gy[0] = ux, uy  # dphi / d(node), from angle of f minus angle of e
        gx[1], gy[1] = -ux - wx, -uy - wy
        gx[2], gy[2] = wx, wy
        for p in range(3):
            node = mesh.bend_nodes[bend, p]
            force[node, 0] -= moment * gx[p]
            force[node, 1] -= moment * gy[p]
        if jacobian.shape[0] == 0:
            continue
        # d2E/dphi2, and the second derivatives of the two edge angles
        twice = stiffness * dl * (slope * slope + (curvature - natural) * half_tangent * slope)
        twice *= position_gain
        moment *= position_gain
        e_xx, e_xy = moment * 2.0 * ex * ey / (ee * ee), moment * (ey * ey - ex * ex) / (ee * ee)
        f_xx, f_xy = moment * 2.0 * fx * fy / (ff * ff), moment * (fy * fy - fx * fx) / (ff * ff)
        for p in range(3):
            for q in range(3):
                block = plan.bend_block[bend, 3 * p + q]
                xx = twice * gx[p] * gx[q]
                xy = twice * gx[p] * gy[q]
                yx = twice * gy[p] * gx[q]
                yy = twice * gy[p] * gy[q]
                if p < 2 and q < 2:  # minus the angle of e = b - a
                    sign = -1.0 if p == q else 1.0
                    xx += sign * e_xx
                    xy += sign * e_xy
                    yx += sign * e_xy
                    yy -= sign * e_xx
                if p > 0 and q > 0:  # plus the angle of f = c - b
                    sign = 1.0 if p == q else -1.0
                    xx += sign * f_xx
                    xy += sign * f_xy
                    yx += sign * f_xy
                    yy -= sign * f_xx
                jacobian[block, 0] += xx
                jacobian[block, 1] += xy
                jacobian[block, 2] += yx
                jacobian[block, 3] += yy


@njit(cache=True, error_model="numpy")
def add_drag(
    mesh: Mesh,
    plan: Elimination,
    x_m: FloatArray,
    v_mps: FloatArray,
    position_gain: float,
    velocity_gain: float,
    force: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Add the water's drag: -1/2 rho D dl C |v| v along and across each edge, half of dl at each end.

    Taking the direction from edges, not nodes, needs no rule for a corner where three edges meet.
    Source: Huang 2022, the drag law; C_n = 1 (limbs) or 0.8 (body), C_t = C_n / 100.
    """
    for edge in range(mesh.edge_nodes.shape[0]):
        i, j = mesh.edge_nodes[edge, 0], mesh.edge_nodes[edge, 1]
        ex, ey = x_m[j, 0] - x_m[i, 0], x_m[j, 1] - x_m[i, 1]
        length = np.sqrt(ex * ex + ey * ey)
        tx, ty = ex / length, ey / length
        nx, ny = -ty, tx
        cn, ct = mesh.edge_drag_normal[edge], mesh.edge_drag_tangential[edge]
        for end in range(2):
            node = mesh.edge_nodes[edge, end]
            vt = v_mps[node, 0] * tx + v_mps[node, 1] * ty
            vn = v_mps[node, 0] * nx + v_mps[node, 1] * ny
            along, across = ct * abs(vt), cn * abs(vn)
            force[node, 0] -= along * vt * tx + across * vn * nx
            force[node, 1] -= along * vt * ty + across * vn * ny
            if jacobian.shape[0] == 0:
                continue
            # d/dv: 2 c |v| in each direction
            own = plan.edge_block[edge, 3 * end]
            dt, dn = 2.0 * velocity_gain * along, 2.0 * velocity_gain * across
            jacobian[own, 0] += dt * tx * tx + dn * nx * nx
            jacobian[own, 1] += dt * tx * ty + dn * nx * ny
            jacobian[own, 2] += dt * tx * ty + dn * nx * ny
            jacobian[own, 3] += dt * ty * ty + dn * ny * ny
            # d/dx: the edge turns by (n . d edge) / length
            turn_t = 2.0 * along * vn - across * vn
            turn_n = along * vt - 2.0 * across * vt
            scale = position_gain / length
            px, py = scale * (turn_t * tx + turn_n * nx), scale * (turn_t * ty + turn_n * ny)
            for other in range(2):
                sign = 1.0 if other == 1 else -1.0
                block = plan.edge_block[edge, 2 * end + other]
                jacobian[block, 0] += sign * px * nx
                jacobian[block, 1] += sign * px * ny
                jacobian[block, 2] += sign * py * nx
                jacobian[block, 3] += sign * py * ny


@njit(cache=True, error_model="numpy")
def total_force(
    mesh: Mesh,
    plan: Elimination,
    x_m: FloatArray,
    v_mps: FloatArray,
    activation: FloatArray,
    drop_per_m: float,
    position_gain: float,
    velocity_gain: float,
    force: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Set ``force`` to the sum of all forces, and add minus its derivative to ``jacobian`` if it has rows."""
    force[:] = 0.0
    add_stretching(mesh, plan, x_m, position_gain, force, jacobian)
    add_bending(mesh, plan, x_m, activation, drop_per_m, position_gain, force, jacobian)
    add_drag(mesh, plan, x_m, v_mps, position_gain, velocity_gain, force, jacobian)
