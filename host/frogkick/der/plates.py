"""Limbs as plates: the water that moves with a limb is inertia across it and none along it.

Each edge of a plate moves M kg of water with it across, and none along. Half of this added mass acts at each
end of the edge, as drag does. So its kinetic energy is T = M/4 (v_i.n)^2 + M/4 (v_j.n)^2, where n is the
edge's normal. The force is Lagrange's, dT/dx - d/dt(dT/dv). It conserves the energy, and the momentum dT/dv
together with that of the nodes (Kirchhoff). In the limit of a fine mesh it is
-d/dt(m v_n n) + d/ds(m v_n v_t n), the force of elongated-body theory, but for a tension that an inextensible
rod does not feel.

A sharp tip sheds vorticity. The suction 1/2 m v_n^2 of water that turns round the tip is lost, whichever way
the tip moves, and the momentum m v_n n of the water that it leaves behind does not return. Both take energy
out only: 1/2 m v_n^2 |v_t| in all, which stays in the wake.

Arrays are those of ``frogkick.der.rods``. Velocities are relative to the water. The acceleration of the water
itself is neglected.

Source: Lighthill 1971, Proc. R. Soc. B 179 (large amplitude, the wake's energy); Candelier, Boyer, Leroyer
2011, J. Fluid Mech. 668 (the force on curved bodies); Lamb 1932, articles 117 to 124 (Kirchhoff).
"""

from __future__ import annotations

from typing import Any

from numba import njit

from frogkick.core.compiled import BARE, INNER
from frogkick.der.lanes import SimdArray, add, get, where_above
from frogkick.der.mesh import Mesh
from frogkick.der.rods import Edges
from frogkick.der.solve import SymbolicFactorisation, add_four
from frogkick.der.water import relative_velocity


@njit(**BARE)
def add_plate_forces(
    mesh: Mesh,
    edges: Edges,
    x_m: SimdArray,
    v_mps: SimdArray,
    water: SimdArray,
    move_m: SimdArray,
    a_start: SimdArray,
    mass_gain: Any,
    force_n: SimdArray,
) -> None:
    """Add the force of the water that moves with plates.

    Args:
        edges: from ``add_forces`` at the same state.
        x_m, v_mps: (n, 2) positions and velocities at that state.
        water: (WATER, 1), see ``frogkick.der.water``; (0, 1) in still water.
        move_m, a_start, mass_gain: accelerations are mass_gain * move_m - a_start, (n, 2), m/s^2.
        force_n: (n, 2), added to.
    """
    for plate in range(mesh.plate_edges.shape[0]):
        edge, mass = mesh.plate_edges[plate], mesh.plate_kg[plate]
        i, j = mesh.edge_nodes[edge, 0], mesh.edge_nodes[edge, 1]
        tx, ty = get(edges.tangent, edge, 0), get(edges.tangent, edge, 1)
        inverse = get(edges.inverse_m, edge, 0)
        vix, viy, vjx, vjy = get(v_mps, i, 0), get(v_mps, i, 1), get(v_mps, j, 0), get(v_mps, j, 1)
        spin = ((vjy - viy) * tx - (vjx - vix) * ty) * inverse
        vix, viy = relative_velocity(water, x_m, v_mps, i)
        vjx, vjy = relative_velocity(water, x_m, v_mps, j)
        vit, vin = vix * tx + viy * ty, viy * tx - vix * ty
        vjt, vjn = vjx * tx + vjy * ty, vjy * tx - vjx * ty
        turn = (mass * inverse) * (vin * vit + vjn * vjt)  # -dT / d(edge), along n
        for end in range(2):
            node = mesh.edge_nodes[edge, end]
            first = 1.0 - 1.0 * end
            vt, vn = first * vit + (1.0 - first) * vjt, first * vin + (1.0 - first) * vjn
            ax = mass_gain * get(move_m, node, 0) - get(a_start, node, 0)
            ay = mass_gain * get(move_m, node, 1) - get(a_start, node, 1)
            # d/dt(v_n n) = (a_n - spin v_t) n - spin v_n t
            across = (2.0 * first - 1.0) * turn - mass * ((ay * tx - ax * ty) - spin * vt)
            along = mass * (spin * vn)
            add(force_n, node, 0, along * tx - across * ty)
            add(force_n, node, 1, along * ty + across * tx)
        shed = mesh.plate_shed_kg_per_m[plate]
        if shed != 0.0:
            across = shed * (vjn * where_above(vjt, 0.0, 0.0, vjt))
            along = (-0.5 * shed) * (vjn * vjn)
            add(force_n, j, 0, along * tx - across * ty)
            add(force_n, j, 1, along * ty + across * tx)


