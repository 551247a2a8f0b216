"""Laws in a retune: what no table can hold is left out of libraries, and named with what it costs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from made import known_outcome, make_swim, robot
from test_retune import WEAR, WORN, silent, tools_of
from tests.conftest import from_ci

from frogkick.cli.identify import printed
from frogkick.effects import Law, body_effects
from frogkick.front import retuning as module
from frogkick.front.retune_tables import Tracked
from frogkick.front.retuning import ROBOT, retuned
from frogkick.identification.outcome import Outcome
from frogkick.identification.terms import Term
from frogkick.robot import Robot, load_robot


def law_term(**table: Any) -> Term:
    """A law as identification finds one."""
    given = Law(**table)
    kept = {key: value for key, value in given.table.items() if key != "name"}
    return Term(
        (("name", "law"), *kept.items()),
        Path(),
        given.parameters,
        tuple(map(given.value, table["parameters"])),
    )


PULLED = law_term(
    title="spring", on="wrench", x_n="-k * (x_m - at)",
    parameters={"k": {"value": 0.02, "unit": "N/m", "high": 1.0}, "at": {"value": 0.2, "unit": "m"}},
)  # fmt: skip
THIRSTY = law_term(
    title="stroke by speed", on="stroke", limb="rear_left", gain="1 - k * forward_mps",
    parameters={"k": {"value": 1.0, "unit": "s/m"}},
)  # fmt: skip


def with_terms(outcome: Outcome, *terms: Term) -> Outcome:
    """The same outcome with other effects."""
    assert outcome.found is not None
    fitted = replace(outcome.found.fitted, model=replace(outcome.found.fitted.model, terms=terms))
    beside = [[] for _ in terms]
    return replace(
        outcome,
        found=replace(outcome.found, fitted=fitted, confounded_with=beside, stability=[1.0] * len(terms)),
        parameters=beside,
    )


@from_ci
def test_what_no_table_holds_is_named_with_what_it_costs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swims = [make_swim([WORN], seed, 10) for seed in (1, 2, 3)]
    known = known_outcome(swims[:2], swims[2:], *WEAR)
    (worn,) = known.terms
    found = with_terms(known, worn, PULLED, THIRSTY)
    monkeypatch.setattr(module, "identify", lambda *_args, **_more: found)
    tools = tools_of(known, 0.5e-3, 2e-3)
    pools: list[list[str]] = []

    def tracked(tables: Path, swimmer: Robot, progress: Any) -> Tracked:
        pools.append([table.get("title", table["name"]) for table in swimmer.effects])
        return Tracked(0.01 * len(pools), 0.02, 1, 2)

    monkeypatch.setattr(tools, "tracked", tracked)
    result = retuned(swims, robot(), tmp_path / "new", tools, silent, laws=True)
    every = ["limb_wear", "spring", "stroke by speed"]
    assert result.better and pools == [every, every, ["limb_wear", "stroke by speed"]]
    assert result.as_json()["lost"] == {
        "effects": ["spring"],
        "with": {"mean_distance_m": 0.02, "progress_mps": 0.02, "completed": 1, "runs": 2},
        "without": {"mean_distance_m": 0.03, "progress_mps": 0.02, "completed": 1, "runs": 2},
    }
    said = printed(result)
    assert "no table can contain: spring" in said and "20.0 mm from the path with these in the pool" in said
    held = body_effects(load_robot(tmp_path / "new" / ROBOT))
    assert [effect.title for effect in held] == ["limb_wear", "stroke by speed"], (
        "the library has what it can"
    )

    pools.clear()
    monkeypatch.setattr(module, "identify", lambda *_args, **_more: with_terms(known, PULLED))
    alone = retuned(swims, robot(), tmp_path / "none", tools, silent, b"old", laws=True)
    assert "depends on position, heading or time" in alone.reason and not (tmp_path / "none").exists()
    assert pools == [["spring"], []] and alone.lost is not None
    made = retuned(swims, robot(), tmp_path / "none", tools, silent, laws=True)
    assert made.lost is not None and len(pools) == 4, "with an old table of its own"
