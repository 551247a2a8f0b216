"""Limbs as plates: the force of one energy, its derivative, Kirchhoff's momentum, tips, order, bits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.der.energy import bending_energy, kinetic_energy, stretching_energy
from tests.der.rig import dense, straight_rod
from tests.der.single import Swimmer
from tests.der.test_physics import alone

from frogkick.der import STEP_S, Batch, prepare
from frogkick.der.lanes import lane_zeros
from frogkick.der.mesh import Mesh
from frogkick.der.plates import add_plate_forces, add_plate_stiffness
from frogkick.der.rods import add_forces, edges_of
from frogkick.der.solve import SymbolicFactorisation, unsymmetric_steps
from frogkick.effects import changed_robot, make_effect
from frogkick.effects.acting import lane_effects, program_of
from frogkick.effects.body import plate_mass_kg_per_m
from frogkick.robot import Robot, load_robot

ROBOT = load_robot("frog2022")


def plated(robot: Robot = ROBOT, added: float = 1.0, shedding: float = 0.0) -> Robot:
    effect = make_effect({"name": "limb_plate", "added": added, "shedding": shedding}, Path())
    return changed_robot(robot, [effect])


def without_drag(robot: Robot) -> Robot:
    bare = {"drag_normal": 0.0, "drag_tangential": 0.0}
    limbs = tuple(replace(limb, **bare) for limb in robot.limbs)
    return replace(robot, frame=replace(robot.frame, **bare), limbs=limbs)


def plate_rod(
    nodes: int, water: float, shed: float = 0.0, **how: float
) -> tuple[Mesh, SymbolicFactorisation]:
    """A free straight rod of 0.1 m, all of it a plate of ``water`` kg/m; its second end sheds."""
    mesh, symbolic = straight_rod(nodes, 0.1, **how)
    edges = np.arange(nodes - 1, dtype=np.int32)
    at_end = np.where(edges == nodes - 2, shed * water, 0.0)
    half = np.full(nodes - 1, 0.5 * water * 0.1 / (nodes - 1))
    return mesh._replace(plate_edges=edges, plate_kg=half, plate_shed_kg_per_m=at_end), symbolic


def normals(mesh: Mesh, x: np.ndarray) -> np.ndarray:
    ends = mesh.edge_nodes[mesh.plate_edges]
    edge = x[ends[:, 1]] - x[ends[:, 0]]
    return np.column_stack([-edge[:, 1], edge[:, 0]]) / np.hypot(*edge.T)[:, None]


def plate_momentum(mesh: Mesh, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n, 2) dT/dv of the water at each node, kg m/s."""
    found, normal = np.zeros_like(v), normals(mesh, x)
    for end in range(2):
        nodes = mesh.edge_nodes[mesh.plate_edges, end]
        np.add.at(found, nodes, (mesh.plate_kg * (v[nodes] * normal).sum(axis=1))[:, None] * normal)
    return found


def plate_energy(mesh: Mesh, x: np.ndarray, v: np.ndarray) -> float:
    """T of the water, J: quadratic in v."""
    return float(0.5 * (plate_momentum(mesh, x, v) * v).sum())


