"""What the soak watches for is seen: each fault is planted once, in the core or around it, and found."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from tests.soak import rig
from tests.soak.harness import Life, Plan
from tests.soak.witness import SeenRobot

from frogkick.pool.native_robot import CoreCall
from frogkick.pool.port import Edge

_MOST_S = 600.0
_LOST = "robot->state == FK_STATE_RUNNING && now_us >= fk_guard_lost_us(&robot->guard)"
_BOOT = "{store->record.active, store->record.previous, FK_STORE_BUILT_IN}"

CORES: dict[str, tuple[str, str, str, tuple[str, ...], str]] = {
    "pulses are too long": (
        "fk_robot.c", "outputs->pulse_us = robot->tables.pulse_us;",
        "outputs->pulse_us = robot->tables.pulse_us + 30000u;", ("restart",), "on for 0.11",
    ),
    "a lost robot stays armed": ("fk_robot.c", _LOST, "0", ("camera dark",), "told"),
    "pulses without a fresh fix": (
        "fk_guard.c", "guard->closed_loop != 0u && now_us", "0 && now_us", ("camera blinks",), "fresh",
    ),
    "boots armed": (
        "fk_robot.c", "robot->state = FK_STATE_DISARMED;", "robot->state = FK_STATE_ARMED;", ("power cut",),
        "lost",
    ),
    "a decision's time wraps": (
        "fk_robot.c", "robot->next_decision_us += robot->period_us;",
        "robot->next_decision_us = (uint32_t)(robot->next_decision_us + robot->period_us);", ("long off",),
        "no decision",
    ),
    "a picture's time wraps": (
        "fk_commands.c", "capture_us = now_us - command.capture_age_us;",
        "capture_us = (uint32_t)(now_us - command.capture_age_us);", ("long off",), "no decision",
    ),
    "believes to be elsewhere": (
        "fk_robot.c", "estimate.state.along_points = robot->follow.along_points;",
        "estimate.state.along_points = robot->follow.along_points; estimate.state.y_m += 0.15f;",
        ("restart",), "off the route",
    ),
    "the last run leaks into the next": (
        "fk_commands.c", "fk_follow_begin(&robot->follow);", "", ("restart",), "got on by",
    ),
    "an update stays open": (
        "fk_store.c", "    store->open = 0u;\n    int8_t status = verify", "    int8_t status = verify",
        ("update",), "no decision",
    ),
    "an update is forgotten": ("fk_store.c", _BOOT, "{0u, 0u, 0u}", ("update", "power cut"), "uses table"),
    "erases are not counted": (
        "fk_store.c", "++next.erases[next.pending - 1u];", "", ("update", "restart"), "0 erases of slots",
    ),
    "bad frames are not counted": (
        "fk_link.c", "++robot->frames_bad;", "", ("noise", "restart"), "frames_bad",
    ),
    "fixes are not counted": ("fk_commands.c", "++robot->fixes_used;", "", ("restart",), "fixes_used"),
    "writes beside its memory": (
        "fk_robot.c", "outputs->limb_mask = 0u;",
        "outputs->limb_mask = 0u; ((uint8_t *)robot)[sizeof(*robot) + 9u] = 1u;", ("restart",), "beside",
    ),
}  # fmt: skip
"""File, what stands there, what instead, what disturbs the robot, and a word of what is said of it."""


class ShortClock(SeenRobot):
    """A port that counts microseconds in 32 bits, and forgets to carry."""

    def turn(self, now_us: int, frame: bytes) -> CoreCall:
        return super().turn(now_us % 2**32, frame)


class Hoarder(Life):
    """A host that keeps whatever it has seen."""

    kept: list[Edge]

    def _on_step(self, until_s: float, edges: Sequence[Edge]) -> None:
        self.kept = [*getattr(self, "kept", []), *edges, *(Edge(until_s, 0, False) for _ in range(2))]
        super()._on_step(until_s, edges)


def life_of(plan: Plan, spoilt: dict[str, tuple[str, str]] | None = None, **changes: object) -> Life:
    library = rig.spoilt_library(spoilt) if spoilt is not None else rig.library()
    return Life(library, rig.robot(), rig.tables(), plan, seed=3, truth=rig.truth(), **changes)  # type: ignore[arg-type]


def plan_with(kinds: tuple[str, ...], calm_s: float = 120.0) -> Plan:
    return Plan(gap_s=10.0, kinds=kinds, first=kinds, wrap_in_s=20.0, calm_s=calm_s)


def test_the_sources_as_they_are_have_no_fault() -> None:
    life = life_of(plan_with(("update", "power cut", "camera blinks")), {})
    life.live(200.0)
    assert life.faults == []


@pytest.mark.parametrize("name", CORES)
def test_a_fault_of_the_core_is_seen(name: str) -> None:
    file, old, new, kinds, word = CORES[name]
    calm_s = _MOST_S if kinds == ("camera blinks",) else 120.0
    life = life_of(plan_with(kinds, calm_s), {file: (old, new)})
    life.live(_MOST_S)
    assert life.faults and word in " ".join(life.faults), life.faults


def test_a_clock_that_does_not_carry_is_seen() -> None:
    life = life_of(plan_with(("long off",)), made=ShortClock)
    life.live(_MOST_S)
    assert life.faults


def test_a_host_that_waits_for_ever_is_seen() -> None:
    life = life_of(plan_with(("power cut",)))
    life.silence_s = float("inf")
    life.live(_MOST_S)
    assert "no decision for more than" in life.faults[0]


def test_memory_that_grows_is_seen() -> None:
    plan = plan_with(("restart",))
    life = Hoarder(rig.library(), rig.robot(), rig.tables(), plan, seed=3, truth=rig.truth(), warm_s=60.0)
    life.live(_MOST_S)
    assert "memory has grown" in life.faults[0]
