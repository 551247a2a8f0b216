"""Laws in the report: a sentence, a formula, a picture with the raw residuals, and how to test them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from tests.conftest import from_ci, some
from tests.identification.made import known_outcome, make_swim, robot
from tests.report.test_report import self_contained

from frogkick.core.errors import InputError
from frogkick.effects import Law
from frogkick.front.identifying import Identification
from frogkick.identification.fit import derivatives, rollouts_of
from frogkick.identification.law_kinds import kinds_of
from frogkick.identification.outcome import Outcome
from frogkick.identification.terms import Term
from frogkick.identification.verdict import FOUND_LAW, intervals
from frogkick.report.identify_page import write_identify_page
from frogkick.report.identify_residuals import all_residuals
from frogkick.report.laws import NEEDS, depends_on, formula_of, law_figure, sentence_of

LAWS: list[tuple[str, str, dict[str, float], str, str]] = [
    ("spring", "", {"stiffness": 0.05, "at_x": 0.1, "at_y": 0.1, "slack": 0.1}, "place",
     "to the point (0.10, 0.10) m, with 0.05 N for each metre beyond 0.10 m"),
    ("stroke from a moment on", "rear_left", {"loss": 0.7, "at": 6.0}, "time",
     "From 6.0 s on the strokes of rear_left are weaker by 70%"),
    ("stroke after front_right", "rear_left", {"loss": 0.5, "within": 0.5}, "limbs",
     "how long ago front_right fired"),
    ("patch", "", {"drag": 1.0, "at_x": 0.0, "at_y": 0.1, "size": 0.3, "sharp": 2.0}, "place",
     "resists more, by 1 N s/m, up to a distance of about 0.30 m"),
    ("patch with an end", "", {"drag": 1.0, "at_x": 0.0, "at_y": 0.1, "size": 0.3, "sharp": 2.0}, "place",
     "by 1 N s/m in its middle, and less and less up to a distance of 0.30 m"),
    ("sloshing", "", {"x_sine": 0.01, "y_sine": 0.004, "cycle": 6.0}, "time in cycles",
     "with a period of 6.00 s"),
    ("drag from a moment on", "", {"drag": 0.05, "at": 6.0}, "time", "From 6.0 s on the water resists more"),
    ("flow in a band", "", {"to_x": 0.01, "way": 1.5, "offset": 0.1, "width": 0.1}, "place",
     "in a band across the pool, with 0.01 m/s along x"),
    ("stroke after a rest", "rear_left", {"loss": 0.5, "fade": 2.0}, "rest", "recover within about 2.0 s"),
    ("drag power", "", {"forward_drag": 1e-3, "left_drag": 1e-3, "power": 1.0, "speed": 0.03}, "speed",
     "with the power 1 of the speed"),
    ("compass", "", {"east": 1e-4}, "heading", "towards one heading"),
]  # fmt: skip


@cache
def kinds() -> dict[tuple[str, str], Term]:
    found = kinds_of(robot(), [make_swim([], 1, 8)])
    return {(kind.title, kind.table.get("limb", "")): kind.term(kind.grid[0]) for kind in found}


def term_of(title: str, limb: str, values: dict[str, float]) -> Term:
    plain = kinds()[title, limb]
    return plain.at([values.get(p.name, 0.0) for p in plain.parameters])


def law_of(term: Term) -> Law:
    effect = term.effect()
    assert isinstance(effect, Law)
    return effect


def outcome_with(term: Term) -> Outcome:
    """An outcome with runs in which a law holds, at its true values."""
    train, test = ([make_swim([law_of(term).table], seed, 8)] for seed in (41, 42))
    known = known_outcome(train, test, "limb_wear rear_left", (0.9, 0.0, 1.0))
    assert known.found is not None
    model = replace(known.found.fitted.model, terms=(term,), fixed=frozenset())
    (fitted,) = derivatives([model], known.found.data)
    found = replace(known.found, fitted=fitted)
    rows = intervals(fitted, found.data)
    return replace(
        known, verdict=FOUND_LAW, found=found, rollouts=rollouts_of([model], test)[0], parameters=rows
    )


@from_ci
@pytest.mark.parametrize(("title", "limb", "values", "hangs", "said"), some(LAWS, 1))
def test_a_law_is_told_in_words_as_a_formula_and_as_a_picture(
    title: str, limb: str, values: dict[str, float], hangs: str, said: str
) -> None:
    term = term_of(title, limb, values)
    law = law_of(term)
    assert said in sentence_of(law) and depends_on(law) == hangs
    for line in formula_of(law):
        assert not {p.name for p in law.parameters} & set(line.replace("(", " ").split()), line
    outcome = outcome_with(term)
    periods = all_residuals(outcome)
    raw = periods.residual_body("nominal")
    assert len(raw) == 16
    left = raw - periods.explained
    assert (left[:, :2] ** 2).sum() < 0.3 * (raw[:, :2] ** 2).sum(), "the law explains the residuals"
    figure = law_figure(outcome, law, periods)
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()
    for axes in figure.axes:
        for label in (axes.get_xlabel(), axes.get_ylabel()):
            assert label in ("", "limb") or label.endswith(")"), label
        for text in (axes._left_title, axes.xaxis.label, axes.yaxis.label):  # type: ignore[attr-defined]
            box = text.get_window_extent(renderer)
            assert not text.get_text() or (box.x0 >= 0 and box.x1 <= figure.bbox.width), text.get_text()


def test_every_law_of_the_grammar_is_told_in_words() -> None:
    for term in kinds().values():
        law = law_of(term)
        reported = sentence_of(law)
        assert reported.endswith(".") and "{" not in reported and "LIMB" not in reported
        assert depends_on(law) in NEEDS and formula_of(law)
    pull = {"pull": {"value": -1e-3, "unit": "N"}}
    own = Law(on="wrench", title="spring", x_n="-pull * sign(x_m)", parameters=pull)
    assert sentence_of(own) == "A force on the body that depends on place."
    assert formula_of(own) == ["x_n (N) = -(-0.001) * sign(x_m)"]


@from_ci
def test_the_page_says_how_a_law_is_confirmed_or_refuted(tmp_path: Path) -> None:
    title, limb, values, _, said = LAWS[0]
    outcome = outcome_with(term_of(title, limb, values))
    assert outcome.found is not None
    assert outcome.law_test is not None and outcome.law_test.between == ("spring", "no spring")
    assert outcome.law_test.decisive
    sure = [[replace(each, low=each.value, high=each.value) for each in outcome.parameters[0]]]
    planned = replace(outcome, parameters=sure).experiment
    assert planned is not None and planned.between == ("spring", "no spring"), "nothing else is open"
    found = Identification(outcome)
    assert len(found.plot().axes) == 2
    with pytest.raises(InputError, match="law is 1, but 1 were found"):
        found.plot(1)
    write_identify_page(tmp_path / "what.html", outcome)
    text = self_contained((tmp_path / "what.html").read_text(encoding="utf-8")).text
    needed = "ten periods with the cable taut"
    for words in (
        said,
        "hypot(x_m - 0.1",
        "An experiment to confirm or refute a law",
        "record from rest",
        needed,
    ):
        assert words in text, words
