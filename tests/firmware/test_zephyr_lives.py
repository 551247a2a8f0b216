"""Lives of the robot's Zephyr application, in simulated time: radio, crystal, supply, pairing, owner."""

from __future__ import annotations

import ctypes
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from tests.conftest import from_ci
from zephyr_robot import ROBOT, Life, ZephyrRobot, configuration, defines, play

from frogkick.link import auth
from frogkick.link.layout import link_layout
from frogkick.paths import shape
from frogkick.robot import load_robot
from frogkick.runs.session import LinkError
from frogkick_codegen.firmware import robot_config

pytestmark = from_ci  # its firmware takes 12 s to build

STATE = link_layout().state


@from_ci
def test_a_stroke_over_the_radio(life: Life) -> None:
    session = life.session
    session.request("ARM")
    life.live(1.0)
    session.request("STROKE", {"action": life.firing})
    life.live(1.0)
    row = life.tables.actions[life.firing]
    ups = [edge for edge in session.edges if edge.level]
    assert len(ups) == row.first_mask.bit_count() + row.second_mask.bit_count()
    for up in ups:
        down = next(e for e in session.edges if e.limb == up.limb and not e.level)
        assert down.time_s - up.time_s == pytest.approx(life.tables.pulse_us * 1e-6, abs=1e-9)
    assert life.robot.watchdog_s < 0.5
    assert life.robot.stage.play_asserts() == 0


def test_a_fading_link_does_not_hang_the_loop(life: Life) -> None:
    """Nothing leaves any more, and answers are asked for: it disarms as the core says, and is not reset."""
    session = life.session
    session.request("ARM")
    life.live(1.0)
    session.request("STROKE", {"action": life.firing})
    life.robot.stage.play_fade(1)
    for _ in range(40):  # a host that hears nothing repeats itself
        session.post("STATUS")
        life.live(0.05)
    assert life.robot.watchdog_s < 0.5, "the watchdog would have reset it"
    assert session.edges and not session.edges[-1].level
    fired = len(session.edges)
    life.live(6.0)  # nothing heard for 5 s
    assert life.robot.watchdog_s < 0.5
    life.robot.stage.play_fade(0)
    life.live(1.0)
    status = session.take("STATUS")
    assert status and life.robot.bad_frames == 0, "what was kept comes whole"
    assert life.state() == STATE["DISARMED"]
    assert session.request("STATUS")["answers_dropped"] == 40 - len(status), "what found no room is counted"
    assert len(session.edges) == fired


def test_a_fading_link_that_ends(life: Life) -> None:
    """Disarmed as the connection ends; the next host hears whole frames, and what was lost is counted."""
    session = life.session
    session.request("ARM")
    life.robot.stage.play_fade(1)
    for _ in range(20):
        session.post("STATUS")
        life.live(0.05)
    life.robot.stage.play_disconnect()
    life.live(0.1)
    assert life.robot.watchdog_s < 0.5
    life.robot.connect()
    life.live(0.1)
    session.take("STATUS")
    status = session.request("STATUS")
    assert status["state"] == STATE["DISARMED"]
    assert status["answers_dropped"] > 0
    assert life.robot.bad_frames == 0


@pytest.mark.parametrize("before", [["ARM"], ["ARM", "STROKE"], ["STROKE"]])
def test_what_has_arrived_when_a_connection_ends(life: Life, before: list[str]) -> None:
    """The robot was busy: it takes these when their host has gone, and neither stays armed nor fires."""
    session = life.session
    if before[0] != "ARM":
        session.request("ARM")
    for name in before:
        session.post(name, {"action": life.firing} if name == "STROKE" else {})
    life.robot.stage.play_disconnect()
    life.live(0.5)
    assert not life.robot.crystal_held and session.edges == []
    life.robot.connect()
    session.request("ARM")  # the next host's own
    life.live(0.5)
    assert life.state() == STATE["ARMED"]


