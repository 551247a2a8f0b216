"""The robot's Zephyr application, as far as it can be checked without Zephyr: C, settings, devicetree, lives.

What this cannot show is that Zephyr's own code does as declared; firmware/robot/README.md says so.
"""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from devicetree import dtlib
from kconfiglib import Kconfig
from tests.loop import rig
from west.manifest import ImportFlag, Manifest
from zephyr_robot import DECLARED, ROBOT, ZephyrRobot, headers, play

from frogkick.link import auth
from frogkick.link.layout import link_layout
from frogkick.loop.session import LinkError, Session
from frogkick.robot import load_robot
from frogkick_codegen.firmware import build
from frogkick_codegen.toolchain import ToolchainError, zig

CORE, BENCH = ROBOT.parent / "core", ROBOT.parent / "bench"
BOARDS = ("nrf52dk_nrf52832", "bl652_dvk_nrf52832")
SOURCES = sorted((ROBOT / "src").glob("*.c"))
PAGE_BYTES, FLASH_BYTES = 4096, 512 * 1024
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wmissing-prototypes", "-Werror")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `frogkick firmware build` leaves, and the application's CMake file takes."""
    folder = tmp_path_factory.mktemp("made")
    build("bench", rig.small_table(), load_robot("frog2022"), folder / "out")
    return folder / "out"


def configuration(monkeypatch: pytest.MonkeyPatch, *settings: Path) -> Kconfig:
    monkeypatch.setenv("srctree", str(DECLARED))
    found = Kconfig(str(ROBOT / "Kconfig"), warn_to_stderr=False)
    for number, file in enumerate(settings):
        found.load_config(str(file), replace=number == 0)
    return found


def check(source: str, made: Path, folder: Path, options: list[str]) -> None:
    """Let the compiler judge a source, with every header of Zephyr's the declarations."""
    headers(source, folder / "include")
    (folder / "source.c").write_text(source)
    includes = [folder / "include", DECLARED, ROBOT / "src", CORE, made, made / "emitted"]
    flags = ["-std=gnu11", *WARNINGS, *(f"-I{path}" for path in includes), *options]
    zig("host").run([*flags, "-c", "source.c", "-o", "source.o"], folder)


def defines(found: Kconfig) -> list[str]:
    told = []
    for symbol in found.unique_defined_syms:
        if symbol.str_value not in ("n", ""):
            quoted = symbol.name == "BT_DEVICE_NAME"
            value = f'"{symbol.str_value}"' if quoted else symbol.str_value.replace("y", "1")
            told.append(f"-DCONFIG_{symbol.name}={value}")
    return told