@njit(**BARE)
def add_plate_masses(mesh: Mesh, edges: Edges, diagonal: SimdArray) -> None:
    """Add the water's mass to xx, xy, yy of the nodes' blocks, (n, 3); ``edges`` are from ``add_forces``."""
    for plate in range(mesh.plate_edges.shape[0]):
        edge, mass = mesh.plate_edges[plate], mesh.plate_kg[plate]
        tx, ty = get(edges.tangent, edge, 0), get(edges.tangent, edge, 1)
        for end in range(2):
            node = mesh.edge_nodes[edge, end]
            add(diagonal, node, 0, mass * (ty * ty))
            add(diagonal, node, 1, -(mass * (tx * ty)))
            add(diagonal, node, 2, mass * (tx * tx))


@njit(**INNER)
def acceleration(move_m: SimdArray, a_start: SimdArray, mass_gain: Any, node: int) -> tuple[Any, Any]:
    """World acceleration of a node, mass_gain * move_m - a_start."""
    return (
        mass_gain * get(move_m, node, 0) - get(a_start, node, 0),
        mass_gain * get(move_m, node, 1) - get(a_start, node, 1),
    )


@njit(**INNER)
def to_world(tx: Any, ty: Any, tt: Any, tn: Any, nt: Any, nn: Any) -> tuple[Any, Any, Any, Any]:
    """Turn a matrix of components along t and across, n, into xx, xy, yx, yy."""
    x2, y2, mixed = tx * tx, ty * ty, tx * ty
    both, gap = (tn + nt) * mixed, (tt - nn) * mixed
    return (
        tt * x2 + nn * y2 - both,
        gap + tn * x2 - nt * y2,
        gap + nt * x2 - tn * y2,
        tt * y2 + nn * x2 + both,
    )


