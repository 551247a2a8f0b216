"""Many simulations side by side: each the same as alone, failures kept apart, poses at any time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.conftest import count
from tests.der.single import Swimmer, simulate_action, simulate_gait

from frogkick.core.errors import InputError
from frogkick.der import Batch, prepare
from frogkick.der.batch import run_steps, set_accelerations
from frogkick.der.body import SUMS, place_nodes
from frogkick.der.stepping import FACTOR_EVERY, RESIDUAL_LIMIT, SCHEMES, Nodes, workspace_of
from frogkick.effects.acting import program_of
from frogkick.effects.swims import Gait, Motions, Trajectory, simulate_gaits, simulate_many
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
RODS = prepare(ROBOT)
LANES = 11
END_S = 0.5


def some(seed: int = 1) -> tuple[np.ndarray, list[list[tuple[float, int]]]]:
    rng = np.random.default_rng(seed)
    velocity = rng.uniform([0.0, -0.03, -0.5], [0.04, 0.03, 0.5], size=(LANES, 3))
    return velocity, [program_of(ROBOT, ROBOT.actions[k % 9], 0.01 * (k // 9)) for k in range(LANES)]


def run(chosen: list[int], width: int, step_s: float = 0.002) -> Motions:
    velocity, programs = some()
    return simulate_many(
        RODS, velocity[chosen], [programs[k] for k in chosen], [0.2, END_S], step_s=step_s, width=width
    )


def test_bits_depend_neither_on_the_width_nor_on_the_neighbours() -> None:
    alone = [run([k], 1) for k in range(LANES)]
    order = np.random.default_rng(3).permutation(LANES).tolist()
    rare = [(4, order), (2, order), (16, order)][: count(1, 3, 0)]  # each width takes ten seconds to compile
    for width, chosen in ((1, order), (8, order), (8, [5]), (8, [7, 5]), *rare):
        together = run(chosen, width)
        for lane, k in enumerate(chosen):
            assert np.array_equal(together.pose_world[lane], alone[k].pose_world[0])
            assert np.array_equal(together.velocity_body[lane], alone[k].velocity_body[0])


def test_a_lane_is_a_swimmer() -> None:
    velocity, programs = some()
    motions = run([4], 8)
    swimmer = Swimmer(ROBOT, velocity_body=velocity[4].tolist(), rods=RODS, step_s=0.002)
    for time, mask in programs[4]:
        swimmer.fire_mask(mask, time)
    swimmer.advance(END_S)
    # A swimmer moves its origin along after each advance, which rounds.
    assert swimmer.pose_world() == pytest.approx(motions.pose_world[0, -1], abs=1e-14)
    assert swimmer.velocity_body() == pytest.approx(motions.velocity_body[0, -1], abs=1e-14)


def test_one_action_is_a_lane_of_many() -> None:
    velocity, _ = some()
    row = simulate_action(ROBOT, velocity[2].tolist(), "C", END_S, rods=RODS)
    motions = simulate_many(RODS, velocity, [program_of(ROBOT, ROBOT.action("C"))] * LANES, [END_S])
    assert np.array_equal(motions.pose_world[2, -1], row[:3])
    assert np.array_equal(motions.velocity_body[2, -1], row[3:])


def test_a_failing_lane_is_reported_with_its_state_and_the_rest_goes_on() -> None:
    velocity, programs = some()
    whole = simulate_many(RODS, velocity, programs, [END_S], step_s=0.002)
    velocity[3] = (0.01, 0.0, 1e160)
    velocity[9] = (0.0, 1e155, 0.0)
    motions = simulate_many(RODS, velocity, programs, [END_S], step_s=0.002)
    assert sorted(motions.failures) == [3, 9]
    failure = motions.failures[3]
    assert failure.time_s == 0.0
    assert failure.velocity_body[2] == pytest.approx(1e160)
    assert "did not converge at 0.000000 s" in str(failure)
    assert np.isnan(motions.pose_world[[3, 9]]).all()
    others = [k for k in range(LANES) if k not in (3, 9)]
    assert np.array_equal(motions.pose_world[others], whole.pose_world[others])


def test_the_residual_of_a_step_that_failed_is_over_the_force_scale() -> None:
    mesh, work = RODS.mesh, workspace_of(RODS.mesh, RODS.symbolic, 1)
    x_m, v_mps = place_nodes(mesh, np.zeros(1), np.array([[0.0, 0.0, 300.0]]))
    nodes = Nodes(x_m[..., 0].copy(), v_mps[..., 0].copy(), np.zeros_like(mesh.rest_m))
    active, report = np.zeros((1, 2 * mesh.limbs + 2)), np.zeros((3, 1))
    step_s, still, untold = np.array([[0.2]]), np.empty((0, 1)), np.empty((0, SUMS))
    fixed = (mesh, RODS.symbolic, work, SCHEMES[ROBOT.integrator])
    run_steps(*fixed, nodes, step_s, active, still, FACTOR_EVERY, report, untold)
    assert report[0, 0] == 0.0
    left = math.sqrt(float((work.force_n**2).sum())) / mesh.force_scale_n
    assert left > RESIDUAL_LIMIT
    assert report[1, 0] == pytest.approx(left, rel=1e-12)


def test_backward_euler_balances_forces_at_the_end_of_the_step() -> None:
    mesh, work = RODS.mesh, workspace_of(RODS.mesh, RODS.symbolic, 1)
    x_m, v_mps = place_nodes(mesh, np.zeros(1), np.array([[0.03, 0.01, 0.5]]))
    start = v_mps[..., 0].copy()
    nodes = Nodes(x_m[..., 0].copy(), start.copy(), np.zeros_like(mesh.rest_m))
    active, report = np.zeros((1, 2 * mesh.limbs + 2)), np.zeros((3, 1))
    active[0, 0:2] = 0.3, 5.0
    step_s, still, untold = np.array([[0.001]]), np.empty((0, 1)), np.empty((0, SUMS))
    fixed = (mesh, RODS.symbolic, work, SCHEMES["backward-euler"])
    run_steps(*fixed, nodes, step_s, active, still, FACTOR_EVERY, report, untold)
    assert report[0, 0] == -1.0
    assert nodes.v_mps == pytest.approx((nodes.x_m - x_m[..., 0]) / 0.001, abs=1e-12)
    end = Nodes(nodes.x_m.copy(), nodes.v_mps.copy(), np.zeros_like(mesh.rest_m))
    set_accelerations(mesh, work, end, active, still)
    missed = mesh.mass_kg[:, None] * (end.a_mps2 - (nodes.v_mps - start) / 0.001)
    assert np.sqrt((missed**2).sum()) < 2.0 * RESIDUAL_LIMIT * mesh.force_scale_n


def test_a_hard_step_is_cut_in_one_lane_only() -> None:
    """A step over a whole pulse at 30 rad/s is bisected; the result is near that of fine steps."""
    velocity = np.array([[0.0, 0.0, 30.0], [0.02, 0.0, 0.1], [0.0, 0.0, 0.0]])
    programs = [[(0.0, 0b1111)], [], [(0.1, 0b0001)]]
    coarse = simulate_many(RODS, velocity, programs, [0.1, 0.2], step_s=0.2)
    fine = simulate_many(RODS, velocity, programs, [0.1, 0.2], step_s=0.001)
    assert not coarse.failures
    assert coarse.pose_world[0, -1, :2] == pytest.approx(fine.pose_world[0, -1, :2], abs=0.02)
    again = simulate_many(RODS, velocity[:1], programs[:1], [0.1, 0.2], step_s=0.2, width=1)
    assert np.array_equal(again.pose_world[0], coarse.pose_world[0])


def test_a_failed_lane_stands_still_and_its_batch_can_go_on() -> None:
    velocity = np.array([[0.02, 0.0, 0.0], [0.0, 0.0, 1e160]])
    batch = Batch([RODS] * 2, np.zeros((2, 3)), velocity, 0.0, 0.001)
    for until in (0.1, 0.2):
        batch.advance(until)
    assert batch.time_s.tolist() == [0.2, 0.0]
    assert list(batch.failures) == [1]
    assert 0.0 < batch.pose_world()[0, 0] < 0.004


def test_told_times_change_no_step() -> None:
    velocity, programs = some()
    ends = simulate_many(RODS, velocity, programs, [END_S])
    often = simulate_many(RODS, velocity, programs, np.linspace(0.01, END_S, 50))
    assert np.array_equal(often.pose_world[:, -1], ends.pose_world[:, -1])
    assert np.array_equal(often.velocity_body[:, -1], ends.velocity_body[:, -1])


def test_told_poses_are_those_at_that_time() -> None:
    velocity, programs = some()
    times = np.arange(1, 21) * 0.025
    motions = simulate_many(RODS, velocity, programs, times)
    for k in (1, 2):
        swimmer = Swimmer(ROBOT, velocity_body=velocity[k].tolist(), rods=RODS)
        for time, mask in programs[k]:
            swimmer.fire_mask(mask, time)
        for at, time in enumerate(times):
            swimmer.advance(float(time))
            assert swimmer.pose_world()[:2] == pytest.approx(motions.pose_world[k, at, :2], abs=2e-6)
            assert swimmer.pose_world()[2] == pytest.approx(motions.pose_world[k, at, 2], abs=5e-5)
            assert swimmer.velocity_body()[:2] == pytest.approx(motions.velocity_body[k, at, :2], abs=2e-5)


def test_a_turning_robot_s_heading_is_continuous() -> None:
    motions = simulate_many(RODS, np.array([[0.0, 0.0, 30.0]]), [[]], np.linspace(0.02, 1.0, 50))
    heading = motions.pose_world[0, :, 2]
    assert heading[-1] > 2.0 * np.pi
    assert np.all(np.diff(heading) > 0.0)


def test_gaits_side_by_side_are_those_alone() -> None:
    gaits = [Gait(10.0, 0.7, 0.5), Gait(30.0, 1.33, 0.21), Gait(0.0, 0.4, 0.0)]
    together = simulate_gaits(ROBOT, gaits, 2, step_s=0.002)
    for gait, result in zip(gaits, together, strict=True):
        one = simulate_gait(ROBOT, gait.egain_percent, gait.frequency_hz, gait.phase, 2, step_s=0.002)
        assert isinstance(result, Trajectory)
        assert result.speed_mps == one.speed_mps
        for name in ("time_s", "pose_world", "velocity_body"):
            assert np.array_equal(getattr(result, name), getattr(one, name))


def test_what_cannot_be_simulated_is_refused() -> None:
    velocity, programs = some()
    with pytest.raises(InputError, match="11 programs"):
        simulate_many(RODS, velocity[:3], programs, [1.0])
    with pytest.raises(InputError, match="finite"):
        simulate_many(RODS, velocity * np.nan, programs, [1.0])
    for times in ([], [0.0], [0.2, 0.1], [-1.0], [np.nan]):
        with pytest.raises(InputError, match="increase"):
            simulate_many(RODS, velocity, programs, times)
    with pytest.raises(InputError, match="positive"):
        simulate_many(RODS, velocity, programs, [1.0], step_s=0.0)
