"""The rods of one robot as arrays: nodes, edges, bends, masses.

A mesh is constant, so any number of swimmers, lanes or processes can share it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from frogkick.core.arrays import Float64, Int32, dot
from frogkick.der.solve import SymbolicFactorisation, factorise_symbolically
from frogkick.robot import Actuation, Frame, Limb, Robot


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
    """The constant part that all swimmers of a robot share: mesh, symbolic factorisation, limbs' strokes."""

    robot: Robot
    mesh: Mesh
    symbolic: SymbolicFactorisation
    strokes: tuple[Actuation, ...]


def prepare(robot: Robot, egain_percent: float | None = None, frequency_hz: float | None = None) -> Rods:
    """Build the shared part of swimmers, by default with the limb profile of the robot's actions."""
    mesh, symbolic = build_mesh(robot)
    return Rods(robot, mesh, symbolic, robot.strokes(egain_percent, frequency_hz))


class _Edge(NamedTuple):
    """An edge and what it is made of. Its drag is per length: width times coefficient."""

    nodes: tuple[int, int]
    stiffness_n: float
    mass_kg_per_m: float = 0.0
    drag_normal_m: float = 0.0
    drag_tangential_m: float = 0.0


class _Bend(NamedTuple):
    """Three nodes with a bending energy between their two edges."""

    nodes: tuple[int, int, int]
    stiffness_n_m2: float
    active_gain: float = 0.0
    limb: int = -1  # whose activation acts on it; -1: none
    natural_per_m: float | None = None  # None: as drawn


