"""The examples run: as they stand with test-full, else with fewer states and few candidates."""

from __future__ import annotations

import ast
import json
import runpy
from pathlib import Path
from typing import Any

import pytest
from tests.conftest import REPOSITORY, count, from_ci
from tests.identification.made import robot as made_robot

import frogkick as fk
from frogkick.identification import choice as choice_module
from frogkick.identification import outcome as outcome_module
from frogkick.identification.terms import catalogue

EXAMPLES = REPOSITORY / "host" / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
LEFT = {
    "swim": set(),
    "table": {"tables.fkt"},
    "run": {"run.h5", "run.png"},
    "worn_limb": {"worn.toml", "worn.html"},
    "another_robot": {"mine.toml"},
}
DEAR = ("another_robot", "worn_limb")
"""The notebook identifies a worn limb as well, and the tutorial's robot is made by ``make docs-check``."""


built: dict[tuple[Any, ...], fk.Library] = {}
"""Libraries that one of the scripts has built, for the others."""


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder to run in; but with test-full the same calls are made cheaper."""
    monkeypatch.chdir(tmp_path)
    if few := count(60, 0, 46):
        load, build = fk.load_robot, fk.build_library
        some = [term for term in catalogue(made_robot()) if "limb_wear rear" in term.title]

        def fewer(robot: fk.Robot, states: int = 300, **options: Any) -> fk.Library:
            key = (robot, states, *options.items())
            if key not in built:
                built[key] = build(robot, min(states, few), **options)
            return built[key]

        monkeypatch.setattr(fk, "load_robot", lambda name: made_robot() if name == "frog2022" else load(name))
        monkeypatch.setattr(fk, "build_library", fewer)
        monkeypatch.setattr(outcome_module, "catalogue", lambda *_: some)
        monkeypatch.setattr(choice_module, "calibrated_starts", lambda _robot: {})
    return tmp_path


def test_there_are_five_and_a_notebook() -> None:
    assert {path.stem for path in SCRIPTS} == set(LEFT)
    assert [path.name for path in EXAMPLES.glob("*.ipynb")] == ["tour.ipynb"]


@pytest.mark.parametrize(
    "script",
    [pytest.param(path, id=path.stem, marks=from_ci if path.stem in DEAR else ()) for path in SCRIPTS],
)
def test_a_script_runs(script: Path, quick: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = runpy.run_path(str(script))
    said = capsys.readouterr().out
    assert len(said.splitlines()) >= 2, said
    assert {path.name for path in quick.iterdir()} == LEFT[script.stem]
    if script.stem == "worn_limb":
        assert names["found"].verdict == "found"
        assert "gain 0.7" in said or "gain 0.6" in said, said


@from_ci
def test_the_notebook_runs_and_draws(quick: Path) -> None:
    """Its cells, one after another; the value of each cell's last line is what it shows."""
    cells = json.loads((EXAMPLES / "tour.ipynb").read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    shown: list[Any] = []
    for cell in cells:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == [] and cell["execution_count"] is None, (
            "outputs are made by whoever runs it"
        )
        tree = ast.parse("".join(cell["source"]))
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, "tour.ipynb", "exec"), names)
        if isinstance(last, ast.Expr):
            shown.append(eval(compile(ast.Expression(last.value), "tour.ipynb", "eval"), names))
    drawn = [value._repr_html_() for value in shown if hasattr(value, "_repr_html_")]
    assert len(shown) == 7 and len(drawn) == 5
    assert names["found"].verdict == "found"
