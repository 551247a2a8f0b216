"""Emitted directories: they build alone, repeat byte for byte, and replace nothing foreign."""

from __future__ import annotations

import errno
import hashlib
import itertools
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile
from tests.conftest import from_ci, some
from tests.planner import synthetic

from frogkick.core.errors import InputError
from frogkick.core.weights import WEIGHTS
from frogkick.planner.plan import Cost, PlanConfig, plan
from frogkick.tables.image import TableError, open_image
from frogkick_codegen import toolchain
from frogkick_codegen.emit import BUILD_COMMAND, SOURCES, emit, portable_command

IMAGE = synthetic.image()
COMMAND = "frogkick codegen frog.fkt --out planner"
NAMES = {
    "README.md", "cost.c", "example_main.c", "fk_config.h", "fk_internal.h", "fk_planner.h",
    "fk_route.h", "fk_search.h", "fk_sizes.h", "fk_table.c", "fk_table.h", "fk_tables.h", "fk_trig.h",
    "lookup.c", "math.c", "nearest.c", "path.c", "plan.c", "route.c", "search_beam.c", "tables.c",
    "tables_check.c", "tree.c", "wear.c",
}  # fmt: skip


@pytest.fixture(scope="module")
def emitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("emit") / "planner"
    emit(IMAGE, folder, COMMAND)
    return folder


def readme_command(folder: Path) -> list[str]:
    """Return the one command of the README, without the compiler's name."""
    lines = (folder / "README.md").read_text().splitlines()
    command = lines[lines.index("```sh") + 1]
    assert command == BUILD_COMMAND
    words = command.split()
    assert words[0] == "cc"
    return words[1:]


def test_the_hashes_are_those_of_the_files(tmp_path: Path) -> None:
    hashes = emit(IMAGE, tmp_path / "out", COMMAND)
    assert set(hashes) == NAMES == {entry.name for entry in (tmp_path / "out").iterdir()}
    for name, digest in hashes.items():
        assert hashlib.sha256((tmp_path / "out" / name).read_bytes()).hexdigest() == digest


def test_the_same_input_gives_the_same_bytes_wherever_it_stands(tmp_path: Path) -> None:
    file = tmp_path / "frog.fkt"
    file.write_bytes(IMAGE)
    one = emit(IMAGE, tmp_path / "one", "frogkick codegen frog.fkt --out=planner")
    two = emit(file, tmp_path / "deep" / "two", f"frogkick codegen {file} --out={tmp_path}/planner")
    assert one == two
    assert emit(IMAGE, tmp_path / "one", "frogkick codegen frog.fkt --out=planner") == one
    for entry in (tmp_path / "one").iterdir():
        assert str(tmp_path) not in entry.read_text()
    assert emit(synthetic.image(seed=2), tmp_path / "three", COMMAND) != one


def test_the_first_lines_say_where_it_comes_from(emitted: Path) -> None:
    provenance = bytes(range(32)).hex()
    for name in NAMES:
        head = "\n".join((emitted / name).read_text().splitlines()[:8])
        assert "Do not edit: made by frogkick codegen 0." in head
        assert "table image format 2, kind nearest" in head
        assert f"library SHA-256 {provenance}" in head
        assert "robot frog2022, " in head
        zeros = (len(WEIGHTS) - 8) * ",0.0f"
        weights = f"500.0f,50.0f,300.0f,0.300000012f{zeros},-1000.0f,1000.0f,-1000.0f,1000.0f"
        settings = f"{weights},1,0,0"
        assert re.search(rf"configuration SHA-256 [0-9a-f]{{64}} \({re.escape(settings)}\)", head)
        assert f"command: {COMMAND}" in head
        assert f"flash: {len(IMAGE)} bytes of table" in head


def test_the_robot_s_hash_is_written_where_it_is_known(tmp_path: Path) -> None:
    emit(IMAGE, tmp_path / "out", COMMAND, robot_sha256=b"\xab" * 32)
    assert "robot frog2022, SHA-256 " + "ab" * 32 in (tmp_path / "out" / "tree.c").read_text()


