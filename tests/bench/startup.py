"""Processor time until a command says its first word, in units of loading what draws a command line.

    PYTHONPATH=. .venv/bin/python -m tests.bench.startup [RUNS]

The unit is ``import typer, rich.console``, measured in turn with the commands: a ratio holds on any machine.
"""

from __future__ import annotations

import os
import subprocess
import sys

COMMANDS = {
    "--help": ["--help"],
    "a typo": ["simulat"],
    "study --help": ["study", "--help"],
    "run --help": ["run", "--help"],
    "tables info --help": ["tables", "info", "--help"],
    "identify --help": ["identify", "--help"],
}
UNIT = "import typer, rich.console"


def seconds(arguments: list[str]) -> float:
    """User and system time of a new interpreter."""
    before = os.times()
    subprocess.run([sys.executable, *arguments], capture_output=True, check=False)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def main(runs: int = 5) -> dict[str, float]:
    """Print the least of some runs of each command, and return its ratio to the unit."""
    calls = {"unit": ["-c", UNIT]} | {
        name: ["-m", "frogkick.cli.main", *words] for name, words in COMMANDS.items()
    }
    least = {name: min(seconds(call) for _ in range(runs)) for name, call in calls.items()}
    print(f"{UNIT}: {least['unit']:.2f} s of processor time")
    ratios = {name: least[name] / least["unit"] for name in COMMANDS}
    for name, ratio in ratios.items():
        print(f"frogkick {name}: {least[name]:.2f} s, {ratio:.1f} times that")
    return ratios


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
