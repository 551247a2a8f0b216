"""A robot remembers the wear of its limbs over a reset; a run from there is repeated exactly in a replay."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci, some
from typer.testing import CliRunner

import frogkick as fk
from frogkick.cli.app import app
from frogkick.front.tables import default_tables
from frogkick.link.layout import link_layout
from frogkick.link.log import fetch_log
from frogkick.paths import shape
from frogkick.planner.plan import config_of
from frogkick.pool.native_robot import NativeRobot, kept_wear
from frogkick.pool.pool import Camera, Pool
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot, load_robot
from frogkick.runs.chip_log import replay_log
from frogkick.runs.closed_loop import run_session
from frogkick.runs.decision import LOST_FIELDS, LiveCheck
from frogkick.runs.record import Recording, RunOptions
from frogkick.runs.runlog_file import write_run
from frogkick.runs.session import Session
from frogkick.runs.summary import lost_at_start
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.firmware import build

PATH = shape("ellipse")
WORN = fk.World([fk.effects.LimbWear(limb="front_right", gain=0.65)])
FIRST_S, SECOND_S = 16.0, 17.0
COOL_S = 15.0
Port = NativeRobot | VirtualRobot


@cache
def robot() -> Robot:
    return load_robot("frog2022")


@cache
def tables() -> Tables:
    return read_image(default_tables("frog2022"))


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder, table = tmp_path_factory.mktemp("firmware"), default_tables("frog2022")
    places = {"virtual": "bench", "pool": "native"}
    return {place: build(kind, table, robot(), folder / kind).image for place, kind in places.items()}


def port_of(place: str, images: dict[str, Path]) -> Port:
    made: type[NativeRobot] | type[VirtualRobot] = VirtualRobot if place == "virtual" else NativeRobot
    return made(images[place], len(robot().limbs))


def swim(session: Session, limit_s: float, learn: bool = True) -> tuple[Recording, LiveCheck]:
    """A run of a robot with a worn limb, whose decisions the host checks."""
    begin = float(PATH.x_m[0]), float(PATH.y_m[0]), float(PATH.tangent_rad[0])
    pool = Pool(robot(), begin, Camera(), np.random.default_rng(6), WORN)
    pool.advance(session.time_s)
    check = LiveCheck()
    options = RunOptions(config_of(robot().planner), True, limit_s, check, learn=learn)
    recording = run_session(session, pool, Recording(robot(), tables(), PATH, options, "test"))
    session.on_step = lambda _time_s, _edges: None  # nobody sees it any more
    return recording, check


class AfterReset(Session):
    """A session whose time continues, while the robot's clock began anew."""

    def robot_clock_offset_us(self) -> int:
        return int(self.request("STATUS")["now_us"]) - round(self.time_s * 1e6)


def known(session: Session) -> tuple[int, tuple[int, ...]]:
    status = session.request("STATUS")
    return int(status["learn"]), tuple(int(status[name]) for name in LOST_FIELDS)


def reset(port: Port, session: Session) -> Session:
    """Hang the firmware, and begin a session after its watchdog has reset it."""
    if isinstance(port, VirtualRobot):
        port.chip.hang()
    else:
        port.hang()
    session.step(session.time_s + 1.3)
    again = AfterReset(port, time_s=session.time_s)
    again.handshake(tables())
    assert again.request("STATUS")["reset"] == link_layout().reset["WATCHDOG"]
    return again


@from_ci
@pytest.mark.parametrize("place", some(["pool", "virtual"], 1))
def test_a_run_after_a_reset_goes_on_from_what_was_learned(
    place: str, images: dict[str, Path], tmp_path: Path
) -> None:
    """STATUS still has it; the live check, a replay and the robot's own log agree to the bit."""
    port = port_of(place, images)
    session = Session(port)
    recording, check = swim(session, FIRST_S)
    learn, learned = known(session)
    assert learn == link_layout().learn["ON"] and learned[0] > 10_000, "front_right"
    session = reset(port, session)
    assert known(session) == (learn, learned)
    session.step(session.time_s + COOL_S)  # the limbs of a robot that replays are cool: it refuses no stroke
    recording, check = swim(session, SECOND_S)
    first = recording.decisions[0]
    assert first.lost == learned and check.unchecked == 0
    assert check.agreed == len(recording.decisions) > 5
    assert recording.decisions[-1].lost != learned, "it learns on"

    log = recording.log()
    assert lost_at_start(log) == learned
    write_run(tmp_path / "second.h5", log)
    assert fk.load_run(tmp_path / "second.h5").decisions.extra["lost"][0].tolist() == list(learned)
    asked = ["replay", str(tmp_path / "second.h5"), "--robot", place, "--json"]
    again = CliRunner().invoke(app, asked)
    assert again.exit_code == 0, again.stderr
    output = json.loads(again.stdout)
    assert output["mismatches"] == 0 and output["decisions"] == len(recording.decisions)
    assert not recording.rested and output["agreement_with_recorded"] == 1.0
    known_fixes = fk.replay(tmp_path / "second.h5", plan="host").result
    assert known_fixes.agreement == 1.0 and log.decisions.cost is not None
    assert [one.cost for one in known_fixes.host] == log.decisions.cost.tolist()
    assert known_fixes.host[-1].lost == recording.decisions[-1].lost

    own = replay_log(fetch_log(session), images["pool"], [tables()])
    assert own.mismatches == [] and own.decisions[-1].lost == recording.decisions[-1].lost