@dataclass
class _Parts:
    """Nodes, edges and bends of a robot, which are added part by part."""

    points: list[tuple[float, float]] = field(default_factory=list)  # m, body frame
    edges: list[_Edge] = field(default_factory=list)
    bends: list[_Bend] = field(default_factory=list)
    plates: list[tuple[int, float, float]] = field(default_factory=list)  # edge, kg at each end, kg/m shed
    order: list[int] = field(default_factory=list)  # in which the solver eliminates nodes

    def add_frame(self, frame: Frame) -> list[int]:
        """Add the polygon; return the nodes at its corners."""
        corners: list[int] = []
        for i, (x, y) in enumerate(frame.corners_m):
            x2, y2 = frame.corners_m[(i + 1) % len(frame.corners_m)]
            corners.append(len(self.points))
            for j in range(frame.segments[i]):
                share = j / frame.segments[i]
                self.points.append((x + share * (x2 - x), y + share * (y2 - y)))
        count = len(self.points)
        mass = (frame.mass_per_length_kg_per_m + frame.added_mass_per_length_kg_per_m) * (
            1.0 - frame.centre_mass_share
        )
        for i in range(count):
            after = (i + 1) % count
            self.edges.append(
                _Edge(
                    (i, after),
                    frame.stretching_stiffness_n,
                    mass,
                    frame.drag_width_m * frame.drag_normal,
                    frame.drag_width_m * frame.drag_tangential,
                )
            )
            self.bends.append(_Bend(((i - 1) % count, i, after), frame.bending_stiffness_n_m2))
        return corners

    def add_limb(self, limb: Limb, index: int, root: int, clamp: int) -> None:
        """Add a limb from its root, whose bend includes the frame's node next to it on one side."""
        step = limb.length_m / limb.segments
        turn = 2.0 * math.atan(0.5 * limb.rest_curvature_per_m * step)
        bending = limb.modulus_rest_pa * limb.second_moment_m4
        nodes = [root, *range(len(self.points), len(self.points) + limb.segments)]
        x, y = self.points[root]
        for j in range(limb.segments):
            angle = limb.direction_rad + (j + 0.5) * turn  # chords of an arc whose tangent starts there
            x, y = x + step * math.cos(angle), y + step * math.sin(angle)
            self.points.append((x, y))
        widths = [limb.width_at((j + 0.5) / limb.segments) for j in range(limb.segments)]
        if limb.plate_mass_per_length_kg_per_m > 0.0:
            water = limb.plate_mass_per_length_kg_per_m
            shed = [0.0] * (limb.segments - 1) + [water * limb.width_at(1.0) ** 2 * limb.tip_shedding]
            first = len(self.edges)
            self.plates += [
                (first + j, 0.5 * water * width**2 * step, shed[j]) for j, width in enumerate(widths)
            ]
        self.edges += [
            _Edge(
                pair,
                limb.modulus_rest_pa * limb.section_m2 * width,
                limb.mass_per_length_kg_per_m * width + limb.added_mass_per_length_kg_per_m * width**2,
                limb.drag_width_m * limb.drag_normal * width,
                limb.drag_width_m * limb.drag_tangential * width,
            )
            for pair, width in zip(pairwise(nodes), widths, strict=True)
        ]
        self.bends.append(_Bend((clamp, root, nodes[1]), limb.root_stiffness_ratio * bending))
        gain = limb.modulus_active_pa / limb.modulus_rest_pa - 1.0
        self.bends += [
            _Bend(
                (nodes[j - 1], nodes[j], nodes[j + 1]),
                bending * (1.0 + (limb.tip_stiffness_ratio - 1.0) * j / limb.segments),
                gain,
                index,
                limb.rest_curvature_per_m,
            )
            for j in range(1, limb.segments)
        ]
        self.order += nodes[:0:-1]  # tip to root: each node then couples to two others only

    def add_centre_mass(self, frame: Frame, corners: Sequence[int]) -> None:
        """Add a node within the frame. Stiff spokes without weight hold it; it resists no turn."""
        self.order.append(len(self.points))
        for corner in corners:
            self.edges.append(_Edge((len(self.points), corner), frame.stretching_stiffness_n))
        middle = np.mean([self.points[corner] for corner in corners], axis=0)
        x, y = (middle + frame.centre_mass_at_m).tolist()
        self.points.append((x, y))


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
    frame, parts = robot.frame, _Parts()
    corners = parts.add_frame(frame)
    n_frame = len(parts.points)
    for index, limb in enumerate(robot.limbs):
        root = corners[limb.corner]
        clamp = (root + (1 if limb.clamp == "next" else -1)) % n_frame
        parts.add_limb(limb.with_egain(robot.egain_percent), index, root, clamp)
    parts.order += list(range(n_frame))
    if frame.centre_mass_share > 0.0:
        parts.add_centre_mass(frame, corners)
    edges, bends = parts.edges, parts.bends
    rest = np.array(parts.points, dtype=np.float64)
    ends = np.array([edge.nodes for edge in edges], dtype=np.int32)
    length = np.hypot(*(rest[ends[:, 1]] - rest[ends[:, 0]]).T)
    mass_per_m = np.array([edge.mass_kg_per_m for edge in edges])
    mass = np.zeros(len(rest))
    np.add.at(mass, ends.ravel(), np.repeat(0.5 * mass_per_m * length, 2))
    if frame.centre_mass_share > 0.0:
        outline_kg = dot(mass_per_m[:n_frame], length[:n_frame])
        mass[-1] += outline_kg * frame.centre_mass_share / (1.0 - frame.centre_mass_share)
    curvature = [turning_curvature(rest, bend.nodes) for bend in bends]
    natural = [
        drawn if bend.natural_per_m is None else bend.natural_per_m
        for bend, (drawn, _) in zip(bends, curvature, strict=True)
    ]
    edge_of = {edge.nodes: (k, 1.0) for k, edge in enumerate(edges)}
    edge_of |= {(j, i): (k, -1.0) for k, ((i, j), *_) in enumerate(edges)}
    sides = [(edge_of[a, b], edge_of[b, c]) for (a, b, c), *_ in bends]
    limb_of = np.array([bend.limb for bend in bends], dtype=np.int32)
    weakest = min(limb.modulus_rest_pa * limb.second_moment_m4 / limb.length_m**2 for limb in robot.limbs)
    # Density / 2, for the half of an edge at each of its ends.
    quarter = 0.25 * robot.water_density_kg_per_m3
    mesh = Mesh(
        frame_nodes=n_frame,
        rest_m=rest - np.einsum("n,nc->c", mass, rest) / mass.sum(),
        mass_kg=mass,
        edge_nodes=ends,
        edge_length_m=np.ascontiguousarray(length),
        edge_stiffness_n=np.array([edge.stiffness_n for edge in edges]),
        edge_drag_normal=quarter * np.array([edge.drag_normal_m for edge in edges]) * length,
        edge_drag_tangential=quarter * np.array([edge.drag_tangential_m for edge in edges]) * length,
        drag_by_speed=robot.drag_law == "speed",
        bend_nodes=np.array([bend.nodes for bend in bends], dtype=np.int32),
        bend_length_m=np.array([dl for _, dl in curvature]),
        bend_stiffness_n_m2=np.array([bend.stiffness_n_m2 for bend in bends]),
        bend_active_gain=np.array([bend.active_gain for bend in bends]),
        bend_natural_per_m=np.array(natural),
        edge_inverse_per_m=1.0 / length,
        bend_edges=np.array([(e, f) for (e, _), (f, _) in sides], dtype=np.int32),
        bend_sense=np.array([e * f for (_, e), (_, f) in sides]),
        bend_curl=np.where(limb_of >= 0, np.sign(natural), 0.0),
        bend_column=2 * np.where(limb_of >= 0, limb_of, len(robot.limbs)).astype(np.int32),
        force_scale_n=float(weakest),
        plate_edges=np.array([edge for edge, _, _ in parts.plates], dtype=np.int32),
        plate_kg=np.array([mass for _, mass, _ in parts.plates], dtype=np.float64),
        plate_shed_kg_per_m=np.array([shed for _, _, shed in parts.plates], dtype=np.float64),
    )
    return mesh, factorise_symbolically(len(rest), mesh.edge_nodes, mesh.bend_nodes, parts.order)
