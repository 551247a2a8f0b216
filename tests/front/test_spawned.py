"""README's Python block where worker processes are spawned."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.conftest import REPOSITORY, from_ci
from tests.front.readme import fewer, readme_lines


@from_ci
def test_readme_needs_no_guard_where_processes_are_spawned(tmp_path: Path) -> None:
    """As on macOS and Windows: no worker runs the script, which has no ``if __name__ == "__main__"``."""
    script = (
        "import logging, multiprocessing\n"
        "print('begun', flush=True)\n"
        "multiprocessing.set_start_method('spawn')\n"
        "multiprocessing.log_to_stderr(logging.INFO)\n"
        "from frogkick.identification import choice, outcome\n"
        "from frogkick.identification.terms import catalogue\n"
        "from tests.identification.made import robot as made_robot\n"
        "some = [term for term in catalogue(made_robot()) if 'limb_wear rear' in term.title]\n"
        "outcome.catalogue, choice.calibrated_starts = lambda *_: some, lambda _robot: {}\n"
    )
    # A piece of work is as many states as the simulation has lanes: these are two pieces.
    lines = readme_lines(*fewer(70), ("states=70", "states=70, workers=2"))
    (tmp_path / "script.py").write_text(script + lines)
    said = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert said.returncode == 0 and "Traceback" not in said.stderr, said.stderr
    assert said.stdout.startswith("begun\n") and said.stdout.count("begun") == 1
    assert "SpawnProcess-2] child process calling self.run()" in said.stderr
    assert (tmp_path / "worn.toml").is_file() and (tmp_path / "emitted" / "fk_planner.h").is_file()
