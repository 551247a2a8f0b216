"""The report of ``frogkick identify``: what was predicted, what happened, what was tried, taken, and why."""

from __future__ import annotations

import math
from pathlib import Path

from matplotlib.figure import Figure

from frogkick.core.poses import PredictionError
from frogkick.identification.choice import STABLE
from frogkick.identification.outcome import Outcome
from frogkick.identification.penalty import EFFECT_PENALTY, PARAMETER_PENALTY
from frogkick.identification.refine import RELEASE_PENALTY
from frogkick.identification.search import DECISIVE_GAIN, HELD_OUT_GAIN_MIN
from frogkick.identification.segments import Segments
from frogkick.identification.verdict import FOUND, FOUND_LAW, NEAR_FLOOR, NOTHING, PARTLY, UNEXPLAINED, Gain
from frogkick.report.identify_figures import (
    cause_figure,
    error_figure,
    place_figure,
    rest_figure,
    time_figure,
    track_figure,
    tried_figure,
)
from frogkick.report.identify_misses import Misses, mimics, misses_of
from frogkick.report.page import Section, Table, write_page
from frogkick.report.style import figure_uri

TITLE = "What the model lacks"
MIMICS_MOST = 8

MEANS = {
    NOTHING: "the nominal model predicts these runs as well as their fixes allow",
    FOUND_LAW: "with the formula below, predictions are as good as the fixes allow",
    FOUND: "with the effects below, predictions are as good as the fixes allow",
    PARTLY: "the effects below make runs likelier that were kept out, and more than noise is left",
    UNEXPLAINED: "something is missing that the effects tried do not explain",
}


def write_identify_page(target: Path, outcome: Outcome) -> None:
    """Write the report as one HTML file.

    Raises:
        InputError: the file cannot be written.
    """
    if outcome.found is None:
        lead = f"Verdict: {outcome.verdict}. {outcome.reason[:1].upper()}{outcome.reason[1:]}."
        write_page(target, TITLE, lead, [_terms(outcome)])
        return
    tested = outcome.tested
    names = ", ".join(term.title for term in outcome.terms) or "no effect"
    lead = (
        f"Verdict: {outcome.verdict} ({names}): {MEANS[outcome.verdict]}. A period ahead, on runs kept out "
        "of "
        f"learning, the nominal model of {outcome.robot.title} is off by {tested.before} (RMS), with "
        f"what was found by {tested.after}; noise of the fixes alone makes "
        f"{tested.noise_floor}.{_gain_words(tested.gain)}"
    )
    residuals_of = misses_of(outcome)
    sections = [_errors(outcome)]
    if len(residuals_of.run):
        sections += [_tracks(outcome, residuals_of), _residual(outcome, residuals_of)]
    sections += [_effects(outcome), _tried(outcome), _apart(outcome), _rest(outcome), _terms(outcome)]
    write_page(target, TITLE, lead, sections)


def _gain_words(gain: Gain | None) -> str:
    if gain is None:
        return ""
    return (
        f" The log score of a period gains {gain.value:.2f} (95 percent interval {gain.low:.2f} to "
        f"{gain.high:.2f})."
    )


def _picture(figure: Figure, caption: str) -> tuple[str, str]:
    return figure_uri(figure), caption


def _errors(outcome: Outcome) -> Section:
    def row(what: str, error: PredictionError, count: str) -> tuple[str, ...]:
        return (
            what,
            f"{1e3 * error.position_rmse_m:.2f}",
            f"{math.degrees(error.heading_rmse_rad):.2f}",
            count,
        )

    tested = outcome.tested
    rows = [
        row("1 period ahead, nominal model", tested.before, str(tested.before.count)),
        row("1 period ahead, with what was found", tested.after, str(tested.after.count)),
        row("1 period ahead, noise floor", tested.noise_floor, ""),
    ]
    if tested.repeatability.count:
        pairs = f"{tested.repeatability.count} pairs"
        rows.append(row("repeatability of strokes at like states", tested.repeatability, pairs))
    if outcome.followed is not None:
        followed, count = outcome.followed, str(outcome.followed.after.count)
        rows.append(row("1 period ahead, nominal model, drift followed", followed.before, count))
        rows.append(row("1 period ahead, with what was found, drift followed", followed.after, count))
    for each in outcome.horizons:
        if each.periods > 1:
            rows.append(
                row(f"{each.periods} periods ahead, nominal model", each.before, str(each.before.count))
            )
            rows.append(
                row(f"{each.periods} periods ahead, with what was found", each.after, str(each.after.count))
            )
    text = [
        "Each period of the test runs was predicted by the rod simulation from the fixes known at its start "
        "and the action that was done, and compared with the fixes at its end. Several periods ahead, the "
        "simulation went on from that same start with the actions that were really done and saw no further "
        "fix: an error of the model adds up there.",
        "The noise floor is what a perfect model would miss, because fixes tell the pose and speed at the "
        f"start and the pose at the end only so well. Errors up to {NEAR_FLOOR:g} times the floor count as "
        "noise. Repeatability is what strokes did differently from one another at like states; no model that "
        "knows the state alone can predict that, and it does not raise the floor.",
    ]
    if outcome.followed is not None:
        text.append(
            "Limbs drifted in the training runs: what a stroke did beside the model the next one of that "
            "limb mostly did as well. Rows with drift followed add what the run had shown of each limb by "
            "then, to both models alike; all other rows, and the verdict, are of the models alone."
        )
    if outcome.dropped:
        text.append(
            f"The training runs were explained better with {', '.join(outcome.dropped)}, the runs kept out "
            "were not, so nothing of it was taken into the model."
        )
    caption = "Errors on the test runs before and after; the dashed line is the noise floor a period ahead."
    table = Table(("prediction", "position, mm RMS", "heading, deg RMS", "predictions"), rows)
    return Section("Error before and after", text, table, [_picture(error_figure(outcome), caption)])


