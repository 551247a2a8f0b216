"""cppcheck finds no error, warning, performance or portability fault in the C that ships."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from tests.conftest import REPOSITORY
from tests.extra.tools import emitted_firmware, program, run
from tests.planner import synthetic

pytestmark = pytest.mark.extra

SUPPRESSIONS = Path(__file__).with_name("cppcheck-suppressions.xml")
SOURCES = (
    REPOSITORY / "codegen" / "frogkick_codegen" / "planner",
    REPOSITORY / "firmware" / "core",
    REPOSITORY / "firmware" / "bench",
)


def check(folder: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run cppcheck for a 32-bit target; its exit code is 1 where it finds anything."""
    cppcheck = program("cppcheck", "cppcheck")
    return run(
        [
            cppcheck, "--quiet", "--std=c99", "--language=c", "--platform=unix32", "--error-exitcode=1",
            "--enable=warning,performance,portability", "--template={file}:{line}: {id}: {message}",
            "--template-location=", *arguments,
        ],
        folder,
    )  # fmt: skip


def test_cppcheck_finds_nothing(tmp_path: Path) -> None:
    emitted, config = emitted_firmware(synthetic.image(), tmp_path)
    found = check(
        tmp_path,
        "--enable=information",  # reports suppressions that match nothing, and own headers that are not found
        "--suppress=missingIncludeSystem",
        f"--suppress-xml={SUPPRESSIONS}",
        f"-I{emitted}",
        f"-I{config}",
        f"-I{SOURCES[1]}",
        *SOURCES,
    )
    assert found.returncode == 0, found.stderr
    assert found.stderr == ""


def test_nothing_is_suppressed_in_the_sources() -> None:
    files = [file for folder in SOURCES for file in folder.glob("*.[ch]")]
    assert len(files) > 20
    assert [file.name for file in files if "cppcheck-suppress" in file.read_text()] == []


def test_cppcheck_finds_what_is_wrong(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.c"
    wrong.write_text("int last(void);\nint last(void)\n{\n    int a[4] = {0};\n    return a[4];\n}\n")
    found = check(tmp_path, wrong)
    assert found.returncode == 1
    assert "arrayIndexOutOfBounds" in found.stderr
