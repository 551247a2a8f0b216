"""The swimmer: symmetry, conservation, order, errors, firing, and the authors' own simulations."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import count
from tests.der.energy import bending_energy, stretching_energy
from tests.der.single import Swimmer, simulate_action, simulate_gait

from frogkick.core.errors import ConvergenceError, InputError
from frogkick.der import Rods, prepare
from frogkick.effects.swims import simulate_actions
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
RODS = prepare(ROBOT)


def test_a_new_swimmer_has_the_pose_and_velocity_given() -> None:
    swimmer = Swimmer(ROBOT, (1.5, -2.0, 2.5), (0.02, -0.01, 0.3), rods=RODS, time_s=7.0)
    assert swimmer.pose_world() == pytest.approx([1.5, -2.0, 2.5], abs=1e-12)
    assert swimmer.velocity_body() == pytest.approx([0.02, -0.01, 0.3], abs=1e-12)
    assert swimmer.nodes_world().shape == (128, 2)
    assert swimmer.time_s == 7.0


def test_rest_stays_at_rest() -> None:
    swimmer = Swimmer(ROBOT, rods=RODS)
    swimmer.advance(1.0)
    assert np.abs(swimmer.pose_world()).max() < 1e-9


@pytest.mark.parametrize(("action", "mirrored"), [("C", "D"), ("E", "F"), ("G", "H"), ("B", "B")])
def test_a_mirrored_action_gives_the_mirrored_motion(action: str, mirrored: str) -> None:
    one = np.array(simulate_action(ROBOT, (0.02, 0.015, 0.2), action, 0.7, rods=RODS))
    other = np.array(simulate_action(ROBOT, (0.02, -0.015, -0.2), mirrored, 0.7, rods=RODS))
    assert other * [1, -1, -1, 1, -1, -1] == pytest.approx(one, abs=1e-9)


def test_motion_does_not_depend_on_where_and_which_way() -> None:
    near = Swimmer(ROBOT, rods=RODS)
    far = Swimmer(ROBOT, (900.0, -700.0, 2.0), rods=RODS)
    for swimmer in (near, far):
        swimmer.fire_mask(0b0010, 0.0)
        swimmer.advance(0.5)
    dx, dy, turn = near.pose_world()
    c, s = math.cos(2.0), math.sin(2.0)
    expected = [900.0 + c * dx - s * dy, -700.0 + s * dx + c * dy, 2.0 + turn]
    assert far.pose_world() == pytest.approx(expected, abs=1e-8)
    assert far.velocity_body() == pytest.approx(near.velocity_body(), abs=1e-7)


def test_drag_alone_slows_a_swimmer_down() -> None:
    swimmer = Swimmer(ROBOT, velocity_body=(0.04, 0.02, 0.5), rods=RODS)
    energy = []
    for k in range(1, 21):
        swimmer.advance(0.1 * k)
        v = swimmer.node_velocities_world()
        kinetic = 0.5 * float(RODS.mesh.mass_kg @ (v * v).sum(axis=1))
        x = swimmer.nodes_world()
        elastic = stretching_energy(RODS.mesh, x) + bending_energy(RODS.mesh, x, np.zeros(4), 0.0)
        energy.append(kinetic + elastic)
    assert np.all(np.diff(energy) < 0.0)
    forward, left, omega = swimmer.velocity_body()
    assert 0.0 < forward < 0.04
    assert abs(left) < 0.02
    assert 0.0 < omega < 0.5


def test_a_stroke_swims_forward_and_turns_away_from_the_limb() -> None:
    forward, left, turn, *_ = simulate_action(ROBOT, (0.0, 0.0, 0.0), "B", ROBOT.period_s, rods=RODS)
    assert forward > 0.01
    assert abs(left) < 1e-9
    assert abs(turn) < 1e-9
    assert simulate_action(ROBOT, (0.0, 0.0, 0.0), "G", ROBOT.period_s, rods=RODS)[2] < -0.05
    assert simulate_action(ROBOT, (0.0, 0.0, 0.0), "H", ROBOT.period_s, rods=RODS)[2] > 0.05


def test_a_limb_fired_again_follows_the_larger_activation() -> None:
    def after(times: tuple[float, ...], until: float = 1.0) -> np.ndarray:
        swimmer = Swimmer(ROBOT, rods=RODS)
        for time in times:
            swimmer.fire_mask(0b0011, time)
        swimmer.advance(until)
        return swimmer.nodes_world()

    # Two strokes at once are one stroke, and the order of firing does not matter.
    assert np.array_equal(after((0.0, 0.0)), after((0.0,)))
    assert np.array_equal(after((0.3, 0.0)), after((0.0, 0.3)))
    # The second stroke keeps the limb straight for longer than the first alone would.
    tip = RODS.mesh.frame_nodes + ROBOT.limbs[0].segments - 1
    root = 0
    single, double = after((0.0,), 0.6), after((0.0, 0.35), 0.6)
    assert np.hypot(*(double[tip] - double[root])) > 1.2 * np.hypot(*(single[tip] - single[root]))


def test_after_its_profile_a_limb_is_at_rest_again() -> None:
    swimmer = Swimmer(ROBOT, rods=RODS)
    swimmer.fire(0, 0.0)
    swimmer.advance(3.0)
    assert bending_energy(RODS.mesh, swimmer.nodes_world(), np.zeros(4), 0.0) < 1e-6
    swimmer.fire(0, 3.0)
    swimmer.advance(3.05)
    assert bending_energy(RODS.mesh, swimmer.nodes_world(), np.zeros(4), 0.0) > 1e-4


def test_a_limb_fires_at_its_time_whatever_the_calls_between() -> None:
    one, many = (Swimmer(ROBOT, rods=RODS) for _ in range(2))
    for swimmer in (one, many):
        swimmer.fire_mask(0b1100, 0.0803)
    one.advance(0.4)
    for k in range(1, 41):
        many.advance(0.01 * k)
    assert many.pose_world() == pytest.approx(one.pose_world(), abs=2e-6)


def test_what_cannot_be_simulated_is_refused() -> None:
    with pytest.raises(InputError, match="phase"):
        simulate_gait(ROBOT, 10.0, 0.7, 1.0, 1)
    with pytest.raises(InputError, match="cycles"):
        simulate_gait(ROBOT, 10.0, 0.7, 0.5, 0)
    with pytest.raises(InputError, match="measured are"):
        simulate_gait(ROBOT, 10.0, 2.0, 0.5, 1)
    with pytest.raises(InputError, match="no action"):
        simulate_actions(ROBOT, [])


def test_a_step_that_does_not_converge_is_an_error_with_the_state() -> None:
    swimmer = Swimmer(ROBOT, velocity_body=(0.0, 0.0, 1e160), rods=RODS)
    with pytest.raises(ConvergenceError, match=r"did not converge at .*pose .*velocity"):
        swimmer.advance(0.1)


def test_a_hard_step_is_halved_until_it_converges() -> None:
    """A step of 0.2 s over a whole pulse does not converge; halved, it ends near the result of fine steps."""
    coarse, fine = (Swimmer(ROBOT, rods=RODS, velocity_body=(0, 0, 30.0), step_s=s) for s in (0.2, 0.002))
    for swimmer in (coarse, fine):
        swimmer.fire_mask(0b1111, 0.0)
        swimmer.advance(0.2)
    assert np.isfinite(coarse.pose_world()).all()
    assert coarse.pose_world()[:2] == pytest.approx(fine.pose_world()[:2], abs=0.02)


def test_a_row_of_actions_goes_on_where_the_last_ended() -> None:
    row = simulate_actions(ROBOT, ["B", "C"], (0.02, 0.0, 0.0))
    first = simulate_action(ROBOT, (0.02, 0.0, 0.0), "B", ROBOT.period_s, rods=RODS)
    at_period = int(np.argmin(np.abs(row.time_s - ROBOT.period_s)))
    assert row.pose_world[at_period, 0] == pytest.approx(first[0], abs=2e-4)
    assert row.time_s[-1] == pytest.approx(2 * ROBOT.period_s)
    assert row.distance_m > row.pose_world[at_period, 0]
    assert row.speed_mps == pytest.approx(row.distance_m / row.time_s[-1])


def test_cost_of_transport_is_that_of_the_paper() -> None:
    """158 at 10 % EGaIn and 0.4 Hz, phase 0.5 (Huang 2022)."""
    gait = simulate_gait(ROBOT, 10.0, 0.4, 0.5, 8)
    assert gait.cost_of_transport == pytest.approx(158.0, rel=0.05)
    assert gait.time_s[0] == 0.0
    assert np.abs(gait.pose_world[:, 2]).max() < 1e-6
    assert np.abs(gait.pose_world[:, 1]).max() < 1e-6
    assert gait.distance_m == pytest.approx(gait.pose_world[-1, 0] - gait.pose_world[0, 0])


def reference_speed(file: Path, frequency_hz: float) -> float:
    rows = np.loadtxt(file)
    start, end = np.interp([5 / frequency_hz, 8 / frequency_hz], rows[:, 0], rows[:, 2])
    return float(end - start) / (3 / frequency_hz)


@pytest.mark.parametrize(
    ("group", "limit_mmps"),
    [("freq/0", 0.6), ("freq/10", 1.2), ("freq/30", 1.0), ("freq/40", 1.6), ("phase/10_0dot4Hz", 1.2),
     ("phase/10_0dot8Hz", 1.2)],
)  # fmt: skip
def test_speeds_are_those_of_the_authors_simulations(
    frog2022_dir: Path, group: str, limit_mmps: float
) -> None:
    files = sorted((frog2022_dir / "sim" / group).glob("*.txt"))
    assert files
    errors = []
    for file in files[:: count(3, 1, 6)]:
        found = re.search(r"phaseDelay_([\d.]+)_frequency_([\d.]+)_EGaIn_([\d.]+)\.txt", file.name)
        assert found is not None
        phase, frequency, egain = (float(v) for v in found.groups())
        model = simulate_gait(ROBOT, egain, frequency, phase, 8).speed_mps
        errors.append(1000.0 * (model - reference_speed(file, frequency)))
    assert np.sqrt(np.mean(np.square(errors))) < limit_mmps, np.round(errors, 2)


def test_rods_can_be_shared_and_are_not_changed() -> None:
    before = [np.array(v).copy() for v in RODS.mesh]
    simulate_action(ROBOT, (0.0, 0.0, 0.0), "C", 0.1, rods=RODS)
    assert all(np.array_equal(a, b) for a, b in zip(before, RODS.mesh, strict=True))
    assert isinstance(RODS, Rods)
