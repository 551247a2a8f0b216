"""Runs commands in this process and looks at everything that they leave behind."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from frogkick.cli.main import run_command


@dataclass(frozen=True)
class Outcome:
    """What one command gave."""

    code: int
    stdout: str
    stderr: str

    @property
    def json(self) -> dict[str, Any]:
        """Stdout as the one JSON object that it must be, without NaN and infinity."""

        def refuse(name: str) -> None:
            raise AssertionError(f"{name} is no JSON")

        value = json.loads(self.stdout, parse_constant=refuse)
        assert isinstance(value, dict)
        return value


def frogkick(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> Outcome:
    """Run one command."""
    capsys.readouterr()
    code = run_command([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return Outcome(code, captured.out, captured.err)


def listing(folder: Path) -> dict[str, bytes | None]:
    """Everything in a folder: name -> content, None for folders."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }
