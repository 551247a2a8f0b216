"""The rods in motion: frequencies, drag, inertia, balances of energy and momentum, order of convergence."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from tests.conftest import count, from_ci
from tests.der.energy import bending_energy, drag_power, kinetic_energy, stretching_energy
from tests.der.rig import STILL, straight_rod
from tests.der.single import Swimmer, simulate_action

from frogkick.der import STEP_S, Batch, Rods, prepare
from frogkick.der.mesh import Mesh
from frogkick.der.schedule import COARSEST_AT_REST
from frogkick.der.solve import SymbolicFactorisation
from frogkick.effects.swims import Gait, Trajectory, simulate_gaits
from frogkick.robot import Robot, load_robot

ROBOT = load_robot("frog2022")
RODS = prepare(ROBOT)


def alone(
    mesh: Mesh,
    symbolic: SymbolicFactorisation,
    velocity_body: tuple[float, float, float],
    step_s: float,
    heading: float = 0.0,
) -> Batch:
    """One rod without limbs, in equal steps."""
    pose = np.array([[0.0, 0.0, heading]])
    rods = Rods(ROBOT, mesh, symbolic, (STILL,) * len(ROBOT.limbs))
    return Batch([rods], pose, np.array([velocity_body]), 0.0, step_s / COARSEST_AT_REST, width=1)


def test_a_free_rod_vibrates_at_its_textbook_frequency() -> None:
    """First bending mode of a free rod, 4.730^2 / (2 pi L^2) sqrt(EI / mu); drag keeps still."""
    length, stiff, mu, nodes = 0.1, 1e-3, 0.05, 41
    mesh, symbolic = straight_rod(
        nodes, length, mass_per_length=mu, bending_n_m2=stiff, stretching_n=1e3, natural_per_m=0.05
    )  # it is let go from straight, a little off its natural arc
    textbook = 4.730041**2 / (2.0 * math.pi * length**2) * math.sqrt(stiff / mu)
    step = 1.0 / textbook / 100.0
    batch = alone(mesh, symbolic, (0.0, 0.0, 0.0), step)
    bulge = []
    for k in range(1, 1200):
        batch.advance(k * step)
        nodes_m = batch.nodes_world()[0]
        bulge.append(nodes_m[nodes // 2, 1] - 0.5 * (nodes_m[0, 1] + nodes_m[-1, 1]))
    y = np.array(bulge) - np.mean(bulge)
    up = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    crossing = (up + y[up] / (y[up] - y[up + 1])) * step
    frequency = (len(crossing) - 1) / (crossing[-1] - crossing[0])
    assert frequency == pytest.approx(textbook, rel=5e-3)
    first, last = np.abs(y[:100]).max(), np.abs(y[-100:]).max()
    assert 0.85 * first < last <= 1.01 * first  # hardly damped by the integrator


@pytest.mark.parametrize("added", [0.0, 0.3])
def test_a_coasting_rod_slows_as_it_should(added: float) -> None:
    """dv/dt = -c v^2 / m gives v = v0 / (1 + k t), x = v0 log(1 + k t) / k with k = c v0 / m."""
    drag, mu, start = 10.0, 0.5 + added, 0.05
    mesh, symbolic = straight_rod(21, 0.1, mass_per_length=mu, drag_normal=drag, bending_n_m2=1e-2)
    batch = alone(mesh, symbolic, (0.0, start, 0.0), 0.008, heading=0.7)
    batch.advance(2.0)
    rate = drag * start / mu
    forward, left, turn = batch.velocity_body()[0]
    assert left == pytest.approx(start / (1.0 + 2.0 * rate), rel=1e-4)
    assert forward == pytest.approx(0.0, abs=1e-12)
    assert turn == pytest.approx(0.0, abs=1e-9)
    drift = start * math.log(1.0 + 2.0 * rate) / rate
    x, y, heading = batch.pose_world()[0]
    assert (x, y) == pytest.approx((-drift * math.sin(0.7), drift * math.cos(0.7)), rel=1e-4)
    assert heading == pytest.approx(0.7, abs=1e-9)


def test_added_mass_is_inertia_and_weighs_nothing() -> None:
    heavier = replace(
        ROBOT,
        limbs=tuple(
            replace(
                limb,
                mass_per_length_kg_per_m=limb.mass_per_length_kg_per_m - 0.005,
                added_mass_per_length_kg_per_m=limb.added_mass_per_length_kg_per_m + 0.005,
            )
            for limb in ROBOT.limbs
        ),
    )
    assert np.allclose(prepare(heavier).mesh.mass_kg, RODS.mesh.mass_kg, rtol=1e-12)
    assert heavier.mass_kg == pytest.approx(ROBOT.mass_kg - 4 * 0.0355 * 0.005)
    more = replace(
        ROBOT,
        limbs=tuple(
            replace(limb, added_mass_per_length_kg_per_m=limb.added_mass_per_length_kg_per_m + 0.03)
            for limb in ROBOT.limbs
        ),
    )
    plain, slow = (simulate_action(robot, (0.0, 0.0, 0.0), "B", 0.1) for robot in (ROBOT, more))
    assert slow[3] != pytest.approx(plain[3], rel=0.02)


def without_water(robot: Robot) -> Robot:
    frame = replace(robot.frame, drag_normal=0.0, drag_tangential=0.0)
    limbs = tuple(replace(limb, drag_normal=0.0, drag_tangential=0.0) for limb in robot.limbs)
    return replace(robot, frame=frame, limbs=limbs)


def momentum(swimmer: Swimmer) -> np.ndarray:
    """Linear (N s) and angular (N m s) momentum about the world's origin."""
    mass, x, v = swimmer.rods.mesh.mass_kg, swimmer.nodes_world(), swimmer.node_velocities_world()
    return np.array([*(mass @ v), mass @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])])


