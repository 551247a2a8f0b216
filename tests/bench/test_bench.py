"""The benchmark runs and says what it should; its figures are not looked at."""

from __future__ import annotations

import importlib.util

import pytest
from tests.bench import elastica_rod, rods, startup


def test_the_benchmark_tells_every_cost(capsys: pytest.CaptureFixture[str]) -> None:
    rods.main(["--quick"])
    said = capsys.readouterr().out
    for title in ("lanes:", "actions:", "nodes:", "library:", "a plain rod"):
        assert f"\n{title}" in said
    assert "nan" not in said


def test_what_a_command_costs_before_its_first_word(capsys: pytest.CaptureFixture[str]) -> None:
    ratios = startup.main(1)
    assert ratios.keys() == startup.COMMANDS.keys() and min(ratios.values()) > 0.0
    assert "times that" in capsys.readouterr().out


@pytest.mark.skipif(importlib.util.find_spec("elastica") is None, reason="pyelastica is not installed")
def test_both_codes_find_the_same_deflection() -> None:
    _, ours = elastica_rod.frogkick_rod(1, 1)
    _, theirs = elastica_rod.elastica_rod(1)
    assert ours == pytest.approx(theirs, rel=1e-3)
