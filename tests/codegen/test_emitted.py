"""An emitted directory for a reader: its README, its ten lines, its sizes, C and C++."""

from __future__ import annotations

import dataclasses
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile
from tests.codegen import made_up
from tests.conftest import from_ci, some

import frogkick as fk
from frogkick.front.building import measure_emitted
from frogkick.planner.plan import PlanConfig, config_of, plan
from frogkick.tables.image import open_image
from frogkick_codegen import toolchain
from frogkick_codegen.emit import PARTS, SOURCES, Figures, build_planner, emit
from frogkick_codegen.native import planner_files

COMMAND = "frogkick codegen frog.fkt --out planner"
STATES = {1: 6, 2: 3}
HEADERS = ("fk_planner.h", "fk_tables.h", "fk_table.h", "fk_config.h", "fk_sizes.h")


@dataclasses.dataclass(frozen=True)
class Emitted:
    """A directory and what was measured of it."""

    image: bytes
    folder: Path
    figures: Figures


@pytest.fixture(scope="module", params=some(made_up.KINDS, 1))
def emitted(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Emitted:
    work = tmp_path_factory.mktemp("emitted")
    image = made_up.image(request.param)
    (work / "t.fkt").write_bytes(image)
    figures = measure_emitted((work / "t.fkt").read_bytes(), states=STATES)
    emit(image, work / "planner", COMMAND, figures=figures)
    return Emitted(image, work / "planner", figures)


def block(folder: Path, language: str) -> str:
    """Return the README's only block of a language."""
    found = re.findall(rf"^```{language}\n(.*?)^```$", (folder / "README.md").read_text(), re.M | re.S)
    assert len(found) == 1
    return str(found[0])


def run(program: Path) -> int:
    return subprocess.run([program], capture_output=True, check=False, timeout=300).returncode


def first_action(image: bytes) -> int:
    """What the twin chooses for the README's example."""
    ends, flat = np.array([0.0, 0.5], dtype=np.float32), np.zeros(2, dtype=np.float32)

    class Line:
        x_m, y_m, tangent_rad = ends, flat, flat

    return plan(open_image(image), Line(), PlanConfig(), np.zeros(6, dtype=np.float32)).action


@from_ci
def test_the_readme_names_every_file(emitted: Emitted) -> None:
    text = (emitted.folder / "README.md").read_text()
    for file in emitted.folder.iterdir():
        assert file.name == "README.md" or f"`{file.name}`" in text
    assert {name for names in PARTS for name in names} >= {
        name for name in planner_files() if name not in HEADERS
    }


@from_ci
def test_the_readme_s_ten_lines_build_run_and_decide(emitted: Emitted, tmp_path: Path) -> None:
    code = block(emitted.folder, "c")
    body = code[code.index("{") + 1 : code.rindex("}")]
    assert len([line for line in body.splitlines() if line.strip(" }")]) <= 10
    (tmp_path / "main.c").write_text(code)
    sources = [emitted.folder / name for name in SOURCES]
    flags = [flag for flag in toolchain.FLAGS if flag != "-Wmissing-prototypes"]
    toolchain.zig().run([*flags, f"-I{emitted.folder}", "main.c", *sources, "-o", "main"], folder=tmp_path)
    assert run(tmp_path / "main") == first_action(emitted.image)


def cpp_compiler(name: str) -> toolchain.Compiler:
    if name == "zig":
        driver = toolchain.zig()
        return dataclasses.replace(driver, command=(*driver.command[:-1], "c++"))
    found = toolchain.other("gcc")
    if found is None:
        pytest.skip("gcc is not installed")
    return dataclasses.replace(found, command=(found.command[0].replace("gcc", "g++"),))


@pytest.mark.parametrize("name", ["zig", pytest.param("g++", marks=pytest.mark.extra)])
@pytest.mark.parametrize("standard", ["-std=c++11", "-std=c++20"])
def test_a_cpp_program_includes_the_headers_and_links(
    emitted: Emitted, name: str, standard: str, tmp_path: Path
) -> None:
    code = block(emitted.folder, "c")
    includes = "".join(f'#include "{header}"\n' for header in HEADERS)
    (tmp_path / "main.cpp").write_text(includes + code.replace("= {0};", "= {};"))
    warnings = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror")
    arguments = [standard, *warnings, f"-I{emitted.folder}", "-c", "main.cpp", "-o", "cpp.o"]
    cpp_compiler(name).run(arguments, folder=tmp_path)
    # Linked as C: it uses nothing of the C++ library, which zig would first build for a minute.
    sources = [emitted.folder / source for source in SOURCES]
    flags = ["-O1", *toolchain.FLOAT_RULES, f"-I{emitted.folder}"]
    toolchain.zig().run([*flags, "cpp.o", *sources, "-o", "main"], folder=tmp_path)
    assert run(tmp_path / "main") == first_action(emitted.image)


@pytest.mark.parametrize("header", HEADERS)
def test_each_header_stands_alone(emitted: Emitted, header: str, tmp_path: Path) -> None:
    (tmp_path / "alone.c").write_text(f'#include "{header}"\n#include "{header}"\ntypedef int fk_used_t;\n')
    arguments = [*toolchain.FLAGS, "-Wpedantic", f"-I{emitted.folder}", "-c", "alone.c", "-o", "alone.o"]
    toolchain.zig().run(arguments, folder=tmp_path)


def defined(folder: Path) -> dict[str, int]:
    text = (folder / "fk_sizes.h").read_text()
    return {name: int(value) for name, value in re.findall(r"#define FK_SIZE_(\w+) (\d+)U", text)}


@from_ci
def test_the_sizes_are_those_of_the_image(emitted: Emitted, tmp_path: Path) -> None:
    sizes = defined(emitted.folder)
    elf = build_planner(emitted.folder, tmp_path / "planner.elf")
    with elf.open("rb") as file:
        content = ELFFile(file)
        text = content.get_section_by_name(".text")["sh_size"]
        static = sum(content.get_section_by_name(name)["sh_size"] for name in (".data", ".bss"))
    assert sizes["FLASH_TABLE"] == len(emitted.image)
    start_up = text - sizes["FLASH_TABLE"] - sizes["FLASH_CODE"]
    # Vectors, reset, memcpy, main; up to 1023 bytes before the search, which begins at a whole KiB.
    assert 0 < start_up < 700 + 1023
    assert sizes["RAM_STATIC"] == static == 0
    assert sizes["RAM_PATH"] == 4 + 3 * 400
    assert sizes["STACK_PLAN"] > sizes["STACK_TABLES_OPEN"] > 0
    text_of = (emitted.folder / "README.md").read_text()
    for value in (sizes["FLASH_CODE"], sizes["RAM_TABLES"], sizes["STACK_PLAN"]):
        assert f" {value}" in text_of


def test_the_readme_tells_the_times_that_were_counted(emitted: Emitted) -> None:
    text = (emitted.folder / "README.md").read_text()
    times = emitted.figures.times
    assert set(times) == set(STATES)
    for depth, time in times.items():
        assert 0.0 < time.mean_ms <= time.worst_ms
        line = f"| `fk_plan()`, depth {depth} | {time.mean_ms:.2f} ms mean, {time.worst_ms:.2f} ms worst of "
        assert line + f"{time.states} states" in text
    assert times[2].mean_ms > 2 * times[1].mean_ms


@from_ci
def test_the_same_table_gives_the_same_figures(emitted: Emitted, tmp_path: Path) -> None:
    (tmp_path / "other.fkt").write_bytes(emitted.image)
    assert measure_emitted((tmp_path / "other.fkt").read_bytes(), states=STATES) == emitted.figures


def test_without_figures_the_directory_says_so(tmp_path: Path) -> None:
    emit(made_up.image("affine"), tmp_path / "planner", COMMAND)
    assert set(defined(tmp_path / "planner")) == {"FLASH_TABLE"}
    assert "were not measured" in (tmp_path / "planner" / "README.md").read_text()


def names_of(files: Sequence[Path]) -> set[str]:
    return {file.name for file in files}


@from_ci
def test_every_warning_is_an_error_and_none_is_there(emitted: Emitted, tmp_path: Path) -> None:
    """Beyond the README's own command: what clang knows besides."""
    more = (
        "-Wpedantic",
        "-Wshadow",
        "-Wundef",
        "-Wvla",
        "-Wcast-align",
        "-Wcast-qual",
        "-Wstrict-prototypes",
    )
    for name in SOURCES:
        arguments = [*toolchain.FLAGS, *more, "-c", emitted.folder / name, "-o", tmp_path / "one.o"]
        toolchain.zig().run(arguments)
    assert set(SOURCES) <= names_of(list(emitted.folder.iterdir()))


def test_the_code_has_the_weights_of_its_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def require_config(config: PlanConfig, robot: fk.Robot | None) -> None:
        assert f"#define FK_CONFIG_DEPTH {config.depth}U\n" in text
        assert f"#define FK_CONFIG_COST {config.cost}U " in text
        assert f"#define FK_CONFIG_DISTANCE_WEIGHT_PER_M {config.distance_weight_per_m:.1f}f\n" in text
        assert robot is None or robot.sha256.hex() in text

    file = tmp_path / "my robot.toml"
    file.write_text('base = "frog2022"\nid = "mine"\n[planner]\ndistance_weight_per_m = 640.0\ndepth = 2\n')
    mine = fk.load_robot(file)
    table = fk.fit_table(fk.build_library(mine, states=2, workers=1), kind="nearest")
    table.save(tmp_path / "t.fkt")
    own = config_of(mine.planner)
    for given, robot, config in (
        (table, None, own),
        (tmp_path / "t.fkt", file, own),
        (tmp_path / "t.fkt", None, PlanConfig()),
    ):
        fk.emit_c(given, tmp_path / "c", robot=robot)
        text = (tmp_path / "c" / "fk_config.h").read_text()
        require_config(config, None if config is not own else mine)
        said = capsys.readouterr().err
        assert ("the weights of the paper and depth 1, not its robot's" in said) == (config is not own)
    with pytest.raises(fk.InputError, match="is for robot 'mine', this robot is 'frog2022'"):
        fk.emit_c(tmp_path / "t.fkt", tmp_path / "c", robot="frog2022")
