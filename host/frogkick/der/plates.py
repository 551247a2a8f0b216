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

from frogkick.core.compiled import BARE
from frogkick.der.lanes import SimdArray, add, get, where_above
from frogkick.der.mesh import Mesh
from frogkick.der.rods import Edges
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
def add_plate_inertia(
    mesh: Mesh, edges: Edges, v_mps: SimdArray, velocity_gain: Any, mass_gain: Any, diagonal: SimdArray
) -> None:
    """Add the negative derivative of ``add_plate_forces`` to a symmetric matrix.

    By acceleration it is complete, by velocity it is what couples a node's motion along and across its edge.
    The rest is gyroscopic (antisymmetric) or grows with the acceleration; both are left out.

    Args:
        edges: from ``add_forces`` at the same state.
        v_mps: (n, 2) velocities.
        velocity_gain, mass_gain: d(velocity), d(acceleration) / d(unknown) of the time integrator.
        diagonal: see ``frogkick.der.solve.factor``; added to.
    """
    for plate in range(mesh.plate_edges.shape[0]):
        edge = mesh.plate_edges[plate]
        i, j = mesh.edge_nodes[edge, 0], mesh.edge_nodes[edge, 1]
        tx, ty = get(edges.tangent, edge, 0), get(edges.tangent, edge, 1)
        wx, wy = get(v_mps, j, 0) - get(v_mps, i, 0), get(v_mps, j, 1) - get(v_mps, i, 1)
        spin = (wy * tx - wx * ty) * get(edges.inverse_m, edge, 0)
        inertia = mesh.plate_kg[plate] * mass_gain
        turn = (mesh.plate_kg[plate] * velocity_gain) * spin  # of -(n t^T + t n^T)
        for end in range(2):
            node = mesh.edge_nodes[edge, end]
            add(diagonal, node, 0, inertia * (ty * ty) + (2.0 * turn) * (tx * ty))
            add(diagonal, node, 1, turn * (ty * ty - tx * tx) - inertia * (tx * ty))
            add(diagonal, node, 2, inertia * (tx * tx) - (2.0 * turn) * (tx * ty))