def _tracks(outcome: Outcome, residuals_of: Misses) -> Section:
    caption = (
        "Left: a whole test run. Right: the periods around the one that the nominal model missed most, with "
        "the names of the actions. Dashed lines lead from where each period began to where it was "
        "predicted "
        "to end."
    )
    picture = _picture(track_figure(outcome, residuals_of), caption)
    return Section("What was predicted, and what happened", images=[picture])


def _residual(outcome: Outcome, residuals_of: Misses) -> Section:
    text = (
        "What is missed is measured minus predicted. A fault of one limb shows at the actions that fire it "
        "and "
        "at its strokes; a current points the same way all over the pool; a wall or a vortex shows in one "
        "place; a battery or a warm-up shows over time.",
    )
    pictures = [
        _picture(
            cause_figure(outcome, residuals_of),
            "Above: what is missed by action. Below: what is missed for each stroke of a limb, by least "
            "squares "
            "over all test periods, forward and left as the robot stood; bars are two standard errors.",
        ),
        _picture(time_figure(outcome, residuals_of), "What is missed in each period of the test runs."),
        _picture(
            place_figure(residuals_of),
            "Where it is missed: dots are measured ends of periods, arrows what is missed there, drawn "
            "longer "
            "than it is, by the same factor on both sides.",
        ),
    ]
    return Section("What is missed: by action, limb, time and place", text, images=pictures)


def _effects(outcome: Outcome) -> Section:
    if not outcome.terms:
        return Section("What was found", ["No effect was taken into the model."])
    assert outcome.found is not None
    fixed, rows, index = outcome.found.fitted.model.fixed, [], 0
    why = (
        f"held at the plain model's value: free, it would gain less than {RELEASE_PENALTY:g}, no more "
        "than noise"
        if outcome.found.iterations
        else "held: it is plain in the measured robot that the fit began with"
    )
    for term, parameters in zip(outcome.terms, outcome.parameters, strict=True):
        for declared, each in zip(term.parameters, parameters, strict=True):
            is_held = index in fixed
            rows.append(
                (
                    term.title,
                    each.name + (f" ({declared.about})" if declared.about else ""),
                    f"{each.value:.4g}",
                    "" if is_held else f"{each.low:.4g} to {each.high:.4g}",
                    "" if each.unit == "1" else each.unit,
                    f"{declared.nominal:g}",
                    why if is_held else "fitted",
                )
            )
            index += 1
    text = [
        "These are terms of the simulator with physical parameters; they go into the robot's file, from "
        "which "
        "library and tables are made anew. Intervals hold all fitted parameters of an effect together with "
        "95 percent.",
        "Taken in so many of other draws of the training runs (blocks of periods with replacement): "
        + ", ".join(
            f"{term.title} {100.0 * share:.0f} percent"
            for term, share in zip(outcome.terms, outcome.found.stability, strict=True)
        )
        + f". An effect below {100.0 * STABLE:.0f} percent is not named.",
    ]
    header = ("effect", "parameter", "value", "interval", "unit", "plain model", "how")
    return Section("What was found", text, Table(header, rows))