@njit(**BARE)
def add_plate_stiffness(
    mesh: Mesh,
    symbolic: SymbolicFactorisation,
    edges: Edges,
    x_m: SimdArray,
    v_mps: SimdArray,
    water: SimdArray,
    move_m: SimdArray,
    a_start: SimdArray,
    position_gain: float,
    velocity_gain: Any,
    mass_gain: Any,
    diagonal: SimdArray,
    pair: SimdArray,
    lower: SimdArray,
) -> None:
    """Add the negative derivative of ``add_plate_forces``, complete but for the flow's by position.

    Without all of it each correction leaves a twentieth of the residual instead of a thousandth: across and
    along an edge a limb's motion is coupled by gyroscopic forces, which are antisymmetric, and an edge that
    turns takes the force of its acceleration with it.

    Args:
        mesh, symbolic: the mesh and its index lists.
        edges, x_m, v_mps, water, move_m, a_start, mass_gain: see ``add_plate_forces``.
        position_gain, velocity_gain: d(position), d(velocity) / d(unknown) of the time integrator.
        diagonal, pair, lower: see ``frogkick.der.solve.factor_mixed``; added to.
    """
    for plate in range(mesh.plate_edges.shape[0]):
        edge, mass = mesh.plate_edges[plate], mesh.plate_kg[plate]
        i, j = mesh.edge_nodes[edge, 0], mesh.edge_nodes[edge, 1]
        tx, ty = get(edges.tangent, edge, 0), get(edges.tangent, edge, 1)
        inverse = get(edges.inverse_m, edge, 0)
        wx, wy = get(v_mps, j, 0) - get(v_mps, i, 0), get(v_mps, j, 1) - get(v_mps, i, 1)
        spin, stretch = (wy * tx - wx * ty) * inverse, (wx * tx + wy * ty) * inverse
        vix, viy = relative_velocity(water, x_m, v_mps, i)
        vjx, vjy = relative_velocity(water, x_m, v_mps, j)
        vit, vin = vix * tx + viy * ty, viy * tx - vix * ty
        vjt, vjn = vjx * tx + vjy * ty, vjy * tx - vjx * ty
        rate = mass * inverse
        turn = rate * (vin * vit + vjn * vjt)
        turned = rate * ((vin * vin - vit * vit) + (vjn * vjn - vjt * vjt))  # d(turn) / d(angle)
        # By position: what the force on an end loses along and across (first letter), as its neighbour moves
        # along, which stretches the edge, or across, which turns it.
        place, hold = position_gain * inverse, (position_gain * rate) * spin
        ax, ay = acceleration(move_m, a_start, mass_gain, i)
        i_tn = place * (mass * ((ay * tx - ax * ty) - 2.0 * (spin * vit) - stretch * vin) - turn)
        i_nn = place * (mass * ((ax * tx + ay * ty) + 2.0 * (spin * vin) - stretch * vit) + turned)
        i_tt, i_nt = -(hold * vin), -(hold * vit) - place * turn
        ax, ay = acceleration(move_m, a_start, mass_gain, j)
        j_tn = place * (mass * ((ay * tx - ax * ty) - 2.0 * (spin * vjt) - stretch * vjn) + turn)
        j_nn = place * (mass * ((ax * tx + ay * ty) + 2.0 * (spin * vjn) - stretch * vjt) - turned)
        j_tt, j_nt = -(hold * vjn), -(hold * vjt) + place * turn
        # By velocity, gyroscopic and what couples a node's motion along and across.
        gain = velocity_gain * rate
        gi_t, gi_n, gj_t, gj_n = gain * vin, gain * vit, gain * vjn, gain * vjt
        couple, inertia = (velocity_gain * mass) * spin, mesh.plate_kg[plate] * mass_gain
        own_tn, own_nt, own_nn = -couple, -couple, inertia
        shed = mesh.plate_shed_kg_per_m[plate]
        if shed != 0.0:
            back = where_above(vjt, 0.0, 0.0, vjt)
            leaving = where_above(vjt, 0.0, 0.0, vjn)
            j_tn = j_tn + (place * shed) * (vjn * (vjt - back))
            j_nn = j_nn + (place * shed) * (vjn * leaving - 0.5 * (vjn * vjn) - vjt * back)
            give = velocity_gain * shed
            own_tn, own_nt, own_nn = own_tn + give * vjn, own_nt - give * leaving, own_nn - give * back
        block, flip = symbolic.edge_pair[edge], symbolic.edge_flip[edge]
        xx, xy, yx, yy = to_world(tx, ty, i_tt, i_tn + gi_t - couple, i_nt - gi_t - couple, i_nn + inertia)
        add_four(diagonal, i, xx, xy, yy, yx - xy)
        xx, xy, yx, yy = to_world(tx, ty, -j_tt, own_tn - j_tn - gj_t, own_nt + gj_t - j_nt, own_nn - j_nn)
        add_four(diagonal, j, xx, xy, yy, yx - xy)
        xx, xy, yx, yy = to_world(tx, ty, i_tt, i_tn + gi_t, i_nt + gj_t, i_nn + gi_n + gj_n)  # rows of i
        add_four(lower if flip else pair, block, -xx, -xy, -yx, -yy)
        xx, xy, yx, yy = to_world(tx, ty, j_tt, j_tn + gj_t, j_nt + gi_t, j_nn + gj_n + gi_n)  # rows of j
        add_four(pair if flip else lower, block, xx, xy, yx, yy)
