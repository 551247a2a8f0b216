"""Snapshots: a whole one goes on to the same, and what is damaged is refused before it is used."""

from __future__ import annotations

import itertools
import random
from typing import Any

import pytest
from tests.core.core import ACTION, FFI, Robot, cases, image
from tests.core.log_rig import fetched, robot_with_log
from tests.core.test_core_log_replay import live, run

from frogkick.link.layout import Value, link_layout
from frogkick.runs.chip_twin import ChipTwin, SnapshotError
from frogkick.tables.image import open_image

STATE = link_layout().state


def snapshot_of(robot: Robot) -> bytes:
    parts = [r for r in fetched(robot).records()[0] if r.name == "SNAPSHOT"]
    last = max(i for i, record in enumerate(parts) if record.values["part"] == 0)
    return b"".join(record.rest for record in parts[last:])


def restored(snapshot: bytes, robot: Robot | None = None) -> int:
    robot = robot_with_log()[0] if robot is None else robot
    return int(robot.core.fk_robot_restore(robot.memory, snapshot, len(snapshot)))


def test_a_snapshot_of_another_length_is_refused() -> None:
    snapshot = snapshot_of(run(9, 10.0))
    assert restored(snapshot) == 0
    assert restored(snapshot + b"\0") == -1
    for size in range(0, len(snapshot), 97):
        assert restored(snapshot[:size]) == -1


FIX: dict[str, Value] = {
    "fix_sequence": 9, "quality": 1, "capture_age_us": 1000, "x_m": 0.1, "y_m": 0.0, "heading_rad": 0.0,
}  # fmt: skip


def test_no_damaged_snapshot_leads_out_of_memory() -> None:
    """Any bytes are taken or refused; what is taken can be lived with."""
    robot = run(9, 10.0)
    snapshot, then_us = snapshot_of(robot), robot.now_us
    dice, refused, many = random.Random(3), 0, max(800, cases(2000, 100_000))
    for _ in range(many):
        spoilt = bytearray(snapshot)
        for _ in range(dice.randint(1, 5)):
            spoilt[dice.randrange(len(spoilt))] = dice.choice((0, 1, 255, dice.randrange(256)))
        if restored(bytes(spoilt), robot):
            refused += 1
            continue
        robot.now_us = then_us
        for _ in range(3):
            robot.post("FIX", FIX)
            robot.take()
            robot.tick(robot.now_us + 700_000)
    assert 0 < refused < many


DAMAGE = {
    "a path of one point": lambda r: (points_of(r, "path", 1, 1),),
    "a coming path of one point": lambda r: (points_of(r, "coming", 1, 1),),
    "more points than the path has": lambda r: (points_of(r, "path", 5, 4),),
    "more points than any path has": lambda r: (points_of(r, "path", 101, 101),),
    "a run without a path": lambda r: (points_of(r, "path", 0, 0), setattr(r, "state", STATE["RUNNING"])),
    "a run along half a path": lambda r: (points_of(r, "path", 3, 20), setattr(r, "state", STATE["RUNNING"])),
    "a place beyond the path": lambda r: setattr(r.follow, "along_points", 19.5),
    "a place before the path": lambda r: setattr(r.follow, "along_points", -0.5),
    "a place that is no number": lambda r: setattr(r.follow, "along_points", float("nan")),
    "a point that is no number": lambda r: r.path.x_m.__setitem__(3, float("nan")),
    "a point beyond the field": lambda r: r.path.y_m.__setitem__(19, -1e4),
    "a direction that is no angle": lambda r: r.path.tangent_rad.__setitem__(0, float("inf")),
    "a fault": lambda r: setattr(r, "state", STATE["FAULT"]),
    "no depth": lambda r: setattr(r.plan, "depth", 0),
    "a depth beyond all": lambda r: setattr(r.plan, "depth", 5),
    "no such cost": lambda r: setattr(r.plan, "cost", 2),
    "no limit of the search": lambda r: setattr(r.plan, "transitions_max", 0),
    "a weight that is no number": lambda r: setattr(r.plan, "look_ahead_m", float("nan")),
    "a period shorter than a stroke": lambda r: setattr(r, "period_us", 100_000),
    "no such stroke": lambda r: setattr(r, "stroke_request", len(ACTION) + 2),
    "limbs that there are none": lambda r: setattr(r, "second_mask", 0b1_0000),
    "one instant": lambda r: setattr(r.estimator.track, "count", 1),
    "more instants than there are": lambda r: setattr(r.estimator.track, "count", 5),
    "an instant before the one before it": lambda r: r.estimator.track.time_us.__setitem__(1, 0),
    "two instants at a time": lambda r: r.estimator.track.time_us.__setitem__(
        1, r.estimator.track.time_us[0]
    ),
    "no such action": lambda r: r.estimator.track.action.__setitem__(0, len(ACTION) + 1),
    "a use beyond the most": lambda r: r.estimator.track.limb_use[1].__setitem__(0, 32768),
    "more lessons than count": lambda r: setattr(r.estimator.track, "learned", 4),
    "more lost than all": lambda r: (
        setattr(r.estimator.track.wear, "learn", 1), r.estimator.track.wear.lost.__setitem__(0, 32768),
    ),
    "three outliers": lambda r: setattr(r.estimator, "outlier_count", 3),
    "no such mark": lambda r: setattr(r.estimator, "next_mark", 64),
    "no such last action": lambda r: setattr(r.estimator, "action", len(ACTION) + 1),
    "a pulse from before the clock began": lambda r: (
        r.guard.limbs[0].start_us.__setitem__(0, r.now_us + 5), r.guard.limbs[0].on_us.__setitem__(0, 80_000),
    ),
}  # fmt: skip