def plate_forces(mesh: Mesh, x: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    edges, force, still = edges_of(mesh, 1), np.zeros_like(x), lane_zeros((0, 1), 1)
    limbs = int(mesh.bend_column.max()) // 2
    add_forces(mesh, edges, x, v, np.zeros((1, 2 * limbs + 2)), 0, still, force)
    force[:] = 0.0
    add_plate_forces(mesh, edges, x, v, still, np.zeros_like(x), -a, 0.0, force)
    return force


def state(mesh: Mesh, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = mesh.rest_m + 3e-4 * rng.normal(size=mesh.rest_m.shape)
    return x, 0.3 * rng.normal(size=x.shape), 30.0 * rng.normal(size=x.shape)


def test_a_limb_s_plate_is_a_third_of_a_kilogram_per_metre() -> None:
    limb = ROBOT.limbs[0]
    assert plate_mass_kg_per_m(limb, 1000.0) == pytest.approx(0.31, rel=0.01)
    long = replace(limb, length_m=100.0)
    assert plate_mass_kg_per_m(long, 1000.0) == pytest.approx(0.947 * 250.0 * np.pi * 0.024**2, rel=1e-9)
    square = replace(limb, length_m=limb.drag_width_m)
    assert plate_mass_kg_per_m(square, 1000.0) == pytest.approx(0.579 * 250.0 * np.pi * 0.024**2, rel=1e-9)


@from_ci
@pytest.mark.parametrize("seed", range(3))
def test_the_force_is_lagrange_s_of_the_kinetic_energy(seed: int) -> None:
    """f = dT/dx - d/dt(dT/dv) along x(t) = x + v t + a t^2 / 2, by central differences."""
    mesh = prepare(plated()).mesh
    x, v, a = state(mesh, seed)
    h = 1e-6
    before, after = (
        plate_momentum(mesh, x + s * h * v + 0.5 * h * h * a, v + s * h * a) for s in (-1.0, 1.0)
    )
    expected = -(after - before) / (2.0 * h)
    d = 1e-8
    for node in range(mesh.frame_nodes - 2, len(x)):
        for axis in range(2):
            move = np.zeros_like(x)
            move[node, axis] = d
            rise = plate_energy(mesh, x + move, v) - plate_energy(mesh, x - move, v)
            expected[node, axis] += rise / (2.0 * d)
    found = plate_forces(mesh, x, v, a)
    rows = slice(mesh.frame_nodes - 2, None)
    assert found[rows] == pytest.approx(expected[rows], rel=1e-5, abs=1e-5 * np.abs(found).max())


def test_a_drifting_plate_feels_munk_s_moment_and_no_force() -> None:
    """d'Alembert, and the torque -(m_a - 0) v_n v_t L that turns a plate broadside."""
    mesh, _ = plate_rod(41, 0.5)
    x, v = mesh.rest_m.copy(), np.tile([0.3, 0.2], (41, 1))
    force = plate_forces(mesh, x, v, np.zeros_like(x))
    torque = (x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0]).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-15
    assert torque == pytest.approx(-0.5 * 0.1 * 0.3 * 0.2, rel=1e-12)


def test_a_tip_takes_out_what_stays_in_the_wake() -> None:
    """Power 1/2 m v_n^2 |v_t|, whichever way the tip moves; across it only where water leaves over it."""
    whole, none = plate_rod(11, 0.5, 1.0)[0], plate_rod(11, 0.5, 0.0)[0]
    x, still = whole.rest_m.copy(), np.zeros_like(whole.rest_m)
    for along in (-0.4, 0.0, 0.4):
        v = np.tile([along, 0.2], (11, 1))
        shed = plate_forces(whole, x, v, still) - plate_forces(none, x, v, still)
        assert not shed[:-1].any()
        assert shed[-1] == pytest.approx([-0.5 * 0.5 * 0.2**2, 0.5 * 0.2 * min(along, 0.0)], abs=1e-15)
        assert (shed * v).sum() == pytest.approx(-0.5 * 0.5 * 0.2**2 * abs(along), abs=1e-15)


def _robot_with_shedding_tips() -> tuple[Mesh, SymbolicFactorisation]:
    rods = prepare(plated(shedding=0.7))
    return rods.mesh, rods.symbolic


@pytest.mark.parametrize("rods", [_robot_with_shedding_tips(), plate_rod(9, 0.3, 1.0)], ids=["robot", "rod"])
def test_the_matrix_is_minus_the_derivative_by_all_three(
    rods: tuple[Mesh, SymbolicFactorisation],
) -> None:
    """By position, velocity and acceleration; the rod's edges are stored from their other end."""
    mesh, symbolic = rods
    x, v, a = state(mesh, 1)
    n, edges, still = len(x), edges_of(mesh, 1), lane_zeros((0, 1), 1)
    limbs = int(mesh.bend_column.max()) // 2
    add_forces(mesh, edges, x, v, np.zeros((1, 2 * limbs + 2)), 0, still, np.zeros_like(x))
    steps = unsymmetric_steps(symbolic, mesh.plate_edges)
    for which, change in ((0, 1e-8), (1, 1e-6), (2, 1e-3)):
        gains = [1.0 * (k == which) for k in range(3)]
        move, start = (a, np.zeros_like(a)) if which == 2 else (np.zeros_like(a), -a)
        diagonal, pair = np.zeros((n, 4)), np.zeros((len(symbolic.neighbour), 4))
        lower = np.zeros((symbolic.start[steps], 4))
        add_plate_stiffness(mesh, symbolic, edges, x, v, still, move, start, *gains, diagonal, pair, lower)
        found = dense(symbolic, diagonal, pair, lower)
        expected = np.empty_like(found)
        for column in range(2 * n):
            moved = np.zeros_like(x)
            moved.flat[column] = change
            up, down = (
                plate_forces(mesh, *(each + s * moved * (k == which) for k, each in enumerate((x, v, a))))
                for s in (1.0, -1.0)
            )
            expected[:, column] = (down - up).ravel() / (2.0 * change)
        assert found == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


@from_ci
def test_steps_of_plates_need_no_more_corrections() -> None:
    """Eight swims of each action in a batch: no step fails, so no lane has to continue alone."""
    box = ROBOT.library_box
    low, high = np.array([box.forward_mps, box.left_mps, box.omega_rad_s]).T
    velocity = np.random.default_rng(1).uniform(low, high, size=(8, 3))
    corrections = []
    for robot in (ROBOT, plated(), plated(shedding=1.0)):
        rods, found = prepare(robot), []
        for action in ROBOT.actions:
            batch = Batch([rods] * 8, np.zeros((8, 3)), velocity, 0.0, STEP_S, 8)
            for lane in range(8):
                lane_effects(robot, 8).fire_all(batch, lane, program_of(robot, action))
            batch.advance(ROBOT.period_s)
            assert batch._alone is None
            found.append(batch.corrections)
        corrections.append(np.array(found))
    plain, *plates = corrections
    for each in plates:
        assert each.sum() < 1.25 * plain.sum()
        assert each.max() < 1.4 * plain.max()


def _momenta(swimmer: Swimmer) -> np.ndarray:
    """Kirchhoff's: x, y (kg m/s) and about the origin (kg m^2/s)."""
    mesh, x, v = swimmer.rods.mesh, swimmer.nodes_world(), swimmer.node_velocities_world()
    p = mesh.mass_kg[:, None] * v + plate_momentum(mesh, x, v)
    return np.array([*p.sum(axis=0), (x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0]).sum()])


