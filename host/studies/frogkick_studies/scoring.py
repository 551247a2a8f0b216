"""Scores a verdict of identification against the synthetic effects of the world."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from frogkick.effects import Parameter
from frogkick.identification.outcome import Outcome
from frogkick.identification.terms import Interval
from frogkick.identification.verdict import FAR, FOUND, FOUND_LAW, NOTHING, PARTLY, UNEXPLAINED
from frogkick_studies.synthetic_effects import LAWS, NULL, OUTSIDE, Kind
from frogkick_studies.synthetic_laws import Table, rights


@dataclass(frozen=True)
class Result:
    """The score of a case.

    Attributes:
        verdict: that of the identification.
        right: the verdict meets the requirement of its group.
        wrong: the verdict is "found", but the named effects are not the true ones; without a true effect,
            "partly explained" counts as wrong as well.
        planted, found: true and identified effects, in words.
        before, after, floor: position (m) and heading (rad) on the test run.
        cpu_s: processor time of the identification.
        inside, parameters: number of true parameters of named effects inside their intervals, and of all.
        gone: share of the position error above the noise floor that is removed on the test run; None if the
            error before is not above the floor.
        draws: how often parameters were drawn until the error before was in the required range.
    """

    verdict: str
    right: bool
    wrong: bool
    planted: list[str]
    found: list[str]
    before: list[float]
    after: list[float]
    floor: list[float]
    periods: int
    cpu_s: float
    inside: int = 0
    parameters: int = 0
    gone: float | None = None
    draws: int = 1

    def as_json(self) -> dict[str, Any]:
        """The keys of a case in the command ``study verdicts``."""
        values = dataclasses.asdict(self)
        return {"noise_floor": values.pop("floor"), **values, "cpu_s": round(self.cpu_s, 1)}


def score_case(kind: Kind, planted: Sequence[Table], outcome: Outcome, cpu_s: float) -> Result:
    """Compare an outcome with the true effects."""
    named = [is_identified(table, outcome) for table in planted]
    held = [
        p.contains(float(table[p.name]))
        for table in planted
        for _, p in _named(table, outcome)
        if p.name in table and outcome.verdict == FOUND
    ]
    titles = {term.name for term in outcome.terms}
    found = outcome.verdict in (FOUND, FOUND_LAW)
    lawful = _lawful(planted, outcome)
    equivalent = outcome.verdict == FOUND and bool(kind.alike) and titles <= set(kind.alike)
    if kind.group == NULL:
        right = outcome.verdict == NOTHING
        wrong = found or outcome.verdict == PARTLY
    elif kind.group == OUTSIDE:
        # For an effect outside the catalogue, "partly explained" is right.
        wrong = found and not (equivalent or lawful)
        right = not wrong and (found or outcome.verdict in (UNEXPLAINED, PARTLY))
    elif kind.group == LAWS:
        tested = outcome.tested
        lower = tested.after.position_rmse_m < tested.before.position_rmse_m
        if any(each.chance for each in rights(planted)):
            # Random failures cannot be predicted; only their density can.
            lower |= tested.gain is not None and tested.gain.low > 0.0
        wrong = found and not (lawful and lower)
        right = not wrong and lawful
    else:
        right = found and (all(named) or equivalent)
        wrong = found and not (all(named) or equivalent)
    before, after, floor = (
        list(error.pair)
        for error in (outcome.tested.before, outcome.tested.after, outcome.tested.noise_floor)
    )
    return Result(
        outcome.verdict,
        right,
        wrong,
        [_words(table) for table in planted],
        [
            f"{term.title}: "
            + ", ".join(f"{p.name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}]" for p in row)
            + (f" (or {', '.join(others)})" if others else "")
            for term, row, others in zip(
                outcome.terms,
                outcome.parameters,
                outcome.found.confounded_with if outcome.found else [],
                strict=True,
            )
        ],
        before,
        after,
        floor,
        sum(len(swim.start_s) for swim in outcome.train),
        cpu_s,
        sum(held),
        len(held),
        None if before[0] <= floor[0] else min(1.0, (before[0] - after[0]) / (before[0] - floor[0])),
    )


def _lawful(planted: Sequence[Table], outcome: Outcome) -> bool:
    """Whether the identified laws are exactly those that are right for the true effects."""
    right = rights(planted)
    return (
        bool(right)
        and all(any(each.holds(term) for term in outcome.terms) for each in right)
        and all(any(each.holds(term) for each in right) for term in outcome.terms)
    )


def _words(table: Table) -> str:
    values = ", ".join(
        f"{key} {value}" for key, value in table.items() if key not in ("name", "file", "class")
    )
    return f"{table.get('name') or table.get('class')}: {values}"


def is_identified(table: Table, outcome: Outcome) -> bool:
    """Whether a true effect is among the identified ones, with no parameter FAR from its true value.

    The number of parameters inside their intervals is counted separately: a 95 % interval misses one value in
    twenty.
    """
    row = _named(table, outcome)
    return bool(row) and all(
        p.contains(float(table.get(p.name, parameter.nominal)), FAR) for parameter, p in row
    )


def _named(table: Table, outcome: Outcome) -> list[tuple[Parameter, Interval]]:
    """The parameters identified for a true effect, and their values; none if it was not identified."""
    for term, row in zip(outcome.terms, outcome.parameters, strict=True):
        options = dict(term.table)
        same = all(options[key] == table[key] for key in options if key in table)
        if term.name == table.get("name") and same:
            return list(zip(term.parameters, row, strict=True))
    return []
