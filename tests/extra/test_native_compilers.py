"""The planner as the compilers of this machine build it: no warning, and the twin's bits."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.conftest import count
from tests.extra.tools import compiler
from tests.planner import synthetic

from frogkick.planner.plan import PlanConfig
from frogkick.tables.image import open_image
from frogkick_codegen.native import NativeLibrary, planner_files
from frogkick_codegen.parity import compare, make_cases, native_place, python_place
from frogkick_codegen.toolchain import FLAGS

pytestmark = pytest.mark.extra

COMPILERS = ("gcc", "clang")


@pytest.mark.parametrize("name", COMPILERS)
@pytest.mark.parametrize("level", ["-O0", "-O2", "-O3"])
def test_this_machine_s_compilers_give_the_twin_s_bits(name: str, level: str) -> None:
    library = NativeLibrary(compiler=compiler(name, name), flags=(*FLAGS, level))
    tables, path, config = open_image(synthetic.image()), synthetic.wave_path(), PlanConfig()
    cases = make_cases(tables, path, count(5000, 50_000), 7)
    (pair,) = compare(
        cases,
        {
            "python": python_place(tables, path, config),
            f"{name} {level}": native_place(library, tables, path, config),
        },
    )
    assert pair.mismatches == 0, pair.first_failure


@pytest.mark.parametrize("name", COMPILERS)
def test_the_planner_is_plain_c99(name: str, tmp_path: Path) -> None:
    """Pedantic, and linked without a C library: it builds in any C project."""
    driver = compiler(name, name)
    for file, content in planner_files().items():
        (tmp_path / file).write_bytes(content)
    sources = sorted(path.name for path in tmp_path.glob("*.c"))
    warnings = ("-Wpedantic", "-Wshadow", "-Wundef", "-Wvla")
    bare = ("-ffreestanding", "-fno-builtin", "-fno-stack-protector", "-nostdlib", "-Wl,-z,defs")
    driver.run([*FLAGS, *warnings, *bare, "-fPIC", "-shared", "-o", "planner.so", *sources], folder=tmp_path)