def test_a_run_that_ends_without_its_host(life: Life) -> None:
    """It goes on by the fixes that it has; when it ends, nobody is there for whom to stay armed."""
    session = life.session
    session.send_path(shape("line"))
    session.request("PARAM", {"parameter": link_layout().parameter["COST"], "value": 0.0})
    session.request("ARM")
    end = shape("line")
    pose = {"x_m": float(end.x_m[-1]), "y_m": float(end.y_m[-1]), "heading_rad": 0.0}
    session.request("FIX", {"fix_sequence": 1, "capture_age_us": 0, "quality": 255, **pose})
    session.request("START", {"delay_us": 300_000})
    life.robot.stage.play_disconnect()
    life.live(0.25)
    assert life.robot.crystal_held, "the run goes on"
    life.live(0.1)
    assert not life.robot.crystal_held, "the first decision ended it"
    life.robot.connect()
    assert life.state() == STATE["DISARMED"]
    session.request("ARM")  # the next host's own
    life.live(1.0)
    assert life.state() == STATE["ARMED"]
    assert life.robot.watchdog_s < 0.5


@pytest.mark.parametrize("error", [12, 22])  # ENOMEM, EINVAL
@pytest.mark.parametrize("after", range(5))
def test_frames_are_whole_or_dropped_whole(played: Path, error: int, after: int) -> None:
    """Parts of 20 bytes, and the radio refuses one in the middle of a frame: the next frame is not spoilt."""
    life = Life(played, mtu=23)
    session = life.session
    assert session.request("STATUS")["answers_dropped"] == 0
    life.robot.stage.play_refuse(-error, after)
    first = session.post("STATUS")
    life.live(0.3)
    assert life.robot.watchdog_s < 0.5
    life.robot.stage.play_refuse(0, 0)
    life.live(0.3)
    arrived = [arrival.frame.sequence for arrival in session.take("STATUS")]
    status = session.request("STATUS")
    if error == 12:  # no buffer for a while: repeated
        assert arrived == [first] and status["answers_dropped"] == 0 and life.robot.bad_frames == 0
    else:
        lost = 0 if first in arrived else 1
        assert status["answers_dropped"] == lost
        assert life.robot.bad_frames <= lost
        assert lost == (after < 4), "an answer of 62 bytes"


NEVER = ctypes.c_uint64(2**64 - 1)


def test_the_crystal_is_held_while_armed_and_no_longer(life: Life) -> None:
    session, robot = life.session, life.robot
    session.request("STATUS")
    assert not robot.crystal_held
    session.request("ARM")
    life.live(1.0)
    assert robot.crystal_held
    session.request("STROKE", {"action": life.firing})
    life.live(0.02)
    begun = [edge for edge in session.edges if edge.level]
    assert begun
    life.live(1.0)
    for up in (edge for edge in session.edges if edge.level):
        down = next(edge for edge in session.edges if edge.limb == up.limb and not edge.level)
        assert down.time_s - up.time_s == pytest.approx(life.tables.pulse_us * 1e-6, abs=1e-9)
    session.request("ARM")
    assert robot.crystal_held
    session.request("DISARM")
    life.live(0.05)
    assert not robot.crystal_held
    session.request("ARM")
    assert robot.crystal_held
    life.live(7.0)  # nobody speaks: it disarms itself
    assert not robot.crystal_held and life.state() == STATE["DISARMED"]


def test_a_crystal_that_never_starts(life: Life) -> None:
    """It does not arm, says so in one line, and goes on."""
    life.robot.stage.play_crystal(NEVER)
    with pytest.raises(LinkError, match=r"^the robot refuses ARM: FAULT, internal error CLOCK \(0\)$"):
        life.session.request("ARM")
    assert life.state() == STATE["FAULT"]
    assert not life.robot.crystal_held
    assert life.robot.watchdog_s < 0.5


NO_CRYSTAL = -5