def test_momentum_is_conserved_without_water() -> None:
    swimmer = Swimmer(without_water(ROBOT), velocity_body=(0.03, -0.01, 0.4))
    before = momentum(swimmer)
    swimmer.fire_mask(0b0111, 0.02)
    swimmer.advance(0.4)
    after = momentum(swimmer)
    assert after[:2] == pytest.approx(before[:2], abs=1e-12)
    # The scheme conserves angular momentum to its order only; that of a stroke alone is about 1e-4 N m s.
    assert after[2] == pytest.approx(before[2], abs=1e-7)
    assert np.abs(swimmer.nodes_world() - swimmer.rods.mesh.rest_m).max() > 0.01  # it did move


def energy_gap(step_s: float, sample_s: float) -> tuple[float, float]:
    """What is missing from the balance of energy over two strokes, and the work that the limbs did, J."""
    mesh, stroke = RODS.mesh, RODS.strokes[0]
    swimmer = Swimmer(ROBOT, velocity_body=(0.03, 0.01, 0.2), rods=RODS, step_s=step_s)
    swimmer.fire_mask(0b0011, 0.0)
    swimmer.fire_mask(0b1100, 0.08)
    table_s = np.arange(len(stroke.activation)) * stroke.step_s

    def active(time_s: float) -> np.ndarray:
        first, second = np.interp([time_s, time_s - 0.08], table_s, stroke.activation, 0.0, 0.0)
        return np.array([first, first, second, second])

    def bending(x: np.ndarray, time_s: float) -> float:
        return bending_energy(mesh, x, active(time_s), stroke.drop_per_m)

    def held(x: np.ndarray, v: np.ndarray, time_s: float) -> float:
        return stretching_energy(mesh, x) + bending(x, time_s) + kinetic_energy(mesh, v)

    x, v, now = swimmer.nodes_world(), swimmer.node_velocities_world(), 0.0
    gap, work = held(x, v, now), 0.0
    for k in range(1, round(0.6 / sample_s) + 1):
        then = k * sample_s
        swimmer.advance(then)
        y, w = swimmer.nodes_world(), swimmer.node_velocities_world()
        # Work is what changing the limbs' natural shape adds, in the mean of both ends of the interval.
        work += 0.5 * (bending(x, then) - bending(x, now) + bending(y, then) - bending(y, now))
        gap -= 0.5 * sample_s * (drag_power(mesh, x, v) + drag_power(mesh, y, w))
        x, v, now = y, w, then
    return held(x, v, now) - gap - work, work


def test_work_in_is_work_out() -> None:
    """Work by the limbs = energy held + work of drag: to 0.2 % at the default step, quadratic in it."""
    gap, work = energy_gap(0.001, 0.001)
    assert work > 0.005
    assert abs(gap) < 2e-3 * work
    finer, _ = energy_gap(0.0005, 0.0005)
    assert abs(finer) < 0.4 * abs(gap)


def orders(errors: list[float]) -> list[float]:
    return [math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)]


@pytest.mark.parametrize("action", ["A", "B", "C", "E", "G"])
def test_actions_converge_at_second_order(action: str) -> None:
    """The default step errs by less than 0.2 % of the distance, and half the step by a quarter."""

    def end(step_s: float) -> np.ndarray:
        return np.array(
            simulate_action(ROBOT, (0.01, 0.005, 0.1), action, ROBOT.period_s, step_s=step_s, rods=RODS)
        )

    reference = end(0.000125)
    errors = [float(np.hypot(*(end(step) - reference)[:2])) for step in (4 * STEP_S, 2 * STEP_S, STEP_S)]
    assert errors[-1] < 2e-3 * np.hypot(*reference[:2])
    assert all(1.6 < order < 2.6 for order in orders(errors))


@from_ci
def test_gaits_converge_at_second_order() -> None:
    """Over many strokes too, at any frequency and phase: 0.2 % at the default step, and the order."""
    rng = np.random.default_rng(4)
    gaits = [Gait(10.0, 0.7, 0.5), Gait(30.0, 1.3, 0.5), Gait(10.0, 1.0, 0.0), Gait(0.0, 0.4, 0.2)]
    for _ in range(count(4, 28)):
        egain, low, high = [(0.0, 0.4, 1.1), (10.0, 0.4, 1.2), (20.0, 0.4, 1.4), (30.0, 0.7, 1.4)][
            rng.integers(4)
        ]
        gaits.append(Gait(egain, float(rng.uniform(low, high)), float(rng.uniform(0.0, 0.99))))

    cycles = count(8, 8, 4)

    def speeds(step_s: float) -> np.ndarray:
        results = simulate_gaits(ROBOT, gaits, cycles, step_s=step_s)
        return np.array([r.speed_mps for r in results if isinstance(r, Trajectory)])

    reference = speeds(0.00025)
    assert len(reference) == len(gaits)
    errors = [speeds(step) / reference - 1.0 for step in (0.004, 0.002, 0.001)]
    assert np.abs(errors[-1]).max() < 2e-3
    overall = [float(np.sqrt(np.mean(error**2))) for error in errors]
    assert all(1.5 < order < 3.0 for order in orders(overall))
