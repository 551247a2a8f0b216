"""Every line of the core runs in this folder's tests; branches that none can take are named here."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.conftest import LEVEL, REPOSITORY
from tests.core.core import CORE, COVERAGE_DIR

SOURCES = sorted(path.name for path in CORE.glob("*.c"))
UNTAKEN = {
    # COBS as it is defined, but a block of 254 bytes never fits a frame of this link.
    "if (code < 255u && from < length) {",
    # Heat from before a reset fills the history of a limb only in firmware flashed for shorter pulses, which
    # test_core_guard_history builds, and in which nothing is counted.
    "if (is_full(limb, end_us) || on_time_us(limb, end_us) + pulse_us > FK_DUTY_ON_MAX_US) {",
    # Every return is checked, and an index below the table's count has no error.
    "if (fk_tables_action(&robot->tables, (uint8_t)(action - 1u), &masks) == FK_OK && "
    "masks.first_mask == 0u &&",
    "if (fk_tables_action(tables, (uint8_t)(action - 1u), &masks) == FK_OK && masks.first_mask == 0u &&",
}
"""Source lines with a branch that nothing can take."""


ELSEWHERE = "not changed and not monitor and not guided and not one_microsecond and not compiler_refuses"
"""These build libraries of their own, in which nothing is counted; so does what is marked as extra."""


@pytest.mark.extra
@pytest.mark.skipif(bool(COVERAGE_DIR), reason="this is the run that is counted")
@pytest.mark.skipif(
    sys.platform == "win32" or not (shutil.which("gcc") and shutil.which("gcov")),
    reason="no gcc with gcov on this machine: lines of the core are not counted",
)
def test_every_line_of_the_core_runs(tmp_path: Path) -> None:
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", ELSEWHERE]
    tests += ["-m", "not extra", "tests/core", "--deselect", "tests/core/test_core_coverage.py"]
    environment = os.environ | {"FK_CORE_COVERAGE_DIR": str(tmp_path)}
    if LEVEL == "quick":
        environment["FK_LEVEL"] = "ci"  # the counts of a newcomer do not come by every line
    run = subprocess.run(tests, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-3000:]
    notes = [f"core.so-{Path(name).stem}.gcno" for name in SOURCES]
    output = subprocess.run(
        ["gcov", "-b", *notes], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    untaken: set[str] = set()
    for name in SOURCES:
        part = output.split(f"File '{name}'\n", 1)[1].split("\n\n", 1)[0]
        lines = re.search(r"Lines executed:([\d.]+)% of (\d+)", part)
        branches = re.search(r"Taken at least once:([\d.]+)% of (\d+)", part)
        assert lines is not None and (branches is not None or "No branches" in part), part
        of_branches = f"branches {branches[1]} % of {branches[2]}" if branches else "no branches"
        print(f"{name}: lines {lines[1]} % of {lines[2]}, {of_branches}")
        listing = (tmp_path / f"{name}.gcov").read_text(encoding="utf-8")
        missed = re.findall(r"^ +#####: +(\d+):(.*)$", listing, re.MULTILINE)
        assert not missed, f"{name}: lines that no test runs: {missed}"
        text = ""
        for line in listing.splitlines():
            if re.match(r"branch +\d+ (taken 0%|never executed)", line):
                untaken.add(text)
            elif found := re.match(r" *[^:]+: *\d+:(.*)", line):
                text = found[1].strip()
    assert untaken <= UNTAKEN