DAMAGED_FOR_THE_TWIN = (
    "more points than the path has", "more points than any path has", "one instant",
    "more instants than there are", "no such action", "more lost than all", "three outliers", "no such mark",
)  # fmt: skip
"""Counts and indices that it would use too."""


def points_of(memory: Any, which: str, points: int, total: int) -> None:
    prefix = "path" if which == "path" else "coming"
    setattr(memory, f"{prefix}_points", points)
    setattr(memory, f"{prefix}_total", total)


def snapshot_as_written(robot: Robot) -> bytes:
    """Of what the robot's memory holds now, whatever that is."""
    known = fetched(robot)
    robot.core.fk_robot_log_snapshot(robot.memory)
    records = [record for records in fetched(robot, known).records() for record in records]
    last = max(
        i for i, record in enumerate(records) if record.name == "SNAPSHOT" and not record.values["part"]
    )
    return b"".join(record.rest for record in records[last:])


@pytest.mark.parametrize("name", DAMAGE)
def test_a_snapshot_that_cannot_be_is_refused(name: str) -> None:
    """A count of one where two are the least was taken, and the replay read far outside."""
    robot = run(9, 5.0)
    assert restored(snapshot_as_written(robot)) == 0
    DAMAGE[name](robot.memory)
    damaged = snapshot_as_written(robot)
    assert restored(damaged) == -1
    if name in DAMAGED_FOR_THE_TWIN:
        with pytest.raises(SnapshotError, match="fetch it again"):
            ChipTwin(damaged, open_image(image()))


def test_no_two_damages_hide_each_other() -> None:
    robot = run(9, 5.0)
    whole = bytes(FFI.buffer(robot.memory))
    pairs = list(itertools.combinations(DAMAGE.values(), 2))
    for one, other in random.Random(1).sample(pairs, cases(60, len(pairs))):
        FFI.memmove(robot.memory, whole, len(whole))
        one(robot.memory)
        other(robot.memory)
        assert restored(snapshot_as_written(robot)) == -1


def test_a_snapshot_goes_on_to_the_same_snapshot() -> None:
    """What it leaves out of the guard's history does not count: pulses that have left the duty window."""
    robot = run(10, 12.0)
    for _ in range(40):
        live(robot, robot.now_us + 300_000, random.Random(robot.now_us))
        before = snapshot_as_written(robot)
        other = robot_with_log()[0]
        assert restored(before, other) == 0
        other.now_us = robot.now_us
        assert snapshot_as_written(other) == before