@pytest.mark.parametrize("name", ["zig", pytest.param("gcc", marks=pytest.mark.extra)])
def test_the_directory_builds_alone_with_its_one_command_and_runs(
    emitted: Path, name: str, tmp_path: Path
) -> None:
    compiler = toolchain.zig() if name == "zig" else toolchain.other(name)
    if compiler is None:
        pytest.skip(f"{name} is not installed")
    work = tmp_path / "copy"
    work.mkdir()
    for entry in emitted.iterdir():
        (work / entry.name).write_bytes(entry.read_bytes())
    compiler.run(readme_command(work), folder=work)
    result = subprocess.run([work / "example"], capture_output=True, text=True, check=True, timeout=300)
    tables = open_image(IMAGE)
    line = synthetic.WavePath(
        np.float32(0.5) * np.arange(100, dtype=np.float32) / np.float32(99),
        np.zeros(100, dtype=np.float32),
        np.zeros(100, dtype=np.float32),
    )
    state = np.array([0, 0.02, 0, 0, 0, 0], dtype=np.float32)
    printed = result.stdout.splitlines()
    assert len(printed) == 8
    for period, text in enumerate(printed):
        wanted = plan(tables, line, PlanConfig(), state)
        action = tables.actions[wanted.action]
        assert text.startswith(f"period {period}: action {action.name} (limbs 0x{action.first_mask:02x}, ")
        assert (
            f"state row {wanted.nearest_state}, path point {wanted.path_index}, cost {int(wanted.cost)}, "
            in text
        )
        state = wanted.predicted


@from_ci
@pytest.mark.parametrize("level", some(["-O2", "-O0", "-Os"], 1))
def test_it_links_for_the_chip_without_any_library(emitted: Path, tmp_path: Path, level: str) -> None:
    """Nothing undefined but what a start-up file gives: the compiler may ask for memcpy and memset."""
    flags = [flag for flag in toolchain.FLAGS if not flag.startswith("-O")]
    undefined, defined = set(), set()
    for source in SOURCES:
        target = tmp_path / f"{source}.o"
        flags_here = [*flags, level, "-fno-sanitize=undefined", "-fno-exceptions", "-fno-unwind-tables"]
        toolchain.zig("chip").run([*flags_here, "-c", emitted / source, "-o", target])
        with target.open("rb") as file:
            for symbol in ELFFile(file).get_section_by_name(".symtab").iter_symbols():
                if symbol.name and symbol["st_shndx"] == "SHN_UNDEF":
                    undefined.add(symbol.name)
                elif symbol.name:
                    defined.add(symbol.name)
    allowed = {"memcpy", "memset", "__aeabi_memcpy", "__aeabi_memcpy4", "__aeabi_memclr", "__aeabi_memclr4"}
    unwinding = {name for name in undefined if name.startswith("__aeabi_unwind")}
    assert undefined - defined - unwinding <= allowed


def test_the_table_in_the_c_is_the_image(emitted: Path) -> None:
    text = (emitted / "fk_table.c").read_text()
    data = text[text.index("= {") : text.index("};")]
    assert bytes(int(byte, 16) for byte in re.findall(r"0x[0-9a-f]{2}", data)) == IMAGE
    assert f"#define FK_TABLE_IMAGE_BYTES {len(IMAGE)}U" in (emitted / "fk_table.h").read_text()


def test_a_table_with_a_byte_too_few_does_not_compile(emitted: Path, tmp_path: Path) -> None:
    for name in ("fk_table.c", "fk_table.h"):
        (tmp_path / name).write_text((emitted / name).read_text())
    cut = re.sub(r"0x[0-9a-f]{2},\n};", "\n};", (tmp_path / "fk_table.c").read_text())
    (tmp_path / "fk_table.c").write_text(cut)
    with pytest.raises(toolchain.ToolchainError, match="fk_table_bytes_are_all_here"):
        toolchain.zig("chip").run([*toolchain.FLAGS, "-c", "fk_table.c", "-o", "x.o"], folder=tmp_path)


def test_an_emitted_directory_is_replaced_even_after_its_example_was_built(tmp_path: Path) -> None:
    folder = tmp_path / "planner"
    emit(IMAGE, folder, COMMAND)
    (folder / "example").write_bytes(b"a program")
    emit(synthetic.image(seed=2), folder, COMMAND)
    assert {entry.name for entry in folder.iterdir()} == NAMES
    assert [entry.name for entry in tmp_path.iterdir()] == ["planner"]