@from_ci
@pytest.mark.parametrize("learn", [False, True])
def test_a_later_run_hangs_on_none_before_it(learn: bool, images: dict[str, Path]) -> None:
    """The robot stays on and keeps the shares alone: every decision is the host's, which knows only those."""
    port = port_of("pool", images)
    session = Session(port)
    swim(session, FIRST_S, learn)
    learned = known(session)[1]
    for pause_s in (1.0, 30.0):
        session.step(session.time_s + pause_s)
        session = Session(port, time_s=session.time_s)
        recording, check = swim(session, SECOND_S, learn)
        assert check.unchecked == 0 and check.agreed == len(recording.decisions) > 5
        assert recording.decisions[0].lost == learned and any(learned) == learn
        learned = known(session)[1]
    own = replay_log(fetch_log(session), images["pool"], [tables()])
    assert own.mismatches == []


def test_a_reset_amid_a_stroke_of_the_chip_keeps_what_was_learned_until_then(images: dict[str, Path]) -> None:
    """Also what it kept over an earlier reset; HELD stays HELD."""
    learned = (655, 0, 20_000, 32_767, 0, 0, 0, 0)
    content = kept_wear(tables().crc32, learned)
    port = VirtualRobot(images["virtual"], len(robot().limbs), learned=content)
    session = Session(port)
    session.handshake(tables())
    assert known(session) == (link_layout().learn["ON"], learned)
    for mode in ("ON", "HELD"):
        session.set_parameters({"LEARN": link_layout().learn[mode]})
        session.step(session.time_s + 0.7)  # limbs rest
        session.request("ARM")
        session.request("STROKE", {"action": 0})
        session.step(session.time_s + 0.03)
        assert session.edges[-1].level, "in the middle of a pulse"
        session = reset(port, session)
        assert known(session) == (link_layout().learn[mode], learned)
    session.set_parameters({"LEARN": link_layout().learn["OFF"]})
    assert known(reset(port, session)) == (link_layout().learn["OFF"], (0,) * 8)


@pytest.mark.parametrize("place", ["pool", "virtual"])
def test_without_supply_it_is_forgotten(place: str, images: dict[str, Path]) -> None:
    """A robot that is switched on for the first time has learned nothing either."""
    port = port_of(place, images)
    session = Session(port)
    session.handshake(tables())
    assert known(session) == (link_layout().learn["OFF"], (0,) * 8)
    if isinstance(port, NativeRobot):
        content = kept_wear(tables().crc32, [9000])
        port = NativeRobot(images[place], len(robot().limbs), learned=content)
        session = Session(port)
        session.handshake(tables())
        assert known(session)[1][0] == 9000
        port.cut_power(1.0)
        session.step(session.time_s + 1.3)
        session = Session(port, time_s=session.time_s)
        session.handshake(tables())
        assert known(session) == (link_layout().learn["OFF"], (0,) * 8)


def test_a_run_that_does_not_learn_makes_the_robot_forget(images: dict[str, Path]) -> None:
    """Also over a reset; a replay of the run begins without wear."""
    content = kept_wear(tables().crc32, [0, 16_000, 0, 0])
    port = NativeRobot(images["pool"], len(robot().limbs), learned=content)
    session = Session(port)
    session.handshake(tables())
    assert known(session)[1][1] == 16_000
    recording, check = swim(session, 4.0, learn=False)
    assert check.agreed == len(recording.decisions) > 0 and not any(recording.decisions[0].lost)
    assert lost_at_start(recording.log()) == (0,) * 8
    assert known(reset(port, session)) == (link_layout().learn["OFF"], (0,) * 8)
