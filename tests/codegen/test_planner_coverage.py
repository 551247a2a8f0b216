"""Every line and branch of the emitted C runs in tests of this folder; what nothing can take is named."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.codegen.planner_c import COVERAGE_DIR
from tests.conftest import REPOSITORY

from frogkick_codegen.native import PLANNER_SOURCES

TESTS = (
    "test_planner_c.py", "test_planner_beam.py", "test_planner_parts.py", "test_planner_rest.py",
    "test_tables_open.py",
)  # fmt: skip
AT_RANDOM = "not same_images and not any_change and not same_break"
"""Cases made on purpose count; thousands made at random do not."""
HEADERS = ("fk_route.h", "fk_search.h", "fk_trig.h", "fk_internal.h")
"""Their functions are in the object files of the sources that use them."""
UNTAKEN: dict[str, str] = {
    "const uint32_t low = (knot > 0U) ? knot - 1U : 0U;": "in tree.c, which with the route cost expands no "
    "deeper than level 2: from knot 2 on the way back, one knot a level",
    "if (middle < last) {": "in tree.c, likewise: every third of 14 knots leaves one behind it, and "
    "the route ends before none of them",
}
"""Source line -> why a branch of it cannot be taken."""


@pytest.mark.extra
@pytest.mark.skipif(bool(COVERAGE_DIR), reason="this is the run that is counted")
@pytest.mark.skipif(
    sys.platform == "win32" or not (shutil.which("gcc") and shutil.which("gcov")),
    reason="no gcc with gcov on this machine: lines of the planner are not counted",
)
def test_every_line_and_branch_of_the_planner_runs(tmp_path: Path) -> None:
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", AT_RANDOM]
    tests += [f"tests/codegen/{name}" for name in TESTS]
    environment = os.environ | {"FK_PLANNER_COVERAGE_DIR": str(tmp_path), "FK_LEVEL": "ci"}
    run = subprocess.run(tests, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-3000:]
    notes = [f"planner.so-{Path(name).stem}.gcno" for name in PLANNER_SOURCES]
    output = subprocess.run(
        ["gcov", "-b", *notes], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    missed: dict[str, list[str]] = {}
    untaken: dict[str, str] = {}
    for name in (*PLANNER_SOURCES, *HEADERS):
        part = output.split(f"File '{name}'\n", 1)[1].split("\n\n", 1)[0]
        found = re.findall(r"(Lines executed|Taken at least once):([\d.]+)% of (\d+)", part)
        print(name, *(f"{what} {percent} % of {number}" for what, percent, number in found), sep=": ")
        listing = (tmp_path / f"{name}.gcov").read_text(encoding="utf-8")
        lines = re.findall(r"^ +#####: +(\d+:.*)$", listing, re.MULTILINE)
        missed |= {name: lines} if lines else {}
        text = ""
        for line in listing.splitlines():
            if re.match(r"branch +\d+ (taken 0%|never executed)", line):
                untaken[text] = name
            elif at := re.match(r" *[^:]+: *(\d+):(.*)", line):
                text = at[2].strip()
    assert not missed, "lines that no test runs"
    assert set(untaken) == set(UNTAKEN), "branches that no test takes, or reasons that no longer hold"
