"""The section of a report on laws: each in words, as a formula and as a picture, and how to test it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.errors import InputError
from frogkick.effects import Law
from frogkick.identification.outcome import Outcome
from frogkick.report.law_figures import Periods, law_figure, periods_of
from frogkick.report.law_words import NEEDS, depends_on, formula_of, sentence_of
from frogkick.report.page import Section
from frogkick.report.style import figure_uri

ACTS = 0.1
"""A law acts in a period if it is more than this share of its largest value."""


def laws_of(outcome: Outcome) -> list[tuple[str, Law]]:
    """Return the laws among the effects found, with their titles."""
    effects = [(term.title, term.effect()) for term in outcome.terms]
    return [(title, effect) for title, effect in effects if isinstance(effect, Law)]


def figure_of_law(outcome: Outcome, law: int) -> Figure:
    """Return the picture of one of the laws found.

    Raises:
        InputError: there is no law of that number.
    """
    laws = laws_of(outcome)
    if not 0 <= law < len(laws):
        raise InputError(f"law {law}: {len(laws)} were found, counted from 0")
    return law_figure(outcome, laws[law][1], periods_of(outcome))


def law_section(outcome: Outcome) -> Section:
    """Return the section; there must be a law."""
    periods = periods_of(outcome)
    text, images = [], []
    for title, law in laws_of(outcome):
        formulas = "; ".join(formula_of(law))
        text.append(f"{title}: {sentence_of(law)} As a formula: {formulas}.")
        text.append(
            f"To show a law like this, runs must contain {NEEDS[depends_on(law)]}.{_contained(law, periods)}"
        )
        caption = (
            f"{title}. Left: the law. Right: the residual of each period of all runs, by the nominal model "
            "one period ahead, and the part of it that the identified effects explain."
        )
        images.append((figure_uri(law_figure(outcome, law, periods)), caption))
    if outcome.law_test is not None:
        text.append(
            f"An experiment to confirm or refute a law: {outcome.law_test.text}. If the model predicts the "
            "new run as well as the noise of its fixes allows, the law is confirmed. If the model without "
            "the law predicts it better, the law is refuted."
        )
    return Section("Laws: effects that are formulas", text, images=images)


def _contained(law: Law, periods: Periods) -> str:
    """Return how much these runs contain of what shows a law, if that can be counted."""
    x, y, heading = periods.pose.T
    forward, left, turn = periods.velocity.T
    if "cycle" in {p.name for p in law.parameters}:
        return f" The longest of these runs contains {periods.at_s.max() / law.value('cycle'):.1f} cycles."
    if "at" in {p.name for p in law.parameters}:
        later = int((periods.at_s > law.value("at")).sum())
        earlier = len(periods.at_s) - later
        return f" These runs contain {earlier} periods before that moment and {later} after it."
    if law.on == "stroke" or law.by_chance:
        return ""
    given = law.over(
        {
            "time_s": periods.at_s, "x_m": x, "y_m": y, "heading_rad": heading, "forward_mps": forward,
            "left_mps": left, "turn_radps": turn,
        }
    )  # fmt: skip
    size = np.sqrt(sum(np.broadcast_to(values, x.shape) ** 2 for values in given.values()))
    acting = int((size > ACTS * size.max()).sum())
    return (
        f" In {acting} of the {len(x)} periods of these runs, the law is more than a tenth of its largest "
        "value in them."
    )