@pytest.mark.parametrize("name", ["main.c", "tree.c"])
def test_a_foreign_directory_is_not_touched(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    (folder / name).write_text("int main(void) { return 0; }\n")
    with pytest.raises(InputError, match=rf"holds '{name}', which codegen did not write"):
        emit(IMAGE, folder, COMMAND)
    assert [entry.name for entry in folder.iterdir()] == [name]
    assert [entry.name for entry in tmp_path.iterdir()] == ["work"]


def test_a_file_in_the_way_and_an_empty_directory(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file: name a directory"):
        emit(IMAGE, tmp_path / "file", COMMAND)
    with pytest.raises(InputError, match="cannot write"):
        emit(IMAGE, tmp_path / "file" / "under", COMMAND)
    (tmp_path / "empty").mkdir()
    assert set(emit(IMAGE, tmp_path / "empty", COMMAND)) == NAMES


def test_a_bad_image_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(TableError):
        emit(IMAGE[:-1], tmp_path / "out", COMMAND)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("config", "text"),
    [
        (PlanConfig(depth=5), "depth is 5"),
        (PlanConfig(angle_weight_per_rad=-1.0), "weights are"),
        (PlanConfig(turn_lead=2.1), "turn_lead 2"),
        (PlanConfig(cost=2), "cost is 2"),
        (PlanConfig(transitions_max=-1), "transitions_max is -1"),
    ],
)
def test_a_configuration_that_the_planner_would_refuse_is_not_emitted(
    tmp_path: Path, config: PlanConfig, text: str
) -> None:
    with pytest.raises(InputError, match=text):
        emit(IMAGE, tmp_path / "out", COMMAND, config)
    assert not list(tmp_path.iterdir())


def test_the_configuration_is_written_to_the_last_bit(tmp_path: Path) -> None:
    awkward = itertools.cycle((1e-40, 123.456789, 1e6, 1 / 3, 1e5 / 7, 1.9999999, 55.50001))
    weights = {name: min(next(awkward), each.most) for name, each in WEIGHTS.items()}
    weights["wall_x_min_m"] = -1e-40
    config = PlanConfig(**weights, depth=3, cost=Cost.ROUTE, transitions_max=12345)
    emit(IMAGE, tmp_path / "out", COMMAND, config)
    text = (tmp_path / "out" / "fk_config.h").read_text()
    values = re.findall(r"#define FK_CONFIG_\w+ (\S+)f$", text, flags=re.MULTILINE)
    wanted = np.array([getattr(config, name) for name in WEIGHTS], dtype=np.float32)
    np.testing.assert_array_equal(np.array(values, dtype=np.float32), wanted)
    for line in ("DEPTH 3U", "COST 1U", "TRANSITIONS_MAX 12345U"):
        assert f"#define FK_CONFIG_{line}" in text
    rows = dict(
        re.findall(r"^\| (\S.*) \| (\S.*) \|$", (tmp_path / "out/README.md").read_text(), re.MULTILINE)
    )
    assert rows["cost"] == "route"
    assert [np.float32(rows[f"`{name}`"]) for name in WEIGHTS] == wanted.tolist()


@pytest.mark.parametrize(
    ("command", "portable"),
    [
        ("frogkick codegen a.fkt --out b", "frogkick codegen a.fkt --out b"),
        ("/usr/bin/frogkick codegen /home/me/a.fkt --out=/tmp/b", "frogkick codegen a.fkt --out=b"),
        ("frogkick codegen '/home/me/my table.fkt'", "frogkick codegen 'my table.fkt'"),
    ],
)
def test_commands_lose_this_machine_s_folders(command: str, portable: str) -> None:
    assert portable_command(command) == portable


@pytest.mark.parametrize("command", ["", "a\nb", "a */ b", "a --> b", "a 'b"])
def test_commands_that_would_break_a_comment_are_refused(command: str) -> None:
    with pytest.raises(InputError, match="command"):
        portable_command(command)


def test_a_disk_without_room_for_a_folder_keeps_none_of_those_above(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(**_given: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "mkdtemp", full)
    with pytest.raises(InputError, match="No space left on device"):
        emit(IMAGE, tmp_path / "a" / "b" / "out", COMMAND)
    assert not list(tmp_path.iterdir())
