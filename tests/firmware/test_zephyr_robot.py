"""The robot's Zephyr application, as far as it can be checked without Zephyr: C, settings, devicetree.

What this cannot show is that Zephyr's own code does as declared; firmware/robot/README.md says so.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from devicetree import dtlib
from kconfiglib import TRI_TO_STR
from tests.conftest import from_ci, some
from west.manifest import ImportFlag, Manifest
from zephyr_robot import DECLARED, ROBOT, VERSIONS, configuration, defines, headers

from frogkick.robot import load_robot
from frogkick_codegen.toolchain import ToolchainError, zig

CORE, BENCH = ROBOT.parent / "core", ROBOT.parent / "bench"
BOARDS = ("nrf52dk_nrf52832", "bl652_dvk_nrf52832")
SOURCES = sorted((ROBOT / "src").glob("*.c"))
PAGE_BYTES, FLASH_BYTES = 4096, 512 * 1024
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wmissing-prototypes", "-Werror")


def check(source: str, made: Path, folder: Path, options: list[str]) -> None:
    """Let the compiler judge a source, with every header of Zephyr's the declarations."""
    headers(source, folder / "include")
    (folder / "source.c").write_text(source)
    includes = [folder / "include", DECLARED, ROBOT / "src", CORE, made, made / "emitted"]
    flags = ["-std=gnu11", *WARNINGS, *(f"-I{path}" for path in includes), *options]
    zig("host").run([*flags, "-c", "source.c", "-o", "source.o"], folder)


@from_ci
@pytest.mark.parametrize("source", [source.name for source in SOURCES])
@pytest.mark.parametrize("open_link", some([False, True], 1))
@pytest.mark.parametrize("version", VERSIONS)
def test_the_c_compiles_against_what_zephyr_declares(
    source: str, open_link: bool, version: str, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = configuration(monkeypatch, ROBOT / "prj.conf", version=version)
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


@pytest.mark.parametrize(
    ("source", "option", "message"),
    [
        ("limbs.c", "-DNRFX_CONFIG_API_VER_MAJOR=4", "written for nrfx 3"),
        ("flash.c", "-UCONFIG_USE_DT_CODE_PARTITION", "may lie over the tables"),
    ],
)
def test_a_build_that_cannot_be_right_is_refused(
    source: str, option: str, message: str, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another nrfx; the whole flash for the program."""
    options = [*defines(configuration(monkeypatch, ROBOT / "prj.conf")), option]
    with pytest.raises(ToolchainError, match=message):
        check((ROBOT / "src" / source).read_text(), made, tmp_path, options)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_configuration_is_taken_whole(
    version: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Every line of prj.conf names a symbol that there is, of its type and range, with what it needs.

    Before it are read the lines of both boards that it takes back.
    """
    board = tmp_path / "board_defconfig"
    board.write_text("CONFIG_USE_SEGGER_RTT=y\nCONFIG_RTT_CONSOLE=y\n")
    found = configuration(monkeypatch, board, ROBOT / "prj.conf", version=version)
    assert found.warnings == []
    for symbol in found.unique_defined_syms:  # Zephyr warns of each that did not get what was asked for last
        asked = symbol.user_value
        assert asked is None or symbol.str_value == (TRI_TO_STR[asked] if isinstance(asked, int) else asked)
    told_by = {name for name in ("BT_FIXED_PASSKEY", "BT_APP_PASSKEY") if found.syms[name].str_value == "y"}
    assert told_by == {"BT_APP_PASSKEY" if version == "4, 3, 0" else "BT_FIXED_PASSKEY"}
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
    text += "#define NRF_PSEL(function, port, pin) (32 * (port) + (pin))\n"
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
    for label in tree.label2node.keys() & {"spi2"}:
        assert tree.label2node[label].props["status"].to_string() == "disabled", "its pins are the limbs'"
    for label in ("uart0_default", "uart0_sleep"):
        console = tree.label2node[label].nodes["group1"].props["psels"].to_nums()
        assert not set(console) & {2, 3, 4, 5, 28, 29, 30, 31}, "where a battery may be measured"


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
    vendors = (ROBOT / "dts" / "bindings" / "vendor-prefixes.txt").read_text().splitlines()
    assert [line.split("\t")[0] for line in vendors] == ["frogkick"], (
        "one line for each, name and text with a tab between"
    )
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
    (build,) = [line.split()[0] for line in lines if "build.sh" in line]
    assert os.access(tmp_path / build, os.X_OK)


def test_the_core_s_limit_is_the_port_s() -> None:
    limit = re.compile(r"_PULSE_MAX_US (\d+)u")
    found = [limit.search(file.read_text()) for file in (ROBOT / "src" / "limbs.h", BENCH / "board.h")]
    assert {match[1] for match in found if match} == {"100000"}


# Lives