def _tried(outcome: Outcome) -> Section:
    assert outcome.found is not None
    iterations = outcome.found.iterations
    if not iterations:
        text = (
            "The effects of a robot of the same body that was measured before were fitted to these runs, all "
            "at once: they explain so much of so large a miss that no search for single effects was made."
        )
        return Section("Which effects were tried, and why this one", [text])
    text_of = [
        "At each turn every effect of the catalogue was ranked by how much likelier it would make what is "
        "missed (its gain, pale bars: by derivatives). The best were fitted by simulation (full bars) and "
        "judged on parts of the training runs that were held out of that fit. An effect is taken where it "
        f"gains more than {EFFECT_PENALTY:g} (dashed), after {PARAMETER_PENALTY:g} off for each free "
        f"parameter, and on each held-out period more than {HELD_OUT_GAIN_MIN:g} and, up to a gain of "
        f"{DECISIVE_GAIN:g}, more than twice what chance would make of it.",
        *(_turn_words(turn, outcome) for turn in range(len(iterations))),
    ]
    rows = []
    for turn, tried in enumerate(iterations, 1):
        seen: set[str] = set()
        for each in sorted(tried, key=lambda each: (not each.chosen, not each.refined, -each.gain)):
            if each.title not in seen and (each.refined or len(seen) < 6):
                held_out = f"{each.held_out:.2f}" if each.refined else "not simulated"
                rows.append(
                    (str(turn), each.title, f"{each.gain:.0f}", held_out, "taken" if each.chosen else "")
                )
            seen.add(each.title)
    header = ("turn", "candidate", "gain", "held-out gain for each period", "")
    images = [_picture(tried_figure(iterations), "Gains of the candidates at each turn; magenta was taken.")]
    return Section("Which effects were tried, and why this one", text_of, Table(header, rows), images)


def _turn_words(turn: int, outcome: Outcome) -> str:
    assert outcome.found is not None
    tried = outcome.found.iterations[turn]
    taken = next((each for each in tried if each.chosen), None)
    others = sorted((each for each in tried if each is not taken), key=lambda each: -each.gain)
    if taken is None:
        best = f"the best, {others[0].title}, gains {others[0].gain:.0f}" if others else "none was left"
        return f"Turn {turn + 1}: no effect was taken; {best}."
    after = f"; next is {others[0].title} with {others[0].gain:.0f}" if others else ""
    return (
        f"Turn {turn + 1}: {taken.title} was taken: it gains {taken.gain:.0f}, and {taken.held_out:.2f} for "
        "each "
        f"held-out period{after}."
    )


def _apart(outcome: Outcome) -> Section:
    """Which effects this data cannot tell apart, and how alike others look."""
    assert outcome.found is not None
    if not outcome.terms:
        return Section(
            "Which effects look alike here", ["Nothing was found, so nothing can be mistaken for it."]
        )
    text = [
        f"These runs cannot tell {term.title} from {', '.join(others)}: each explains them as well as the "
        "other."
        for term, others in zip(outcome.terms, outcome.found.confounded_with, strict=True)
        if others
    ] or ["Every effect found explains these runs clearly better than all others that were tried."]
    if outcome.experiment is not None:
        said = outcome.experiment.text
        text.append(
            f"What would settle it: {said}."
            if outcome.experiment.decisive
            else f"{said[:1].upper()}{said[1:]}."
        )
    rows = [(title, f"{100.0 * share:.0f}") for title, share in mimics(outcome)[:MIMICS_MOST]]
    if not rows:
        return Section("Which effects look alike here", text)
    text.append(
        "How much of the change that was found each candidate could make by itself, from its derivatives on "
        "the "
        "training runs: one near 100 percent that was not taken would look the same."
    )
    return Section("Which effects look alike here", text, Table(("candidate", "of the change, %"), rows))


def _rest(outcome: Outcome) -> Section:
    sentence = str(outcome.diagnostics["text"])
    text = [
        sentence[:1].upper() + sentence[1:] + ".",
        "Each bar is a way to tell the rest: what share of its squares is explained by knowing, say, only "
        "the "
        "action. Where all are small, the rest is noise or something that no such view knows.",
    ]
    rows = [
        (
            name,
            str(row["periods"]),
            f"{1e3 * row['forward_m']:+.2f}",
            f"{1e3 * row['left_m']:+.2f}",
            f"{math.degrees(row['heading_rad']):+.2f}",
        )
        for name, row in outcome.diagnostics["by_action"].items()
    ]
    table = Table(("action", "periods", "mean forward, mm", "mean left, mm", "mean heading, deg"), rows)
    caption = "What is left after the effects found, on the training runs."
    return Section("What stays unexplained", text, table, [_picture(rest_figure(outcome), caption)])


def _terms(outcome: Outcome) -> Section:
    """The runs, and what the words mean."""

    def told(which: str, swims: list[Segments]) -> list[tuple[str, ...]]:
        return [
            (
                which,
                swim.name,
                str(len(swim.start_s)),
                f"{swim.period_s:.3f}",
                f"{1e3 * swim.lag_s:.0f}" if swim.lag_s else "in the log",
            )
            for swim in swims
        ]

    rows = told("learned from", list(outcome.train)) + told("kept out, to judge", list(outcome.test))
    text = [
        f"Nominal model: {outcome.robot.title} ({outcome.robot.id}) as its file describes it. A period is "
        "the time "
        "of one action, which fires some limbs. The period and the delay from command to motion are taken "
        "from "
        "each run first, so that a clock does not pass for physics.",
    ]
    header = ("used", "run", "periods", "period, s", "delay to motion, ms")
    return Section("Runs and words", text, Table(header, rows))