@pytest.mark.parametrize("source", [source.name for source in SOURCES])
@pytest.mark.parametrize("open_link", [False, True])
@pytest.mark.parametrize("version", ["3, 7, 0", "4, 2, 0"])
def test_the_c_compiles_against_what_zephyr_declares(
    source: str, open_link: bool, version: str, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = configuration(monkeypatch, ROBOT / "prj.conf")
    if open_link:
        found.syms["FROGKICK_OPEN_LINK"].set_value("y")
    options = [*defines(found), f"-DZEPHYR_VERSION_CODE=ZEPHYR_VERSION({version})"]
    check((ROBOT / "src" / source).read_text(), made, tmp_path, options)


@pytest.mark.parametrize(
    ("source", "before", "after"),
    [
        ("limbs.c", "nrfx_gpiote_init(&gpiote, 0)", "nrfx_gpiote_init(0)"),
        ("radio.c", "(void)atomic_inc(&dropped_frames)", "(void)atomic_inc(dropped_frames)"),
        ("main.c", "fk_robot_tick(&robot, begin_us, &outputs)", "fk_robot_tick(&robot, &outputs)"),
    ],
)
def test_a_wrong_call_does_not(
    source: str, before: str, after: str, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (ROBOT / "src" / source).read_text()
    assert text.count(before) == 1
    options = defines(configuration(monkeypatch, ROBOT / "prj.conf"))
    with pytest.raises(ToolchainError):
        check(text.replace(before, after), made, tmp_path, options)


def test_the_configuration_is_taken_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every line of prj.conf names a symbol that there is, of its type and range, with what it needs."""
    found = configuration(monkeypatch, ROBOT / "prj.conf")
    assert found.warnings == []
    for line in (ROBOT / "prj.conf").read_text().splitlines():
        if line and not line.startswith("#"):
            name, value = line.removeprefix("CONFIG_").split("=", 1)
            assert found.syms[name].str_value == value.strip('"'), line
    assert found.syms["FROGKICK_OPEN_LINK"].str_value == "n", "secure unless asked otherwise"
    assert found.syms["BT_SMP_SC_ONLY"].str_value == "y"


def test_the_link_asks_for_an_authenticated_host() -> None:
    source = (ROBOT / "src" / "radio.c").read_text()
    secure = source.split("#else")[1].split("#endif")[0]
    assert set(re.findall(r"BT_GATT_PERM_(\w+)", secure)) == {"WRITE_AUTHEN", "READ_AUTHEN"}
    service = source.split("BT_GATT_SERVICE_DEFINE")[1].split("#define")[0]
    assert set(re.findall(r"BT_GATT_PERM_(\w+)", service)) == {"NONE"}, "nothing else is read or written"


@pytest.mark.parametrize("board", BOARDS)
def test_the_devicetree_cuts_the_flash_and_names_the_limbs(board: str, tmp_path: Path) -> None:
    overlay = ROBOT / "boards" / f"{board}.overlay"
    board_name = board.removesuffix("_nrf52832").upper()
    text = f"#define {board_name}\n#define GPIO_ACTIVE_HIGH 0\n"
    text += f'#include "{DECLARED / "board.dts"}"\n#include "{overlay}"\n'
    (tmp_path / "all.h").write_text(text)
    zig("host").run(["-E", "-P", "-x", "assembler-with-cpp", "all.h", "-o", "all.dts"], tmp_path)
    tree = dtlib.DT(str(tmp_path / "all.dts"))
    parts = []
    for node in tree.get_node("/flash@0/partitions").nodes.values():
        begin, size = node.props["reg"].to_nums()
        assert node.name == f"partition@{begin:x}"
        assert begin % PAGE_BYTES == 0 and size % PAGE_BYTES == 0
        parts.append((begin, size))
    ends = [begin + size for begin, size in sorted(parts)]
    assert [begin for begin, _ in sorted(parts)] == [0, *ends[:-1]], "side by side"
    assert ends[-1] == FLASH_BYTES
    slots = tree.label2node["tables_partition"].props["reg"].to_nums()[1] - 2 * PAGE_BYTES
    assert slots % (2 * PAGE_BYTES) == 0 and slots // 2 >= 64 * 1024
    code = tree.get_node("/chosen").props["zephyr,code-partition"].to_path()
    assert code is tree.label2node["app_partition"]
    cells = np.frombuffer(tree.label2node["limbs"].props["gpios"].value, dtype=">u4").tolist()
    pins = re.search(r"FK_BOARD_LIMB_PINS \{([^}]*)\}", (BENCH / "board.h").read_text())
    assert pins is not None
    limbs = len(load_robot("frog2022").limbs)
    assert cells[1::3] == [int(pin.rstrip("u")) for pin in pins[1].split(", ")][:limbs]
    assert set(cells[2::3]) == {0}, "high is heating"


def test_lists_and_bindings_name_what_is_there() -> None:
    manifest = yaml.safe_load((ROBOT / "west.yml").read_text())["manifest"]
    (zephyr,) = manifest["projects"]
    assert manifest["self"]["path"] == "frogkick"
    assert re.fullmatch(r"v\d+\.\d+\.\d+", zephyr["revision"]), "pinned to a release"
    sample = yaml.safe_load((ROBOT / "sample.yaml").read_text())
    boards = {board for test in sample["tests"].values() for board in test["platform_allow"]}
    assert boards == {"nrf52dk/nrf52832", "bl652_dvk"}
    binding = yaml.safe_load((ROBOT / "dts" / "bindings" / "frogkick,limbs.yaml").read_text())
    assert binding["compatible"] == "frogkick,limbs"
    listed = (ROBOT / "CMakeLists.txt").read_text()
    assert {f"src/{source.name}" for source in SOURCES} == set(re.findall(r"src/\w+\.c", listed))


def test_the_readme_s_west_finds_its_workspace(tmp_path: Path) -> None:
    """Its lines up to the first that needs a network, with west itself and a copy for the clone."""
    lines = (ROBOT / "README.md").read_text().split("## Build")[1].split("```")[1].split("\n")
    (init,) = [line.split(" && ")[0] for line in lines if line.startswith("west init")]
    (clone,) = [line.split()[-1] for line in lines if line.startswith("git clone")]
    shutil.copytree(ROBOT, tmp_path / clone / "firmware" / "robot")
    done = subprocess.run([sys.executable, "-m", *init.split()], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    west = Manifest.from_topdir(tmp_path, import_flags=ImportFlag.IGNORE)
    assert west.repo_abspath == str(tmp_path / clone)
    assert [project.name for project in west.projects] == ["manifest", "zephyr"]
    build = next(line for line in lines if line.startswith("west build"))
    assert (tmp_path / build.split(" -- ")[0].split()[-1] / "CMakeLists.txt").is_file()


def test_the_core_s_limit_is_the_port_s() -> None:
    limit = re.compile(r"_PULSE_MAX_US (\d+)u")
    found = [limit.search(file.read_text()) for file in (ROBOT / "src" / "limbs.h", BENCH / "board.h")]
    assert {match[1] for match in found if match} == {"100000"}


# Lives


@pytest.fixture(scope="module")
def played(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        options = defines(configuration(patch, ROBOT / "prj.conf"))
    return play(made, tmp_path_factory.mktemp("played"), [*options, "-DFK_LOG_BYTES=16384u"])


RESTED_S = 5.1
"""Its RAM kept nothing: it lets its limbs rest first."""


class Life:
    """A robot and a host that talks to it."""

    def __init__(self, played: Path, mtu: int = 247) -> None:
        self.tables = rig.tables()
        self.robot = ZephyrRobot(played, played.parent)
        self.session = Session(self.robot)
        self.session.step(RESTED_S)
        self.robot.connect(mtu)
        self.session.greet(self.tables)

    @property
    def firing(self) -> int:
        return next(i for i, row in enumerate(self.tables.actions) if row.first_mask and row.second_mask)

    def live(self, for_s: float) -> None:
        self.session.step(self.session.time_s + for_s)

    def state(self) -> int:
        return int(self.session.request("STATUS")["state"])


STATE = link_layout().state


@pytest.fixture
def life(played: Path) -> Life:
    return Life(played)


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
    told = session.take("STATUS")
    assert told and life.robot.bad_frames == 0, "what was kept comes whole"
    assert life.state() == STATE["DISARMED"]
    assert session.request("STATUS")["answers_dropped"] == 40 - len(told), "what found no room is counted"
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
    told = session.request("STATUS")
    assert told["state"] == STATE["DISARMED"]
    assert told["answers_dropped"] > 0
    assert life.robot.bad_frames == 0


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
    told = session.request("STATUS")
    if error == 12:  # no buffer for a while: repeated
        assert arrived == [first] and told["answers_dropped"] == 0 and life.robot.bad_frames == 0
    else:
        lost = 0 if first in arrived else 1
        assert told["answers_dropped"] == lost
        assert life.robot.bad_frames <= lost
        assert lost == (after < 4), "an answer of 62 bytes"


def test_who_does_not_listen_is_not_waited_for(played: Path) -> None:
    life = Life(played)
    life.robot.stage.play_refuse(-22, 0)
    for _ in range(30):
        life.session.post("STATUS")
        life.live(0.02)
    life.robot.stage.play_refuse(0, 0)
    assert life.session.request("STATUS")["answers_dropped"] == 30


def test_the_loop_itself_never_calls_the_radio(life: Life) -> None:
    life.session.request("STATUS")
    assert life.robot.stage.play_notified_by() == 1, "the thread of its own"


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
    assert begun and begun[0].time_s * 1e6 >= robot.stage.play_crystal_held_us() + 1500
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


def test_a_crystal_that_stops(life: Life) -> None:
    session = life.session
    session.request("ARM")
    life.live(1.0)
    life.robot.stage.play_break_crystal()
    session.post("STROKE", {"action": life.firing})
    life.live(0.5)
    told = session.request("STATUS")
    assert (told["state"], told["fault"]) == (STATE["FAULT"], link_layout().fault["CLOCK"])
    assert session.edges == []


def test_a_supply_that_falls_disarms(life: Life) -> None:
    session, robot = life.session, life.robot
    session.request("ARM")
    session.request("STROKE", {"action": life.firing})
    life.live(0.02)
    assert session.edges[-1].level, "in a pulse"
    robot.stage.play_supply(1)
    life.live(0.005)
    assert not session.edges[-1].level and not robot.crystal_held
    told = session.request("STATUS")
    assert (told["state"], told["supply"]) == (STATE["DISARMED"], link_layout().supply["LOW"])
    with pytest.raises(LinkError, match="refuses ARM: SUPPLY"):
        session.request("ARM")
    robot.stage.play_supply(0)
    life.live(1.0)
    assert session.request("STATUS")["supply"] == link_layout().supply["FELL"]
    session.request("ARM")
    assert life.state() == STATE["ARMED"]


def test_pairing_opens_after_a_power_on_and_shuts_after_three_failures(played: Path) -> None:
    robot = ZephyrRobot(played, played.parent)
    robot.advance(1.0)
    assert robot.pair(right=False) and robot.pair(right=True)  # one failure, then its owner
    assert [robot.pair(right=False) for _ in range(5)] == [True, True, True, False, False]
    assert not robot.pair(right=True), "until it is switched off and on"


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
