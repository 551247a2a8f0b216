"""The rods of one robot as arrays: nodes, edges, bends, masses.

A mesh is constant, so any number of swimmers, lanes or processes can share it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from frogkick.core.arrays import Float64, Int32, dot
from frogkick.der.solve import SymbolicFactorisation, factorise_symbolically
from frogkick.robot import Actuation, Robot


class Mesh(NamedTuple):
    """Nodes, edges and bends of a robot, in SI units.

    Nodes 0 .. frame_nodes-1 go round the frame. Then come those of each limb, from the one after its root,
    which is a corner of the frame, to its tip, and last the mass point within the frame, if it has one.
    """

    frame_nodes: int  # number of nodes of the frame
    rest_m: Float64  # (n, 2) positions at rest, body frame, origin at the mass-weighted centre
    mass_kg: Float64  # (n,) lumped mass including added mass, half of each edge at each of its ends
    edge_nodes: Int32  # (e, 2) ends of each edge
    edge_length_m: Float64  # (e,) unstretched length
    edge_stiffness_n: Float64  # (e,) EA
    # edge_drag_normal, edge_drag_tangential: (e,) N / (m/s)^2 at EACH end: rho D C (dl / 2) / 2
    edge_drag_normal: Float64
    edge_drag_tangential: Float64
    # whether each component of the drag goes with the speed, |v| v_n and |v| v_t, or with itself, |v_n| v_n
    drag_by_speed: bool
    bend_nodes: Int32  # (b, 3) the three nodes of each bend; a corner is the middle of two bends
    bend_length_m: Float64  # (b,) mean length of its two edges
    bend_stiffness_n_m2: Float64  # (b,) EI at rest
    # (b,) EI grows by this factor times the activation; 0 outside the limbs and at roots
    bend_active_gain: Float64
    bend_natural_per_m: Float64  # (b,) natural curvature at rest
    edge_inverse_per_m: Float64  # (e,) 1 / edge_length_m
    bend_edges: Int32  # (b, 2) its two edges
    # (b,) -1 if exactly one of these edges is stored against the bend's direction, else 1
    bend_sense: Float64
    bend_curl: Float64  # (b,) sign of the natural curvature that actuation reduces; 0 for bends of no limb
    bend_column: Int32  # (b,) column of its activation: 2 * its limb, or 2 * the number of limbs for none
    force_scale_n: float  # typical bending force of a limb, EI / length^2, the scale of residuals
    # (p,) edges of limbs that take water along as plates do, see ``frogkick.der.plates``.
    plate_edges: Int32
    plate_kg: Float64  # (p,) that water at EACH end, half of the edge's
    plate_shed_kg_per_m: Float64  # (p,) mass per length that a tip at its second end sheds, else 0

    @property
    def limbs(self) -> int:
        """Number of limbs."""
        return int(self.bend_column.max()) // 2


@dataclass(frozen=True)
class Rods:
    """The constant part that all swimmers of a robot share: mesh, symbolic factorisation, stroke."""

    robot: Robot
    mesh: Mesh
    symbolic: SymbolicFactorisation
    actuation: Actuation


def prepare(robot: Robot, egain_percent: float | None = None, frequency_hz: float | None = None) -> Rods:
    """Build the shared part of swimmers, by default with the limb profile of the robot's actions."""
    mesh, symbolic = build_mesh(robot)
    return Rods(robot, mesh, symbolic, robot.actuation(egain_percent, frequency_hz))


def _frame_points(robot: Robot) -> tuple[list[tuple[float, float]], list[int]]:
    """Return the nodes round the polygon, and the indices of its corners."""
    points: list[tuple[float, float]] = []
    corners: list[int] = []
    for i, (x, y) in enumerate(robot.frame.corners_m):
        x2, y2 = robot.frame.corners_m[(i + 1) % len(robot.frame.corners_m)]
        corners.append(len(points))
        for j in range(robot.frame.segments[i]):
            share = j / robot.frame.segments[i]
            points.append((x + share * (x2 - x), y + share * (y2 - y)))
    return points, corners


def turning_curvature(rest_m: Float64, nodes: tuple[int, int, int]) -> tuple[float, float]:
    """Return the discrete curvature 2 tan(phi / 2) / dl (1/m) at the middle of three nodes, and dl (m)."""
    e = rest_m[nodes[1]] - rest_m[nodes[0]]
    f = rest_m[nodes[2]] - rest_m[nodes[1]]
    dl = 0.5 * (float(np.hypot(*e)) + float(np.hypot(*f)))
    phi = math.atan2(float(e[0] * f[1] - e[1] * f[0]), dot(e, f))
    return 2.0 * math.tan(0.5 * phi) / dl, dl


