"""A PATH during a run: it takes over whole, without a stop, and nothing less changes anything."""

from __future__ import annotations

import random
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.conftest import from_ci, some
from tests.core.core import (
    FFI,
    PERIOD_US,
    Robot,
    bits,
    cases,
    core,
    image,
    library,
    mutated,
)
from tests.core.log_rig import fetched, robot_with_log
from tests.core.test_core_log_replay import live, replayed
from tests.core.test_core_snapshot import restored, snapshot_of

from frogkick.estimator.follow import Follow
from frogkick.link.frames import Frame
from frogkick.link.layout import Value, link_layout
from frogkick.paths import Path
from frogkick.planner.plan import config_of
from frogkick.robot import load_robot
from frogkick.runs.decision import DecisionTwin, RobotEvent, decision_of_event, events_of_frame
from frogkick.tables.image import Tables, open_image

DEFAULTS = config_of(load_robot("frog2022").planner)
Rows = Sequence[Sequence[float]]


def line(y_m: float, points: int = 40, length_m: float = 1.0) -> list[tuple[float, float, float]]:
    return [(index * length_m / (points - 1), y_m, 0.0) for index in range(points)]


def send(robot: Robot, rows: Rows, parts: int | None = None) -> list[str]:
    """The first parts of a path; the statuses of their answers."""
    firsts = range(0, len(rows), 18)
    return [
        robot.status(
            "PATH",
            {"first": first, "total": len(rows), "count": len(rows[first : first + 18])},
            rows[first : first + 18],
        )
        for first in list(firsts)[:parts]
    ]


def swims(robot: Robot, decisions: int, x_m: float = 0.1, y_m: float = 0.0) -> list[Frame]:
    """The next decisions of a robot that is held at a place."""
    seen: list[Frame] = []
    for _ in range(20 * decisions):
        if len(seen) >= decisions:
            break
        robot.run_until(robot.now_us + 200_000)
        seen += [frame for frame in robot.take() if frame.name in ("DECISION", "ENDED")]
        if seen and seen[-1].name == "ENDED":
            return seen
        robot.fix(x_m, y_m)
    return seen


def running(x_m: float = 0.1) -> Robot:
    robot = Robot().begin("RUNNING")
    swims(robot, 2, x_m)
    return robot


def distances(frames: Sequence[Frame]) -> list[float]:
    return [round(float(frame.values["distance_m"]), 2) for frame in frames]


def test_a_new_path_takes_over_without_a_stop() -> None:
    """The clock of decisions, the estimate and what is counted go on."""
    robot = running()
    before = swims(robot, 1)[0].values
    assert send(robot, line(0.05)) == ["OK"] * 3
    assert robot.state() == "RUNNING"
    seen = swims(robot, 3)
    assert distances(seen) == [0.05] * 3
    assert [frame.values["scheduled_us"] for frame in seen] == [
        int(before["scheduled_us"]) + k * PERIOD_US for k in (1, 2, 3)
    ]
    assert seen[0].values["decision"] == int(before["decision"]) + 1
    assert float(seen[0].values["along_points"]) == pytest.approx(3.9, abs=0.2), "where it is nearest"


def test_the_answer_counts_the_points_of_the_new_path() -> None:
    robot = running()
    rows = line(0.05, 20)
    answer = robot.ask("PATH", {"first": 0, "total": 20, "count": 18}, rows[:18])
    assert answer == {"status": 0, "received": 18}
    answer = robot.ask("PATH", {"first": 18, "total": 20, "count": 2}, rows[18:])
    assert answer == {"status": 0, "received": 20}
    swims(robot, 1)
    answer = robot.ask("PATH", {"first": 18, "total": 20, "count": 2}, rows[18:])
    assert answer["status"] != 0, "it has taken over: nothing is coming any more"


def test_half_a_path_changes_nothing() -> None:
    robot = running()
    assert send(robot, line(0.05), 2) == ["OK"] * 2
    assert distances(swims(robot, 3)) == [0.0] * 3
    assert robot.status("STOP") == "OK"
    assert robot.start() == "OK", "the old path is whole"
    assert distances(swims(robot, 1)) == [0.0]


@pytest.mark.parametrize("bad", [np.nan, 1000.1])
def test_a_refused_path_changes_nothing(bad: float) -> None:
    robot = running()
    rows = line(0.05)
    rows[30] = (0.0, bad, 0.0)
    assert send(robot, rows) == ["OK", "VALUE", "VALUE"]
    assert distances(swims(robot, 2)) == [0.0] * 2
    assert send(robot, line(0.03)) == ["OK"] * 3
    assert distances(swims(robot, 1)) == [0.03]


