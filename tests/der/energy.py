"""The rods' energies and the power of drag, in their plainest form, for tests.

Nothing here is used to simulate. ``frogkick.der.rods`` must be the derivative of it, and an energy balance of
a simulation can be computed with it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frogkick.der.mesh import Mesh

FloatArray = NDArray[np.float64]


def bend_parameters(mesh: Mesh, activation: FloatArray, drop_per_m: float) -> tuple[FloatArray, FloatArray]:
    """(b,) EI (N m^2) and natural curvature (1/m) of all bends while limbs are active to ``activation``.

    An active limb's natural curvature falls by ``drop_per_m`` in size, and its modulus rises linearly.
    """
    active = np.append(activation, 0.0)[mesh.bend_column // 2]  # no limb is the last
    stiffness = mesh.bend_stiffness_n_m2 * (1.0 + mesh.bend_active_gain * active)
    return stiffness, mesh.bend_natural_per_m - mesh.bend_curl * drop_per_m * active


def curvature(mesh: Mesh, x_m: FloatArray) -> FloatArray:
    """(b,) discrete curvature 2 tan(phi / 2) / dl of all bends, 1/m."""
    a, b, c = (x_m[mesh.bend_nodes[:, k]] for k in range(3))
    e, f = b - a, c - b
    phi = np.arctan2(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0], (e * f).sum(axis=1))
    return np.asarray(2.0 * np.tan(0.5 * phi) / mesh.bend_length_m)


def stretching_energy(mesh: Mesh, x_m: FloatArray) -> float:
    """Sum of EA e^2 dl / 2 over the edges, J, with the strain e = |edge| / dl - 1."""
    edges = x_m[mesh.edge_nodes[:, 1]] - x_m[mesh.edge_nodes[:, 0]]
    strain = np.hypot(edges[:, 0], edges[:, 1]) / mesh.edge_length_m - 1.0
    return float((0.5 * mesh.edge_stiffness_n * strain**2 * mesh.edge_length_m).sum())


def bending_energy(mesh: Mesh, x_m: FloatArray, activation: FloatArray, drop_per_m: float) -> float:
    """Sum of EI (k - k0)^2 dl / 2 over the bends, J."""
    stiffness, natural = bend_parameters(mesh, activation, drop_per_m)
    return float((0.5 * stiffness * (curvature(mesh, x_m) - natural) ** 2 * mesh.bend_length_m).sum())


def kinetic_energy(mesh: Mesh, v_mps: FloatArray) -> float:
    """Sum of m v^2 / 2 over the nodes, J, added mass included."""
    return float(0.5 * mesh.mass_kg @ (v_mps**2).sum(axis=1))


def drag_power(mesh: Mesh, x_m: FloatArray, v_mps: FloatArray) -> float:
    """Power dissipated by drag, W, positive."""
    edges = x_m[mesh.edge_nodes[:, 1]] - x_m[mesh.edge_nodes[:, 0]]
    tangent = edges / np.hypot(edges[:, 0], edges[:, 1])[:, None]
    power = 0.0
    for end in range(2):
        v = v_mps[mesh.edge_nodes[:, end]]
        along = np.abs((v * tangent).sum(axis=1))
        across = np.abs(v[:, 1] * tangent[:, 0] - v[:, 0] * tangent[:, 1])
        power += float((mesh.edge_drag_tangential * along**3 + mesh.edge_drag_normal * across**3).sum())
    return power
