"""Forces of planar discrete elastic rods and their stiffness: stretching, bending, drag.

The functions work on one simulation or on many side by side. Arrays hold numbers in the sense of
``frogkick.der.lanes``: (n, 2) per node, (e, k) per edge, (b, k) per bend.
Bending depends on its two edges only, so its force and most of its stiffness are gathered on the edges.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import njit

from frogkick.core.compiled import BARE
from frogkick.der.lanes import SimdArray, absolute, add, get, lane_zeros, put, sqrt, where_above
from frogkick.der.mesh import Mesh
from frogkick.der.solve import SymbolicFactorisation
from frogkick.der.water import push, relative_velocity


class Edges(NamedTuple):
    """Values on edges and bends that ``add_forces`` computes and ``add_stiffness`` uses at the same state."""

    tangent: SimdArray  # (e, 2) unit vector along each edge
    inverse_m: SimdArray  # (e, 1) 1 / length
    pull_n: SimdArray  # (e, 2) gradient of the elastic energy by the edge's vector, N
    stiffness: SimdArray  # (e, 3) xx, xy, yy of the energy's second derivative by the edge's vector, N/m
    moment_nm: SimdArray  # (b, 1) dE / dphi of each bend, N m
    slope_nm: SimdArray  # (b, 1) d2E / dphi2, N m


def edges_of(mesh: Mesh, width: int) -> Edges:
    """Return work space for ``width`` lanes."""
    e, b = len(mesh.edge_nodes), len(mesh.bend_nodes)
    shapes = ((e, 2), (e, 1), (e, 2), (e, 3), (b, 1), (b, 1))
    return Edges(*(lane_zeros(shape, width) for shape in shapes))


@njit(**BARE)
def add_forces(
    mesh: Mesh,
    edges: Edges,
    x_m: SimdArray,
    v_mps: SimdArray,
    active: SimdArray,
    step: int,
    water: SimdArray,
    force_n: SimdArray,
) -> None:
    """Add all forces at a state to ``force_n``, and keep the values for their stiffness in ``edges``.

    Stretching has the energy EA e^2 dl / 2 with the strain e = length / dl - 1. Bending has the energy
    EI (k - k0)^2 dl / 2 with k = 2 tan(phi / 2) / dl, where phi is the turning angle from the bend's first
    edge to its second. Drag is -1/2 rho D dl C |v| v along and across each edge, half of it at each end.
    There |v| is that of the same component, or of the whole velocity (``Mesh.drag_by_speed``). Directions are
    those of edges, so a corner at which three edges meet needs no rule of its own.

    Args:
        edges: work space; written.
        x_m, v_mps: (n, 2) positions and velocities.
        active: (steps, 2 * (limbs + 1)) for each limb its activation (0 to 1), which raises EI, and the
            decrease of its natural curvature, 1/m; the last pair, zeros, is for bends of no limb.
        step: the row of ``active``.
        water: (WATER, 1), see ``frogkick.der.water``; (0, 1) in still water.
        force_n: (n, 2), added to.

    Source: Bergou, Wardetzky, Robinson, Audoly, Grinspun 2008, Discrete Elastic Rods, ACM Trans. Graph.
    27(3); Jawed, Novelia, O'Reilly 2018, A Primer on the Kinematics of Discrete Elastic Rods (turning angle
    and curvature); Huang 2022 for the energies and the drag law.
    """
    for edge in range(mesh.edge_nodes.shape[0]):
        i, j = mesh.edge_nodes[edge, 0], mesh.edge_nodes[edge, 1]
        ex, ey = get(x_m, j, 0) - get(x_m, i, 0), get(x_m, j, 1) - get(x_m, i, 1)
        length = sqrt(ex * ex + ey * ey)
        inverse = 1.0 / length
        tx, ty = ex * inverse, ey * inverse
        tension = mesh.edge_stiffness_n[edge] * (length * mesh.edge_inverse_per_m[edge] - 1.0)
        put(edges.tangent, edge, 0, tx)
        put(edges.tangent, edge, 1, ty)
        put(edges.inverse_m, edge, 0, inverse)
        put(edges.pull_n, edge, 0, tension * tx)
        put(edges.pull_n, edge, 1, tension * ty)
    for bend in range(mesh.bend_nodes.shape[0]):
        e, f = mesh.bend_edges[bend, 0], mesh.bend_edges[bend, 1]
        sense, dl = mesh.bend_sense[bend], mesh.bend_length_m[bend]
        ex, ey = get(edges.tangent, e, 0), get(edges.tangent, e, 1)
        fx, fy = get(edges.tangent, f, 0), get(edges.tangent, f, 1)
        half = sense * (ex * fy - ey * fx) / (1.0 + sense * (ex * fx + ey * fy))  # tan(phi / 2)
        limb = mesh.bend_column[bend]
        bending = mesh.bend_stiffness_n_m2[bend] * (
            1.0 + mesh.bend_active_gain[bend] * get(active, step, limb)
        )
        natural = mesh.bend_natural_per_m[bend] - mesh.bend_curl[bend] * get(active, step, limb + 1)
        excess = half * (2.0 / dl) - natural
        steep = 1.0 + half * half  # dk / dphi * dl
        moment = bending * excess * steep
        put(edges.moment_nm, bend, 0, moment)
        put(edges.slope_nm, bend, 0, bending * steep * (steep * (1.0 / dl) + excess * half))
        # dphi / de = (ey, -ex) / |e|^2, dphi / df = (-fy, fx) / |f|^2
        at_e, at_f = moment * get(edges.inverse_m, e, 0), moment * get(edges.inverse_m, f, 0)
        add(edges.pull_n, e, 0, at_e * ey)
        add(edges.pull_n, e, 1, -at_e * ex)
        add(edges.pull_n, f, 0, -at_f * fy)
        add(edges.pull_n, f, 1, at_f * fx)
    for edge in range(mesh.edge_nodes.shape[0]):
        tx, ty = get(edges.tangent, edge, 0), get(edges.tangent, edge, 1)
        cn, ct = mesh.edge_drag_normal[edge], mesh.edge_drag_tangential[edge]
        for end in range(2):
            node = mesh.edge_nodes[edge, end]
            side = 1.0 - 2.0 * end
            vx, vy = relative_velocity(water, x_m, v_mps, node)
            vt, vn = vx * tx + vy * ty, vy * tx - vx * ty
            if mesh.drag_by_speed:
                speed = sqrt(vt * vt + vn * vn)
                along, across = ct * speed * vt, cn * speed * vn
            else:
                along, across = ct * absolute(vt) * vt, cn * absolute(vn) * vn
            fx = side * get(edges.pull_n, edge, 0) - along * tx + across * ty
            fy = side * get(edges.pull_n, edge, 1) - along * ty - across * tx
            add(force_n, node, 0, fx)
            add(force_n, node, 1, fy)
    if water.shape[0] > 0:
        for i in range(mesh.mass_kg.shape[0]):
            ax, ay = push(water, x_m, i)
            add(force_n, i, 0, mesh.mass_kg[i] * ax)
            add(force_n, i, 1, mesh.mass_kg[i] * ay)


@njit(**BARE)
def add_stiffness(
    mesh: Mesh,
    symbolic: SymbolicFactorisation,
    edges: Edges,
    x_m: SimdArray,
    v_mps: SimdArray,
    water: SimdArray,
    position_gain: float,
    velocity_gain: Any,
    diagonal: SimdArray,
    pair: SimdArray,
) -> None:
    """Add the negative derivative of the forces to a symmetric matrix.

    The derivative of drag with respect to the edge's direction is left out: it is unsymmetric, and at
    relevant speeds so much smaller than mass / step^2 that Newton's method converges equally fast.

    Args:
        mesh, symbolic: the mesh and its index lists.
        edges: from ``add_forces`` at the same state.
        x_m, v_mps: (n, 2) positions and velocities at that state.
        water: see ``add_forces``; the flow's derivative by position is left out.
        position_gain, velocity_gain: d(position), d(velocity) / d(unknown) of the time integrator.
        diagonal, pair: see ``frogkick.der.solve.factor``; added to.
    """
    for edge in range(mesh.edge_nodes.shape[0]):
        tx, ty = get(edges.tangent, edge, 0), get(edges.tangent, edge, 1)
        inverse = get(edges.inverse_m, edge, 0)
        along = mesh.edge_stiffness_n[edge] * mesh.edge_inverse_per_m[edge]
        across = along - mesh.edge_stiffness_n[edge] * inverse  # tension / length
        put(edges.stiffness, edge, 0, along * (tx * tx) + across * (ty * ty))
        put(edges.stiffness, edge, 1, (along - across) * (tx * ty))
        put(edges.stiffness, edge, 2, along * (ty * ty) + across * (tx * tx))
    for bend in range(mesh.bend_nodes.shape[0]):
        e, f = mesh.bend_edges[bend, 0], mesh.bend_edges[bend, 1]
        e_inverse, f_inverse = get(edges.inverse_m, e, 0), get(edges.inverse_m, f, 0)
        ex, ey = get(edges.tangent, e, 0) * e_inverse, get(edges.tangent, e, 1) * e_inverse
        fx, fy = get(edges.tangent, f, 0) * f_inverse, get(edges.tangent, f, 1) * f_inverse
        slope, moment = get(edges.slope_nm, bend, 0), get(edges.moment_nm, bend, 0)
        # by e twice: slope p p^T + moment dp/de with p = dphi/de = (ey, -ex) / |e|^2; by f likewise
        twist = 2.0 * moment * (ex * ey)
        add(edges.stiffness, e, 0, slope * (ey * ey) - twist)
        add(edges.stiffness, e, 1, -(slope * (ex * ey) + moment * (ey * ey - ex * ex)))
        add(edges.stiffness, e, 2, slope * (ex * ex) + twist)
        twist = 2.0 * moment * (fx * fy)
        add(edges.stiffness, f, 0, slope * (fy * fy) + twist)
        add(edges.stiffness, f, 1, -(slope * (fx * fy) - moment * (fy * fy - fx * fx)))
        add(edges.stiffness, f, 2, slope * (fx * fx) - twist)
        # by e and f: slope p q^T with q = dphi/df = (-fy, fx) / |f|^2
        mixed = (position_gain * mesh.bend_sense[bend]) * slope
        xx, xy, yx, yy = -mixed * (ey * fy), mixed * (ey * fx), mixed * (ex * fy), -mixed * (ex * fx)
        middle = mesh.bend_nodes[bend, 1]
        add(diagonal, middle, 0, -2.0 * xx)
        add(diagonal, middle, 1, -(xy + yx))
        add(diagonal, middle, 2, -2.0 * yy)
        for corner in range(3):  # nodes a b, a c, b c
            block, flip = symbolic.bend_pair[bend, corner], symbolic.bend_flip[bend, corner]
            sign = 1.0 - 2.0 * (corner == 1)
            add(pair, block, 0, sign * xx)
            add(pair, block, 1 + flip, sign * xy)
            add(pair, block, 2 - flip, sign * yx)
            add(pair, block, 3, sign * yy)
    for edge in range(mesh.edge_nodes.shape[0]):
        tx, ty = get(edges.tangent, edge, 0), get(edges.tangent, edge, 1)
        xx = position_gain * get(edges.stiffness, edge, 0)
        xy = position_gain * get(edges.stiffness, edge, 1)
        yy = position_gain * get(edges.stiffness, edge, 2)
        block = symbolic.edge_pair[edge]
        add(pair, block, 0, -xx)
        add(pair, block, 1, -xy)
        add(pair, block, 2, -xy)
        add(pair, block, 3, -yy)
        cn, ct = 2.0 * mesh.edge_drag_normal[edge], 2.0 * mesh.edge_drag_tangential[edge]
        for end in range(2):
            node = mesh.edge_nodes[edge, end]
            vx, vy = relative_velocity(water, x_m, v_mps, node)
            vt, vn = vx * tx + vy * ty, vy * tx - vx * ty
            if mesh.drag_by_speed:  # the symmetric part
                speed = sqrt(vt * vt + vn * vn)
                share = 0.5 * velocity_gain / where_above(speed, 0.0, speed, 1.0)
                dt = share * ct * (speed * speed + vt * vt)
                dn = share * cn * (speed * speed + vn * vn)
                mixed = 0.5 * share * (ct + cn) * vt * vn
                add(diagonal, node, 0, -2.0 * mixed * (tx * ty))
                add(diagonal, node, 1, mixed * (tx * tx - ty * ty))
                add(diagonal, node, 2, 2.0 * mixed * (tx * ty))
            else:
                dt = velocity_gain * ct * absolute(vt)
                dn = velocity_gain * cn * absolute(vn)
            add(diagonal, node, 0, xx + dt * (tx * tx) + dn * (ty * ty))
            add(diagonal, node, 1, xy + (dt - dn) * (tx * ty))
            add(diagonal, node, 2, yy + dt * (ty * ty) + dn * (tx * tx))