def test_a_part_that_comes_again_does_nothing() -> None:
    """A radio delivers frames twice: the second one is answered as the first."""
    robot = running()
    rows = line(0.05)
    for first in (0, 18, 36):
        part = rows[first : first + 18]
        values = {"first": first, "total": 40, "count": len(part)}
        answer = robot.ask("PATH", values, part)
        robot._sequence -= 1
        assert robot.ask("PATH", values, part) == answer == {"status": 0, "received": first + len(part)}
    assert robot.ask("STATUS")["repeats"] == 3
    assert distances(swims(robot, 1)) == [0.05]


def test_the_newest_of_two_paths_takes_over() -> None:
    robot = running()
    send(robot, line(0.05))
    send(robot, line(0.02))
    assert distances(swims(robot, 1)) == [0.02]
    send(robot, line(0.05))
    send(robot, line(0.03), 1)
    assert distances(swims(robot, 2)) == [0.02] * 2, "one that began anew has nothing to take over with"


def at_the_end_of_the_path(leaves: bool, made: Any = None) -> Robot:
    """A robot that was seen at the end of a short path, with or without another one to go on with."""
    robot = Robot(made=made).begin("ARMED")
    send(robot, line(0.0, 18, 0.103))
    assert robot.fix(0.1, capture_age_us=1000) == robot.start(0) == "OK"
    swims(robot, 2, 0.1)
    if leaves:
        send(robot, line(0.0, 18, 1.0))
    robot.run_until(robot.now_us + 100_000)
    at_the_end: dict[str, Value] = {"x_m": 0.104, "y_m": 0.0, "heading_rad": 0.0}
    robot.post("FIX", {"fix_sequence": 99, "quality": 1, "capture_age_us": 0, **at_the_end})
    assert robot.take()[0].values["status"] == 0
    return robot


def test_a_run_goes_on_at_the_end_of_a_path_that_is_left() -> None:
    assert at_the_end_of_the_path(False).state() == "ARMED"
    robot = at_the_end_of_the_path(True)
    assert robot.state() == "RUNNING"
    assert [frame.name for frame in swims(robot, 3, 0.104)] == ["DECISION"] * 3


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("end", ["STOP", "DISARM", "lost"])
def test_a_run_that_ends_before_leaves_the_newest_whole_path(end: str, whole: bool) -> None:
    robot = running()
    send(robot, line(0.05), None if whole else 2)
    if end == "lost":
        robot.run_until(robot.now_us + 2_300_000)
    else:
        assert robot.status(end) == "OK"
    assert robot.state() == ("ARMED" if end == "STOP" else "DISARMED")
    assert robot.status("ARM") == "OK"
    robot.run_until(robot.now_us + 1_000_000)
    robot.fix()
    assert robot.start() == "OK"
    assert distances(swims(robot, 1)) == [0.05 if whole else 0.0]


def test_a_path_waits_for_an_estimate() -> None:
    """Without one nobody knows where on the new path the robot is."""
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.fix(capture_age_us=1000) == "OK"
    assert robot.start(1_900_000) == "OK"
    send(robot, line(0.05))
    robot.run_until(robot.now_us + 1_950_000)
    (decision,) = [frame.values for frame in robot.take() if frame.name == "DECISION"]
    if decision["status"] == 0:
        pytest.fail("the estimate was to be too old")
    robot.fix()
    assert distances(swims(robot, 1)) == [0.05]


CURVES: dict[str, list[tuple[float, float, float]]] = {
    "an ellipse, closed": [
        (0.2 * np.cos(a) - 0.2, 0.1 * np.sin(a), 0.0) for a in np.linspace(0, 2 * np.pi, 100)
    ],
    "an eight": [(0.2 * np.sin(a), 0.1 * np.sin(2 * a), 0.0) for a in np.linspace(0, 2 * np.pi, 100)],
    "far, near, far": [
        (-3.0, 0.0, 0.0),
        (-2.0, 0.0, 0.0),
        (0.0, 0.01, 0.0),
        (2.0, 0.0, 0.0),
        (3.0, 1.0, 0.0),
    ],
    "twice the same": [(x, 0.0, 0.0) for x in (0.0, 0.5, 1.0, 0.5, 0.0)],
    "equal points": [(0.0, 0.0, 0.0)] * 5 + [(1.0, 0.0, 0.0)] * 3,
}