def build_mesh(robot: Robot) -> tuple[Mesh, SymbolicFactorisation]:
    """Discretise a robot and plan the elimination of its linear systems.

    Returns:
        The mesh, and the static index lists of its solver.

    Source: Huang 2022, section on 2D discrete elastic rods: a corner joins three edges and carries two
    bending energies, the frame's own and the limb's root.
    """
    frame = robot.frame
    points, corners = _frame_points(robot)
    n_frame = len(points)
    edges = [(i, (i + 1) % n_frame) for i in range(n_frame)]
    bends = [((i - 1) % n_frame, i, (i + 1) % n_frame) for i in range(n_frame)]
    rows: list[tuple[float, ...]] = [
        (
            frame.stretching_stiffness_n,
            (frame.mass_per_length_kg_per_m + frame.added_mass_per_length_kg_per_m)
            * (1.0 - frame.centre_mass_share),
            frame.drag_width_m * frame.drag_normal,
            frame.drag_width_m * frame.drag_tangential,
        )
    ] * len(edges)
    stiffness = [frame.bending_stiffness_n_m2] * len(bends)
    gain = [0.0] * len(bends)
    bend_limb = [-1] * len(bends)
    limb_curvature: dict[int, float] = {}
    order: list[int] = []
    plates: list[tuple[int, float, float]] = []  # edge, kg at each end, kg/m shed
    for index, light in enumerate(robot.limbs):
        limb = light.with_egain(robot.egain_percent)
        root = corners[limb.corner]
        step = limb.length_m / limb.segments
        turn = 2.0 * math.atan(0.5 * limb.rest_curvature_per_m * step)
        bending = limb.modulus_rest_pa * limb.second_moment_m4
        nodes = [root, *range(len(points), len(points) + limb.segments)]
        x, y = points[root]
        for j in range(limb.segments):
            angle = limb.direction_rad + (j + 0.5) * turn  # chords of an arc whose tangent starts there
            x, y = x + step * math.cos(angle), y + step * math.sin(angle)
            points.append((x, y))
        if limb.plate_mass_per_length_kg_per_m > 0.0:
            water = limb.plate_mass_per_length_kg_per_m
            shed = [0.0] * (limb.segments - 1) + [water * limb.tip_shedding]
            plates += [(len(edges) + j, 0.5 * water * step, shed[j]) for j in range(limb.segments)]
        edges += list(pairwise(nodes))
        rows += [
            (
                limb.modulus_rest_pa * limb.section_m2,
                limb.mass_per_length_kg_per_m + limb.added_mass_per_length_kg_per_m,
                limb.drag_width_m * limb.drag_normal,
                limb.drag_width_m * limb.drag_tangential,
            )
        ] * limb.segments
        clamp = (root + (1 if limb.clamp == "next" else -1)) % n_frame
        bends.append((clamp, root, nodes[1]))
        stiffness.append(limb.root_stiffness_ratio * bending)
        gain.append(0.0)
        bend_limb.append(-1)
        for j in range(1, limb.segments):
            limb_curvature[len(bends)] = limb.rest_curvature_per_m
            bends.append((nodes[j - 1], nodes[j], nodes[j + 1]))
            stiffness.append(bending)
            gain.append(limb.modulus_active_pa / limb.modulus_rest_pa - 1.0)
            bend_limb.append(index)
        order += nodes[:0:-1]  # tip to root: each node then couples to two others only
    order += list(range(n_frame))
    if frame.centre_mass_share > 0.0:  # held by stiff spokes without weight, it resists no turn
        order.append(len(points))
        edges += [(len(points), corner) for corner in corners]
        rows += [(frame.stretching_stiffness_n, 0.0, 0.0, 0.0)] * len(corners)
        centre = np.mean([points[corner] for corner in corners], axis=0) + frame.centre_mass_at_m
        points.append(tuple(centre.tolist()))
    rest = np.array(points, dtype=np.float64)
    ends = np.array(edges, dtype=np.int32)
    length = np.hypot(*(rest[ends[:, 1]] - rest[ends[:, 0]]).T)
    material = np.array(rows, dtype=np.float64)
    mass = np.zeros(len(points))
    np.add.at(mass, ends.ravel(), np.repeat(0.5 * material[:, 1] * length, 2))
    if frame.centre_mass_share > 0.0:
        outline_kg = dot(material[:n_frame, 1], length[:n_frame])
        mass[-1] += outline_kg * frame.centre_mass_share / (1.0 - frame.centre_mass_share)
    curvature = [turning_curvature(rest, bend) for bend in bends]
    natural = [limb_curvature.get(b, curvature[b][0]) for b in range(len(bends))]
    edge_of = {pair: (k, 1.0) for k, pair in enumerate(edges)}
    edge_of |= {(j, i): (k, -1.0) for k, (i, j) in enumerate(edges)}
    sides = [(edge_of[a, b], edge_of[b, c]) for a, b, c in bends]
    limb_of = np.array(bend_limb, dtype=np.int32)
    weakest = min(limb.modulus_rest_pa * limb.second_moment_m4 / limb.length_m**2 for limb in robot.limbs)
    mesh = Mesh(
        frame_nodes=n_frame,
        rest_m=rest - np.einsum("n,nc->c", mass, rest) / mass.sum(),
        mass_kg=mass,
        edge_nodes=ends,
        edge_length_m=np.ascontiguousarray(length),
        edge_stiffness_n=np.ascontiguousarray(material[:, 0]),
        edge_drag_normal=0.25 * robot.water_density_kg_per_m3 * material[:, 2] * length,
        edge_drag_tangential=0.25 * robot.water_density_kg_per_m3 * material[:, 3] * length,
        drag_by_speed=robot.drag_law == "speed",
        bend_nodes=np.array(bends, dtype=np.int32),
        bend_length_m=np.array([dl for _, dl in curvature]),
        bend_stiffness_n_m2=np.array(stiffness),
        bend_active_gain=np.array(gain),
        bend_natural_per_m=np.array(natural),
        edge_inverse_per_m=1.0 / length,
        bend_edges=np.array([(e, f) for (e, _), (f, _) in sides], dtype=np.int32),
        bend_sense=np.array([e * f for (_, e), (_, f) in sides]),
        bend_curl=np.where(limb_of >= 0, np.sign(natural), 0.0),
        bend_column=2 * np.where(limb_of >= 0, limb_of, len(robot.limbs)).astype(np.int32),
        force_scale_n=float(weakest),
        plate_edges=np.array([edge for edge, _, _ in plates], dtype=np.int32),
        plate_kg=np.array([mass for _, mass, _ in plates], dtype=np.float64),
        plate_shed_kg_per_m=np.array([shed for _, _, shed in plates], dtype=np.float64),
    )
    return mesh, factorise_symbolically(len(points), mesh.edge_nodes, mesh.bend_nodes, order)
