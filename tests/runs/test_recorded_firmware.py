"""The paper's recorded runs through the whole firmware: fixes in, strokes out, compared with the twin."""

from __future__ import annotations

import pathlib
from collections.abc import Sequence

import pytest
from tests.conftest import count, from_ci
from tests.runs import rig

from frogkick.link.frames import Frame
from frogkick.link.wire import Edge, RobotPort
from frogkick.planner.plan import PlanConfig
from frogkick.pool.monitor import pulses_of, violations
from frogkick.runs.decision import Decision
from frogkick.runs.recorded.importer import load_run
from frogkick.runs.replay import Replay, replay
from frogkick.runs.runlog import RunLog

RUNS = ("line1", "sin1", "sin3", "ellipse1", "ellipse3", "ellipse5", "ellipse6")
GAP_US = 1_000  # FK_STROKE_GAP_US
LATE_US = (
    2300.0  # of a pin on the chip: its clock begins 1 ms after power-on, and loops come round; beside plan_us
)


class Watched:
    """A port that records the pin edges and frames of a robot."""

    def __init__(self, robot: RobotPort) -> None:
        self.robot = robot
        self.pins: list[Edge] = []
        self.words: list[Frame] = []
        self.time_s = 0.0

    def send(self, encoded: bytes, at_s: float) -> None:
        self.robot.send(encoded, at_s)

    def advance(self, until_s: float) -> None:
        self.robot.advance(until_s)
        self.time_s = until_s

    def frames(self) -> list[tuple[float, Frame]]:
        frames = self.robot.frames()
        self.words += [frame for _, frame in frames]
        return frames

    def edges(self) -> list[Edge]:
        seen = self.robot.edges()
        self.pins += seen
        return seen


def swum_again(data: pathlib.Path, name: str, place: str, depth: int) -> tuple[RunLog, Watched, Replay]:
    run = load_run(data / "control" / f"{name}.csv")
    port = Watched(rig.port(place))
    result = replay(run, rig.tables(), PlanConfig(depth=depth), port, host=True)
    port.edges()
    return run, port, result


def wanted(decisions: Sequence[Decision], refused_us: set[int], end_us: int) -> list[tuple[int, int, int]]:
    """(time, limb, decision) of the pulses that decisions ask for: first limbs, then the others."""
    tables, found = rig.tables(), []
    for number, decision in enumerate(decisions):
        row = tables.actions[decision.action]
        if decision.scheduled_us in refused_us:
            continue
        later_us = decision.scheduled_us + tables.second_delay_us + GAP_US
        for mask, at_us in ((row.first_mask, decision.scheduled_us), (row.second_mask, later_us)):
            if at_us < end_us:
                found += [(at_us, limb, number) for limb in range(8) if mask >> limb & 1]
    return found


def check_strokes(port: Watched, result: Replay, late_us: float) -> int:
    """Compare the pins with the twin's decisions; return the number of pulses."""
    refusals = {int(frame.values["begin_us"]) for frame in port.words if frame.name == "REFUSED"}
    ended = [frame for frame in port.words if frame.name == "ENDED"]
    decided = {decision.scheduled_us for decision in result.host}
    assert refusals <= decided
    # A run that ends with a decision begins no stroke by it: the next run's first decision does.
    over = {
        result.onboard[number].scheduled_us
        for number in range(len(result.onboard))
        if result.onboard[number].status == 0 and number in ends_of(port)
    }
    asked = wanted(result.host, refusals | over, round(port.time_s * 1e6))
    # The core on this computer knows whole microseconds; the chip's pins do not.
    digits = 0 if late_us == 0.0 else 3
    highs = sorted((round(edge.time_s * 1e6, digits), edge.limb) for edge in port.pins if edge.level)
    assert len(ended) >= len(over)
    assert [limb for _, limb, _ in asked] == [limb for _, limb in highs]
    for (at_us, _, number), (seen_us, _) in zip(asked, highs, strict=True):
        plan_us = result.onboard[number].plan_us
        assert 0.0 <= seen_us - at_us <= late_us + plan_us, f"decision {number}"
    pulses = pulses_of(port.pins, port.time_s)
    pulse_s = rig.tables().pulse_us * 1e-6
    assert all(abs(pulse.end_s - pulse.start_s - pulse_s) <= 2e-6 for pulse in pulses[:-4])
    assert violations(rig.robot(), pulses) == []
    return len(highs)


def ends_of(port: Watched) -> set[int]:
    """Indices, over all runs, of the decisions that ended a run."""
    found, number = set(), -1
    for frame, following in zip(port.words, [*port.words[1:], None], strict=True):
        if frame.name == "DECISION":
            number += 1
            if following is not None and following.name == "ENDED":
                found.add(number)
    return found


@pytest.mark.parametrize("name", RUNS)
def test_strokes_are_those_that_the_twin_decides(frog2022_dir: pathlib.Path, name: str) -> None:
    run, port, result = swum_again(frog2022_dir, name, "pool", count(1, 3))
    assert result.differences == []
    assert len(result.host) == len(run.decisions)
    assert check_strokes(port, result, 0.0) > len(run.decisions)


@from_ci
@pytest.mark.parametrize("name", RUNS[: count(1, len(RUNS))])
def test_strokes_on_the_chip(frog2022_dir: pathlib.Path, name: str) -> None:
    _, port, result = swum_again(frog2022_dir, name, "virtual", 2)
    assert result.differences == []
    assert check_strokes(port, result, LATE_US) > len(result.host)