def _drift(step_s: float, shedding: float) -> np.ndarray:
    robot = without_drag(plated(shedding=shedding))
    swimmer = Swimmer(robot, velocity_body=(0.02, 0.01, 0.3), step_s=step_s, rods=prepare(robot))
    before = _momenta(swimmer)
    swimmer.fire(0, 0.0)
    swimmer.fire(2, 0.01)
    swimmer.advance(0.15)
    return _momenta(swimmer) - before


def test_strokes_keep_kirchhoff_s_momentum_without_drag() -> None:
    """The error is of second order. Momenta are 7 and 3 g m/s and 0.3 g m^2/s, of a limb up to 40 g m/s."""
    rough, fine = _drift(STEP_S, 0.0), _drift(0.5 * STEP_S, 0.0)
    assert np.abs(fine).max() < 1e-5
    assert np.abs(fine).max() < 0.35 * np.abs(rough).max()
    assert _drift(STEP_S, 1.0)[0] > 1e-3  # what tips leave behind moves the robot


def test_a_ringing_plate_keeps_its_energy() -> None:
    """Bent, let go, spinning and drifting, without drag: elastic and kinetic energy, the water's included."""
    mesh, symbolic = plate_rod(
        21, 0.2, mass_per_length=0.05, bending_n_m2=1e-3, stretching_n=1e3, natural_per_m=4.0
    )
    energies = []
    for step in (4e-4, 2e-4):
        batch = alone(mesh, symbolic, (0.05, 0.1, 2.0), step)
        values = []
        for k in range(60):
            x, v = batch.nodes_world()[0], batch.save(0).nodes[1]
            elastic = stretching_energy(mesh, x) + bending_energy(mesh, x, np.zeros(0), 0.0)
            values.append(elastic + kinetic_energy(mesh, v) + plate_energy(mesh, x, v))
            batch.advance((k + 1) * 2e-3)
        energies.append(np.array(values))
    rough, fine = (np.abs(each - each[0]).max() / each[0] for each in energies)
    assert fine < 0.01
    assert fine < 0.5 * rough


def test_strokes_converge_at_second_order() -> None:
    robot = plated(shedding=0.5)
    ends = []
    for step in (4.0 * STEP_S, 2.0 * STEP_S, STEP_S, 0.25 * STEP_S):
        swimmer = Swimmer(robot, step_s=step, rods=prepare(robot))
        for limb in range(4):
            swimmer.fire(limb, 0.08 * (limb // 2))
        swimmer.advance(0.6)
        ends.append(swimmer.pose_world()[0])
    errors = np.abs(np.array(ends[:3]) - ends[3])
    assert errors[1] < 0.4 * errors[0] and errors[2] < 0.4 * errors[1]
    assert errors[2] < 2e-3 * abs(ends[3])


def _swum(robot: Robot, width: int, lanes: int) -> np.ndarray:
    rods = prepare(robot)
    velocity = np.array([[0.01 * k, 0.0, 0.1 * k] for k in range(lanes)])
    batch: Batch = Batch([rods] * lanes, np.zeros((lanes, 3)), velocity, 0.0, STEP_S, width)
    for lane in range(lanes):
        for limb in range(4):
            batch.fire(lane, limb, 0.03 * limb)
    batch.advance(0.4)
    return batch.nodes_world()


def test_bits_depend_neither_on_the_width_nor_on_the_neighbours() -> None:
    robot = plated(shedding=0.5)
    assert np.array_equal(_swum(robot, 1, 1)[0], _swum(robot, 8, 5)[0])


def test_without_water_nothing_changes() -> None:
    assert np.array_equal(_swum(plated(added=0.0, shedding=1.0), 8, 2), _swum(ROBOT, 8, 2))


def test_a_uniform_current_carries_a_plate_along() -> None:
    """In water that moves evenly the same swim, moved with it."""
    from frogkick.der.water import Water

    ends = []
    for flow in ((0.0, 0.0), (0.02, -0.01)):
        robot = plated(shedding=0.5)
        swimmer = Swimmer(robot, velocity_body=(0.03 + flow[0], flow[1], 0.0), rods=prepare(robot))
        swimmer.set_water(Water(flow))
        swimmer.fire(1, 0.0)
        swimmer.advance(0.5)
        ends.append(swimmer.pose_world() - np.array([*flow, 0.0]) * 0.5)
    assert ends[1] == pytest.approx(ends[0], abs=1e-7)