def changed_in_c(path: Path, x_m: float, y_m: float, made: Any = None) -> float:
    made = core() if made is None else made
    robot = FFI.new("fk_robot_t *")
    table = FFI.new("uint64_t[]", (len(image()) + 7) // 8)
    FFI.memmove(table, image(), len(image()))
    assert made.fk_robot_init(robot, FFI.cast("uint8_t *", table), len(image())) == 0
    to = FFI.new("fk_path_t *")
    to.count = len(path)
    for index in range(len(path)):
        to.x_m[index], to.y_m[index] = path.x_m[index], path.y_m[index]
    made.fk_follow_change(FFI.addressof(robot.follow), FFI.addressof(robot.tables), to, x_m, y_m)
    return float(robot.follow.along_points)


@cache
def opened() -> Tables:
    return open_image(image())


def changed_in_python(path: Path, x_m: float, y_m: float) -> float:
    follow = Follow(opened(), path, DEFAULTS)
    follow.coming = path
    follow.take_over(np.float32(x_m), np.float32(y_m))
    assert follow.coming is None
    return float(follow.along_points)


def curve(name: str) -> Path:
    columns = zip(*CURVES[name], strict=True)
    return Path(*(np.array(column, dtype=np.float32) for column in columns), name=name)


def places(name: str, many: int) -> list[tuple[float, float]]:
    rng = np.random.default_rng(3)
    rows = np.array(CURVES[name])[:, :2]
    random_places = rows[rng.integers(0, len(rows), many)] + rng.normal(0.0, 1.0, (many, 2)) * rng.choice(
        [0.0, 0.01, 0.1, 2.0], (many, 1)
    )
    some_places = [(0.0, 0.0), (0.0, -0.003), (0.001, 0.003), *random_places]
    return [(float(np.float32(x)), float(np.float32(y))) for x, y in some_places]


@from_ci
@pytest.mark.parametrize("name", some(CURVES, 1))
def test_where_a_robot_goes_on_is_the_same_in_c_and_python(name: str) -> None:
    path = curve(name)
    for x_m, y_m in places(name, max(20, cases(100, 3000))):
        assert bits(changed_in_c(path, x_m, y_m)) == bits(changed_in_python(path, x_m, y_m)), (x_m, y_m)


def test_where_a_robot_goes_on() -> None:
    assert changed_in_c(curve("an ellipse, closed"), 0.0, 0.0) < 1.0, "the begin, not the end"
    assert changed_in_c(curve("an ellipse, closed"), 0.0, -0.003) < 1.0
    assert changed_in_c(curve("an eight"), 0.0, 0.0) < 1.0
    assert changed_in_c(curve("an eight"), 0.2, 0.0) == pytest.approx(99 / 4, abs=0.6)
    assert changed_in_c(curve("twice the same"), 0.25, 0.01) == pytest.approx(0.5)
    assert changed_in_c(curve("equal points"), 0.5, 0.0) == pytest.approx(4.5)
    assert changed_in_c(curve("far, near, far"), 0.5, 0.0) == pytest.approx(2.25, abs=0.01)


MUTATIONS = {
    "half a path is followed": (
        "fk_path_command.c", "path->count = (*points == *total) ? *total : 0u;", "path->count = *total;",
    ),
    "it takes the followed path's place at once": (
        "fk_path_command.c",
        "take_path(&robot->coming, &robot->coming_points, &robot->coming_total, payload, length)",
        "take_path(&robot->path, &robot->path_points, &robot->path_total, payload, length)",
    ),
    "the old progress is kept": (
        "fk_robot.c", "            fk_follow_change(", "            if (0) fk_follow_change(",
    ),
    "the old path's end ends the run": (
        "fk_robot.c", "if (robot->state == FK_STATE_RUNNING && robot->coming.count == 0u) {",
        "if (robot->state == FK_STATE_RUNNING) {",
    ),
    "it stays after the run": (
        "fk_robot_state.c", "if (before == FK_STATE_RUNNING && robot->state != FK_STATE_RUNNING) {",
        "if (0) {",
    ),
    "half a path outlives the run": (
        "fk_robot_state.c", "    robot->coming.count = 0u;\n    robot->coming_points = 0u;\n",
        "    robot->coming.count = 0u;\n",
    ),
    "a snapshot without it": (
        "fk_snapshot.c",
        "    walk_path(walk, &robot->coming, &robot->coming_points, &robot->coming_total);\n",
        "    uint8_t none[2] = {0u, 0u};\n    walk_path(walk, &robot->coming, &none[0], &none[1]);\n",
    ),
    "the last of the near stretches": (
        "fk_follow.c", "            if (best2_m2 < FAR2_M2) {\n                break;\n            }\n", "",
    ),
    "the nearest place alone": (
        "fk_follow.c", "least2_m2 + tables->stroke_max_m * tables->stroke_max_m;",
        "least2_m2 + 0.0f * tables->stroke_max_m;",
    ),
}  # fmt: skip


def same_as_the_twin(seed: int, made: Any = None) -> str:
    """A robot whose path is changed at random times: what its log and its twin find different."""
    dice = random.Random(seed)
    robot, _ = robot_with_log(made=made)
    robot.tick()
    robot.fix()
    robot.path()
    robot.status("ARM")
    live(robot, robot.now_us + 700_000, dice)
    robot.keep = True
    assert robot.start(200_000) == "OK"
    robot.take_all()
    for _ in range(8):
        kind = dice.choice([*list(CURVES)[:2], "line", "half", "bad"])
        rows = [tuple(map(float, row)) for row in CURVES.get(kind, line(dice.uniform(-0.05, 0.05)))]
        if kind == "bad":
            rows[-1] = (0.0, 9999.0, 0.0)
        send(robot, rows, dice.randint(0, 1) if kind == "half" else None)
        live(robot, robot.now_us + dice.randint(100_000, 2_500_000), dice)
    reported = replayed(fetched(robot))
    if any(decision.status == 0 for decision in reported.decisions) and not reported.mismatches:
        return ""
    return str(reported.mismatches[:2])


@pytest.mark.parametrize("seed", range(cases(6, 60)))
def test_a_log_with_new_paths_is_decided_again(seed: int) -> None:
    assert same_as_the_twin(seed) == ""


@pytest.mark.parametrize("parts", [0, 1, 2, 3])
def test_a_snapshot_holds_a_path_that_is_coming(parts: int) -> None:
    """A robot that goes on from it decides as the one that it was taken of."""
    robot, _ = robot_with_log()
    robot.begin("RUNNING")
    swims(robot, 1)
    send(robot, line(0.05), parts)
    robot.core.fk_robot_log_snapshot(robot.memory)
    snapshot = snapshot_of(robot)
    again, _ = robot_with_log(now_us=robot.now_us)
    assert restored(snapshot, again) == 0
    rest = [(first, line(0.05)[first : first + 18]) for first in range(18 * parts, 40, 18)]
    reported = []
    for one in (robot, again):
        one._fixes = 50
        for first, part in rest:
            assert one.status("PATH", {"first": first, "total": 40, "count": len(part)}, part) == "OK"
        (frame,) = swims(one, 1)
        reported.append(frame.values)
    assert reported[0] == reported[1]
    assert round(float(reported[0]["distance_m"]), 2) == 0.05


def test_the_host_makes_the_same_decisions_on_new_paths() -> None:
    """All that its twin needs is what the robot sends, in its order."""
    robot = Robot().begin("RUNNING")
    path = Path(*np.array(line(0.0, 20), dtype=np.float32).T, name="first")
    twin = DecisionTwin(open_image(robot.image), path, DEFAULTS)
    twin.add_fix(robot.now_us - 1000, np.array([0.1, 0.0, 0.0], dtype=np.float32), 1)
    new = {number: line(0.01 * number, 18) for number in (3, 9, 14)}
    decided = 0
    for number in range(2, 60):
        robot.run_until(robot.now_us + 200_000)
        frames = robot.take()
        if number in new:
            assert send(robot, new[number]) == ["OK"]
        for frame in frames:
            for event in events_of_frame(frame, {}):
                decision = twin.apply(event)
                assert decision is not None
                assert not decision_of_event(frame.values).differences(decision)
                decided += 1
        if number in new:
            there = Path(*np.array(new[number], dtype=np.float32).T, name="new")
            assert twin.apply(RobotEvent(0, path=there)) is None
        fix = np.array([0.1 + 0.002 * number, 0.0, 0.0], dtype=np.float32)
        assert robot.fix(*map(float, fix)) == "OK"
        assert twin.add_fix(robot.now_us, fix, number) == 0
    assert decided > 5


def in_turn(made: Any = None) -> list[object]:
    """What a robot answers and does whose runs end with half a path, and with a whole one, on the way."""
    robot = Robot(made=made).begin("RUNNING")
    reported: list[object] = [distances(swims(robot, 1))]
    for parts in (1, None):
        reported += send(robot, line(0.05), parts)
        reported += [robot.status("STOP"), robot.start()]
        part = line(0.05)[18:36]
        reported.append(robot.ask("PATH", {"first": 18, "total": 40, "count": 18}, part))
        reported += [(frame.values["distance_m"], frame.values["along_points"]) for frame in swims(robot, 2)]
    return reported


def test_runs_that_end_with_a_path_on_the_way() -> None:
    reported = in_turn()
    refused = {"status": link_layout().status["VALUE"], "received": 0}
    assert reported[1:5] == ["OK", "OK", "OK", refused]
    assert [one for one in reported if isinstance(one, dict)] == [refused, refused]


def finds(made: Any) -> bool:
    """Whether one of the tests above finds a core different."""
    if in_turn(made) != in_turn():
        return True
    if at_the_end_of_the_path(True, made).state() != "RUNNING":
        return True
    if any(same_as_the_twin(seed, made) for seed in range(6)):
        return True
    return any(
        changed_in_c(curve(name), *place, made) != changed_in_python(curve(name), *place)
        for name in CURVES
        for place in places(name, 20)
    )


@pytest.mark.parametrize("name", some(MUTATIONS, 3))
def test_a_core_that_was_changed_is_found(name: str) -> None:
    assert finds(library(mutated(*MUTATIONS[name])))
