"""Laws in a report: in words, as a formula, as a figure, and what runs must contain to show them."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.errors import InputError
from frogkick.effects import Law
from frogkick.effects.law import CHANNELS
from frogkick.identification.outcome import Outcome
from frogkick.report.identify_residuals import Residuals, all_residuals
from frogkick.report.law_figures import DEPENDS, depends_on, law_figure
from frogkick.report.page import Section

ACTS = 0.1
"""A law counts as acting in a period if it is more than this share of its largest value."""

_PLACE = "({at_x:.2f}, {at_y:.2f}) m"
_EVERY = "every {cycle:.2f} s, for {share:.0%} of that time"
SENTENCES: Mapping[str, str] = {
    "spring": f"A spring or cable pulls the robot to the point {_PLACE}, with {{stiffness:.3g}} N for each "
    "metre beyond {slack:.2f} m from it.",
    "attraction": f"The point {_PLACE} attracts the robot, more strongly the nearer it is, down to a "
    "distance of about {near:.2f} m.",
    "push beyond a line": "Beyond a line across the pool a force pushes the robot back, with "
    "{stiffness:.3g} N for each metre beyond it.",
    "push": "A steady force of {to_x:.3g} N along x and {to_y:.3g} N along y pushes the robot.",
    "patch": f"Around the point {_PLACE} the water resists more, by {{drag:.3g}} N s/m, up to a distance of "
    "about {size:.2f} m.",
    "patch with an end": f"Around the point {_PLACE} the water resists more, by {{drag:.3g}} N s/m in its "
    "middle, and less and less up to a distance of {size:.2f} m.",
    "drag beyond a line": "Beyond a line across the pool the water resists more, by {drag:.3g} N s/m.",
    "drag power": "The water resists with the power {power:.2g} of the speed: {forward_drag:.3g} N forward "
    "and {left_drag:.3g} N sideways at {speed:.2f} m/s.",
    "compass": "A torque turns the robot towards one heading, as a magnet does.",
    "gusts": "A force on the robot oscillates with a period of {cycle:.2f} s.",
    "push from a moment on": "From {at:.1f} s on a force of {to_x:.3g} N along x and {to_y:.3g} N along y "
    "pushes the robot.",
    "push by time": "A force that grows with time pushes the robot: each second adds {to_x:.3g} N along x "
    "and {to_y:.3g} N along y.",
    "drag from a moment on": "From {at:.1f} s on the water resists more, by {drag:.3g} N s/m.",
    "torque by speed": "A torque turns the robot in proportion to its speed.",
    "push at intervals": f"A force of {{to_x:.3g}} N along x and {{to_y:.3g}} N along y acts {_EVERY}.",
    "sloshing": "The water moves to and fro with a period of {cycle:.2f} s.",
    "flow that dies down": "The water flows at first and comes to rest: about a third of the flow is left "
    "after {fade:.1f} s.",
    "flow by time": "The water flows faster and faster: each second adds {to_x:.3g} m/s along x and "
    "{to_y:.3g} m/s along y.",
    "flow in a band": "The water flows in a band across the pool, with {to_x:.3g} m/s along x and "
    "{to_y:.3g} m/s along y in its middle.",
    "flow near a place": f"The water flows around the point {_PLACE}, with {{to_x:.3g}} m/s along x and "
    "{to_y:.3g} m/s along y there, up to a distance of about {size:.2f} m.",
    "flow from a moment on": "From {at:.1f} s on the water flows.",
    "flow at intervals": f"The water flows {_EVERY}.",
    "fixes off from a moment on": "From {at:.1f} s on the fixes have an offset.",
    "fixes off at intervals": f"The fixes have an offset {_EVERY}.",
    "fixes late from a moment on": "From {at:.1f} s on the fixes are {late:.3f} s older than stated.",
    "fixes late at intervals": f"The fixes are {{late:.3f}} s older than stated, {_EVERY}.",
    "misfire": "LIMB does nothing in {failing:.0%} of its strokes, at random.",
    "stroke from a moment on": "From {at:.1f} s on the strokes of LIMB are weaker by {loss:.0%}.",
    "stroke in rhythm": "The strokes of LIMB get weaker and stronger with a period of {cycle:.2f} s.",
    "stroke by time": "The strokes of LIMB get weaker with time, by {rate:.2%} a second.",
    "stroke by heading": "The strokes of LIMB depend on the robot's heading.",
    "stroke by place": "The strokes of LIMB depend on the robot's position in the pool.",
    "stroke by speed": "The strokes of LIMB depend on the robot's speed.",
    "stroke after a rest": "The strokes of LIMB are weaker by up to {loss:.0%} soon after the one before, "
    "and recover within about {fade:.1f} s.",
    "stroke tires": "The strokes of LIMB get weaker by up to {loss:.0%}, most of it within {fade:.0f} "
    "strokes.",
}  # fmt: skip
"""Title of a law -> its sentence; LIMB is the limb. Laws with other titles are described by what they act
on."""

WHAT: Mapping[str, str] = {
    "wrench": "A force on the body",
    "flow": "A flow of the water",
    "stroke": "A change of the strokes of LIMB",
    "fix": "An error of the fixes",
}
NEEDS: Mapping[str, str] = {
    "place": "runs that cross the place from several sides and also keep away from it; a spring needs ten "
    "periods with the cable taut",
    "time in cycles": "three to five of its cycles, and strokes that are not synchronous with them",
    "time": "five to ten periods on each side of the moment, or a long run if the change is slow",
    "heading": "headings all around, with the same actions at different headings",
    "speed": "slow and fast periods: starts from rest, turns, and straight stretches",
    "chance": "at least twenty strokes of the limb, or a hundred fixes",
    "rest": "strokes of the limb soon after each other, and others after long rests",
    "limbs": "periods in which the limbs fire together and periods in which each fires without the other. No "
    "action of the paper's robot fires a rear limb without a front one",
}
"""What a law depends on -> what runs must contain to show it."""


def sentence_of(law: Law) -> str:
    """Return a law in words, with its numbers."""
    limb = "all limbs" if law.limb == "all" else law.limb
    values = {p.name: law.value(p.name) for p in law.parameters}
    try:
        sentence = SENTENCES[law.title].format(**values)
    except KeyError:  # a user's law, under any title
        since = sorted(name for name in law.names if name.startswith("since_") and name != "since_s")
        others = [name.removeprefix("since_").removesuffix("_s") for name in since]
        on = {words for name, (_, words) in DEPENDS.items() if name in law.names}
        if others:
            on.add(f"how long ago {' and '.join(others)} fired")
        sentence = f"{WHAT[law.on]}" + (f" that depends on {' and '.join(sorted(on))}." if on else ".")
    return sentence.replace("LIMB", limb)


def formula_of(law: Law) -> list[str]:
    """Return each formula of a law with its numbers in it: ``x_n (N) = ...``."""
    numbers = {p.name: f"{law.value(p.name):.4g}" for p in law.parameters}
    values = {name: f"({text})" if text[0] == "-" else text for name, text in numbers.items()}
    lines = []
    for key, text in law.formulas.items():
        filled = re.sub(r"\b[A-Za-z_]\w*\b", lambda found: values.get(found[0], found[0]), text)
        lines.append(f"{key} ({CHANNELS[law.on][key]}) = {filled}")
    return lines


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
        raise InputError(f"law is {law}, but {len(laws)} were found, counted from 0: give a smaller number")
    return law_figure(outcome, laws[law][1], all_residuals(outcome))


def law_section(outcome: Outcome) -> Section:
    """Return the section; there must be a law."""
    periods = all_residuals(outcome)
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
        images.append((law_figure(outcome, law, periods), caption))
    if outcome.law_test is not None:
        text.append(
            f"An experiment to confirm or refute a law: {outcome.law_test.text}. If the model predicts the "
            "new run as well as the noise of its fixes allows, the law is confirmed. If the model without "
            "the law predicts it better, the law is refuted."
        )
    return Section("Laws: effects that are formulas", text, images=images)


def _contained(law: Law, periods: Residuals) -> str:
    """Return how much these runs contain of what shows a law, if that can be counted."""
    x, y, heading = periods.middle.T
    forward, left, turn = periods.velocity.T
    own = {p.name for p in law.parameters}
    if "cycle" in own:
        return f" The longest of these runs contains {periods.at_s.max() / law.value('cycle'):.1f} cycles."
    if "at" in own:
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