def test_no_pulse_on_the_gates_without_the_crystal(life: Life) -> None:
    """Whoever asks for it: here nobody looks at the clock before."""
    pulse = (1, 1000, ctypes.c_uint64(2**62))
    assert life.robot.stage.fk_limbs_pulse(*pulse) == NO_CRYSTAL
    life.session.request("ARM")
    assert life.robot.stage.fk_limbs_pulse(*pulse) == 0
    life.live(0.1)
    assert len(life.session.edges) == 2
    life.robot.stage.play_break_crystal()
    assert life.robot.stage.fk_limbs_pulse(*pulse) == NO_CRYSTAL
    assert len(life.session.edges) == 2


@from_ci
def test_eight_limbs_find_channels_beside_bluetooth_s(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each alone, and all of them: its controller leaves twelve channels of PPI."""
    options = defines(configuration(monkeypatch, ROBOT / "prj.conf"))
    life = Life(play(made, tmp_path, [*options, "-DDECLARED_EIGHT_LIMBS"]))
    life.session.request("ARM")
    for mask in (*(1 << limb for limb in range(8)), 0b11111111, 0b01010101, 0b10100110):
        seen = len(life.session.edges)
        assert life.robot.stage.fk_limbs_pulse(mask, 1000, ctypes.c_uint64(2**62)) == 0
        life.live(0.1)
        edges = life.session.edges[seen:]
        for level in (True, False):
            assert sum(1 << edge.limb for edge in edges if edge.level is level) == mask
        up_s, down_s = ({edge.time_s for edge in edges if edge.level is level} for level in (True, False))
        assert len(up_s) == len(down_s) == 1
        assert down_s.pop() - up_s.pop() == pytest.approx(1e-3, abs=1e-9)


def test_a_crystal_that_stops(life: Life) -> None:
    session = life.session
    session.request("ARM")
    life.live(1.0)
    life.robot.stage.play_break_crystal()
    session.post("STROKE", {"action": life.firing})
    life.live(0.5)
    status = session.request("STATUS")
    assert (status["state"], status["fault"]) == (STATE["FAULT"], link_layout().fault["CLOCK"])
    assert session.edges == []


@pytest.mark.parametrize("who", ["an interrupt", "a debugger"])
def test_a_pulse_that_is_held_up_around_its_beginning(life: Life, who: str) -> None:
    """By an interrupt that follows at once: nothing. By a debugger before it, so that it is late: FAULT."""
    session, stage = life.session, life.robot.stage
    session.request("ARM")
    life.live(1.0)
    (stage.play_interrupt if who == "an interrupt" else stage.play_halt)(ctypes.c_uint64(400))
    session.post("STROKE", {"action": life.firing})
    life.live(0.5)
    status, row = session.request("STATUS"), life.tables.actions[life.firing]
    ups = [edge for edge in session.edges if edge.level]
    if who == "an interrupt":
        assert (status["state"], status["fault"]) == (STATE["ARMED"], link_layout().fault["NONE"])
        assert len(ups) == row.first_mask.bit_count() + row.second_mask.bit_count()
    else:
        assert (status["state"], status["fault"]) == (STATE["FAULT"], link_layout().fault["PULSE"])
        assert ups == [], "switched off at once, and computing takes no time here"
    assert len(session.edges) == 2 * len(ups)


def test_a_supply_that_falls_disarms(life: Life) -> None:
    session, robot = life.session, life.robot
    session.request("ARM")
    session.request("STROKE", {"action": life.firing})
    life.live(0.02)
    assert session.edges[-1].level, "in a pulse"
    robot.stage.play_supply(1)
    life.live(0.005)
    assert not session.edges[-1].level and not robot.crystal_held
    status = session.request("STATUS")
    assert (status["state"], status["supply"]) == (STATE["DISARMED"], link_layout().supply["LOW"])
    with pytest.raises(LinkError, match="refuses ARM: SUPPLY"):
        session.request("ARM")
    robot.stage.play_supply(0)
    life.live(1.0)
    assert session.request("STATUS")["supply"] == link_layout().supply["FELL"]
    session.request("ARM")
    assert life.state() == STATE["ARMED"]


@from_ci
def test_a_battery_that_is_low_at_rest_disarms(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two batteries behind dividers of 5.7: 10.5 V are 1,843 mV at the pin. Sags do not count."""
    seeing = tmp_path / "seeing"
    shutil.copytree(made, seeing)
    robot = load_robot("frog2022")
    assert robot.battery is not None
    robot = replace(robot, battery=replace(robot.battery, inputs=(0, 3), divider=5.7))
    (seeing / "fk_robot_config.h").write_text(robot_config(robot))
    options = defines(configuration(monkeypatch, ROBOT / "prj.conf"))
    life = Life(play(seeing, tmp_path, options))
    session, stage = life.session, life.robot.stage
    with pytest.raises(LinkError, match="refuses ARM: SUPPLY"):
        session.request("ARM")
    stage.play_battery(0, 2000)
    stage.play_battery(1, 2000)
    life.live(3.0)
    session.request("ARM")
    session.request("STROKE", {"action": life.firing})
    stage.play_battery(1, 1500)
    life.live(0.2)
    stage.play_battery(1, 2000)
    life.live(2.0)
    assert life.state() == STATE["ARMED"]
    stage.play_battery(1, 1830)
    life.live(3.0)
    status = session.request("STATUS")
    assert (status["state"], status["supply"]) == (STATE["DISARMED"], link_layout().supply["LOW"])
    assert stage.play_asserts() == 0


def test_pairing_opens_after_a_power_on_and_shuts_after_three_failures(played: Path) -> None:
    robot = ZephyrRobot(played, played.parent)
    robot.advance(1.0)
    assert robot.pair(right=False) and robot.pair(right=True)  # one failure, then its owner
    assert [robot.pair(right=False) for _ in range(5)] == [True, True, True, False, False]
    assert not robot.pair(right=True), "until it is switched off and on"


@pytest.mark.parametrize(("level", "stays"), [(1, False), (2, False), (3, True), (4, True)])
def test_who_never_pairs_does_not_keep_the_only_connection(played: Path, level: int, stays: bool) -> None:
    """A minute after it connected, and each one anew; who pairs within it stays."""
    robot = ZephyrRobot(played, played.parent)
    for begin_s in (10.0, 1000.0):
        robot.advance(begin_s)
        robot.stage.play_security(1)
        robot.connect(subscribed=False)
        robot.advance(begin_s + 58.0)
        assert robot.stage.play_is_connected()
        robot.stage.play_security(level)
        robot.advance(begin_s + 62.0)
        assert bool(robot.stage.play_is_connected()) == stays
        if stays:
            robot.advance(begin_s + 600.0)
            assert robot.stage.play_is_connected()
            robot.stage.play_disconnect()


def test_nobody_new_pairs_late_or_after_a_watchdog_s_reset(played: Path) -> None:
    robot = ZephyrRobot(played, played.parent)
    robot.advance(3600.0)
    assert robot.pair(right=True), "nobody is bonded"
    assert not robot.pair(right=True), "somebody is, and the window is shut"
    again = ZephyrRobot(played, played.parent, 1 << 4)  # the watchdog, as hwinfo tells it
    again.advance(1.0)
    assert not again.pair(right=True)


def test_its_owner_over_the_radio(life: Life) -> None:
    """Key, proof, a stroke; and the crystal is asked for before an ARM with a code, too."""
    session = life.session
    key = bytes(range(32))
    session.request("KEY", auth.words("key", key))
    with pytest.raises(LinkError, match="refuses ARM: AUTH"):
        session.request("ARM")
    nonce = auth.challenge()
    session._auth = auth.begin(key, nonce, session.request("CHALLENGE", auth.words("nonce", nonce)))
    assert not life.robot.crystal_held
    session.request("ARM")
    assert life.robot.crystal_held
