"""The report of ``frogkick identify``: predictions, residuals, candidates and the effects accepted."""

from __future__ import annotations

import math
from pathlib import Path

from frogkick.core.poses import PredictionError
from frogkick.identification.choice import STABLE
from frogkick.identification.fit import EFFECT_PENALTY, PARAMETER_PENALTY
from frogkick.identification.outcome import Outcome
from frogkick.identification.refine import RELEASE_PENALTY
from frogkick.identification.search import DECISIVE_GAIN, HELD_OUT_GAIN_MIN, CandidateScore
from frogkick.identification.verdict import FOUND, FOUND_LAW, NEAR_FLOOR, NOTHING, PARTLY, UNEXPLAINED
from frogkick.report import identify_figures as figures
from frogkick.report.identify_residuals import Residuals, explained_shares, residuals_of
from frogkick.report.laws import law_section, laws_of
from frogkick.report.page import Section, Table, write_page

TITLE = "What the model lacks"
SHARES_MOST = 8

MEANS = {
    NOTHING: "the nominal model predicts these runs as well as their fixes allow",
    FOUND_LAW: "with the formula below, predictions are as good as the fixes allow",
    FOUND: "with the effects below, predictions are as good as the fixes allow",
    PARTLY: "with the effects below the test runs are more likely, but the residuals still exceed the noise",
    UNEXPLAINED: "none of the candidate effects explains the residuals of the model",
}


def write_identify_page(target: Path, outcome: Outcome) -> None:
    """Write the report as one HTML file."""
    if outcome.found is None:
        lead = f"Verdict: {outcome.verdict}. {outcome.reason[:1].upper()}{outcome.reason[1:]}."
        write_page(target, TITLE, lead, [_terms(outcome)])
        return
    tested = outcome.tested
    names = ", ".join(term.title for term in outcome.terms) or "no effect"
    lead = (
        f"Verdict: {outcome.verdict} ({names}): {MEANS[outcome.verdict]}. One period ahead on the test runs, "
        f"the nominal model of {outcome.robot.title} has an error of {tested.before} (RMS). With the "
        f"identified effects the error is {tested.after}. Noise of the fixes alone causes "
        f"{tested.noise_floor}."
    )
    if tested.gain is not None:
        value, low, high = tested.gain.value, tested.gain.low, tested.gain.high
        lead += (
            f" The log score of a period rises by {value:.2f} (95 percent interval {low:.2f} to {high:.2f})."
        )
    residuals = residuals_of(outcome)
    sections = [_errors(outcome)]
    if len(residuals.run):
        sections += [_tracks(outcome, residuals), _residual(outcome, residuals)]
    sections += [_effects(outcome), *([law_section(outcome)] if laws_of(outcome) else [])]
    sections += [_candidates(outcome), _confounded(outcome), _unexplained(outcome), _terms(outcome)]
    write_page(target, TITLE, lead, sections)


def _errors(outcome: Outcome) -> Section:
    rows: list[tuple[str, PredictionError, object]] = []

    def add(ahead: str, before: PredictionError, after: PredictionError, more: str = "") -> None:
        rows.append((f"{ahead}, nominal model{more}", before, before.count))
        rows.append((f"{ahead}, with identified effects{more}", after, after.count))

    tested = outcome.tested
    add("1 period ahead", tested.before, tested.after)
    rows.append(("1 period ahead, noise floor", tested.noise_floor, ""))
    if tested.repeatability.count:
        pairs = f"{tested.repeatability.count} pairs"
        rows.append(("repeatability of strokes from similar states", tested.repeatability, pairs))
    if outcome.followed is not None:
        add("1 period ahead", outcome.followed.before, outcome.followed.after, ", drift estimated")
    for each in outcome.horizons:
        if each.periods > 1:
            add(f"{each.periods} periods ahead", each.before, each.after)
    table = Table.of(
        rows,
        {
            "prediction": lambda row: row[0],
            "position, mm RMS": lambda row: f"{1e3 * row[1].position_rmse_m:.2f}",
            "heading, deg RMS": lambda row: f"{math.degrees(row[1].heading_rmse_rad):.2f}",
            "predictions": lambda row: row[2],
        },
    )
    text = [
        "Each period of the test runs was predicted by the rod simulation from the fixes known at its start "
        "and the recorded action, and compared with the fixes at its end. A multi-step prediction "
        "continues from the same start with the recorded actions and uses no further fix, so model errors "
        "accumulate.",
        "The noise floor is the error of a perfect model. It is not zero because the fixes are noisy: they "
        "give the pose and speed at the start and the pose at the end with limited accuracy. Errors up to "
        f"{NEAR_FLOOR:g} times the floor count as noise. Repeatability is the difference between strokes "
        "from similar states. No model of the state alone can predict it. It does not raise the floor.",
    ]
    if outcome.followed is not None:
        text.append(
            "Limbs drifted in the training runs: the residual of a stroke mostly recurred in the next "
            "stroke of the same limb. The rows with drift estimated add each limb's offset, estimated from "
            "the run so far, to both models. All other rows and the verdict use the models alone."
        )
    if outcome.ended_early:
        text.append(
            f"The search ended by its bound, after {outcome.evaluations} simulations of the training runs. "
            "Effects may be missing."
        )
    text += [f"{each[0].upper()}{each[1:]}." for each in outcome.untried]
    if outcome.dropped:
        text.append(
            f"{', '.join(outcome.dropped)} explained the training runs better, but not the test runs. So it "
            "was not accepted into the model."
        )
        text += [f"{outcome.few_tested.capitalize()}."] if outcome.few_tested else []
    caption = "Errors on the test runs before and after. The dashed line is the noise floor one period ahead."
    return Section("Error before and after", text, table, [(figures.error_figure(outcome), caption)])


def _tracks(outcome: Outcome, residuals: Residuals) -> Section:
    caption = (
        "Left: a whole test run. Right: the periods around the largest error of the nominal model, with the "
        "names of the actions. A dashed line leads from the start of each period to its predicted end."
    )
    picture = (figures.track_figure(outcome, residuals), caption)
    return Section("Predictions and measurements", images=[picture])


def _residual(outcome: Outcome, residuals: Residuals) -> Section:
    text = (
        "A residual is the measured minus the predicted pose. A fault of one limb appears at its strokes and "
        "at the actions that fire it. A current has the same direction all over the pool. A wall or a vortex "
        "appears in one place. A battery or a warm-up appears over time.",
    )
    pictures = [
        (
            figures.by_action_figure(outcome, residuals),
            "Above: residuals by action. Below: the residual of each limb's strokes by least squares over "
            "all test periods, forward and left in the robot's frame. Bars are two standard errors.",
        ),
        (figures.time_figure(outcome, residuals), "The residual of each period of the test runs."),
        (
            figures.place_figure(residuals),
            "Residuals by place: dots are the measured ends of periods, arrows the residuals there. The "
            "arrows are magnified by the same factor on both sides.",
        ),
    ]
    missing = figures.missing_terms_figure(outcome)
    if missing is not None:
        caption = (
            "What the model with the identified effects leaves unexplained in the training runs. From top "
            "to bottom: the missing force and torque in each third of a period, estimated by a smoother, "
            "with a band of two standard deviations; the log likelihood ratio of each stroke, fired to not "
            "fired; the innovation of each fix in robust standard deviations."
        )
        pictures.append((missing, caption))
    return Section("Residuals by action, limb, time and place", text, images=pictures)


def _effects(outcome: Outcome) -> Section:
    if not outcome.terms:
        return Section("Identified effects", ["No effect was accepted into the model."])
    assert outcome.found is not None
    why = (
        f"fixed at the nominal value: as a free parameter it would gain less than {RELEASE_PENALTY:g}, "
        "which is no more than noise"
        if outcome.found.iterations
        else "fixed: the calibrated robot that the fit started from has the nominal value"
    )
    every = [
        (term.title, declared, each)
        for term, parameters in zip(outcome.terms, outcome.parameters, strict=True)
        for declared, each in zip(term.parameters, parameters, strict=True)
    ]
    held = outcome.found.fitted.model.fixed
    rows = [
        (
            title,
            each.name + (f" ({declared.about})" if declared.about else ""),
            f"{each.value:.4g}",
            f"{each.low:.4g} to {each.high:.4g}",
            "" if each.unit == "1" else each.unit,
            f"{declared.nominal:g}",
            why if index in held else "fitted",
        )
        for index, (title, declared, each) in enumerate(every)
    ]
    shares = ", ".join(
        f"{term.title} {100.0 * share:.0f} percent"
        for term, share in zip(outcome.terms, outcome.found.stability, strict=True)
    )
    text = [
        "These effects are terms of the simulator with physical parameters. They are written into the "
        "robot's file, from which a new library and a new table can be made. Each interval contains the true "
        "value with 95 percent probability.",
        "Share of bootstrap samples of the training runs (blocks of periods with replacement) in which each "
        f"effect was accepted: {shares}. An effect below {100.0 * STABLE:.0f} percent is not named.",
    ]
    header = ("effect", "parameter", "value", "interval", "unit", "nominal value", "how")
    return Section("Identified effects", text, Table(header, rows))


def _candidates(outcome: Outcome) -> Section:
    assert outcome.found is not None
    iterations = outcome.found.iterations
    if not iterations:
        text = (
            "All effects of a calibrated robot with the same body were fitted to these runs at once. They "
            "explain so large a share of large residuals that single effects were not searched for."
        )
        return Section("Candidate effects and their selection", [text])
    text_of = [
        "Effects were found by forward selection. In each iteration every effect of the catalogue was "
        "ranked by its gain, which is the fall of -2 log likelihood (pale bars: by derivatives). The best "
        "were fitted by simulation (full bars) and judged on parts of the training runs that were held out "
        f"of that fit. An effect is accepted under two conditions. Its gain, less {PARAMETER_PENALTY:g} for "
        f"each free parameter, is more than {EFFECT_PENALTY:g} (dashed). Its gain for each held-out period "
        f"is more than {HELD_OUT_GAIN_MIN:g} and, up to a gain of {DECISIVE_GAIN:g}, more than twice its "
        "value by chance.",
        *(_iteration_words(index, tried) for index, tried in enumerate(iterations, 1)),
    ]
    rows = [
        (index, each)
        for index, tried in enumerate(iterations, 1)
        for place, each in enumerate(figures.ranked(tried))
        if each.refined or place < 6
    ]
    table = Table.of(
        rows,
        {
            "iteration": lambda row: row[0],
            "candidate": lambda row: row[1].title,
            "gain": lambda row: f"{row[1].gain:.0f}",
            "held-out gain for each period": lambda row: (
                f"{row[1].held_out:.2f}" if row[1].refined else "not simulated"
            ),
            "": lambda row: "accepted" if row[1].chosen else "",
        },
    )
    caption = "Gains of the candidates in each iteration; the accepted one is magenta."
    images = [(figures.candidates_figure(iterations), caption)]
    return Section("Candidate effects and their selection", text_of, table, images)


def _iteration_words(number: int, tried: list[CandidateScore]) -> str:
    taken = next((each for each in tried if each.chosen), None)
    others = sorted((each for each in tried if each is not taken), key=lambda each: -each.gain)
    if taken is None:
        best = f"the best, {others[0].title}, gains {others[0].gain:.0f}" if others else "none was left"
        return f"Iteration {number}: no effect was accepted; {best}."
    after = f"; the next best was {others[0].title} with {others[0].gain:.0f}" if others else ""
    return (
        f"Iteration {number}: {taken.title} was accepted with a gain of {taken.gain:.0f}, and of "
        f"{taken.held_out:.2f} for each held-out period{after}."
    )


def _confounded(outcome: Outcome) -> Section:
    """The effects that are confounded in these runs, and the similarity of the other candidates."""
    assert outcome.found is not None
    if not outcome.terms:
        return Section("Confounded effects", ["No effect was found, so none can be confounded with it."])
    text = [
        f"These runs cannot distinguish {term.title} from {', '.join(others)}: both explain them well."
        for term, others in zip(outcome.terms, outcome.found.confounded_with, strict=True)
        if others
    ] or ["Every identified effect explains these runs clearly better than all other candidates."]
    if outcome.experiment is not None:
        said = outcome.experiment.text
        is_decisive = outcome.experiment.decisive
        text.append(f"A decisive experiment: {said}." if is_decisive else f"{said[:1].upper()}{said[1:]}.")
    rows = [(title, f"{100.0 * share:.0f}") for title, share in explained_shares(outcome)[:SHARES_MOST]]
    if not rows:
        return Section("Confounded effects", text)
    text.append(
        "The table shows how much of the change by the identified effects each candidate could explain by "
        "itself, from its derivatives on the training runs. A candidate near 100 percent that was not "
        "accepted is confounded with them."
    )
    return Section("Confounded effects", text, Table(("candidate", "share of the change, %"), rows))


def _unexplained(outcome: Outcome) -> Section:
    sentence = str(outcome.diagnostics["text"])
    text = [
        sentence[:1].upper() + sentence[1:] + ".",
        "Each bar shows how much of the residuals' sum of squares one variable explains, such as the action "
        "alone. If all bars are small, the residuals are noise or depend on none of these variables.",
    ]
    table = Table.of(
        outcome.diagnostics["by_action"].items(),
        {
            "action": lambda row: row[0],
            "periods": lambda row: row[1]["periods"],
            "mean forward, mm": lambda row: f"{1e3 * row[1]['forward_m']:+.2f}",
            "mean left, mm": lambda row: f"{1e3 * row[1]['left_m']:+.2f}",
            "mean heading, deg": lambda row: f"{math.degrees(row[1]['heading_rad']):+.2f}",
        },
    )
    caption = "Residuals on the training runs with the identified effects."
    return Section("Unexplained residuals", text, table, [(figures.unexplained_figure(outcome), caption)])


def _terms(outcome: Outcome) -> Section:
    """The runs, and the terms of this page."""
    text = [
        f"The nominal model is {outcome.robot.title} ({outcome.robot.id}) as its file describes it. A period "
        "is the time of one action, which fires some limbs. The period and the delay from command to motion "
        "are estimated from each run first, so that a clock error is not taken for physics.",
    ]
    swims = [("training", swim) for swim in outcome.train] + [("test", swim) for swim in outcome.test]
    table = Table.of(
        swims,
        {
            "used": lambda row: row[0],
            "run": lambda row: row[1].name,
            "periods": lambda row: len(row[1].start_s),
            "period, s": lambda row: f"{row[1].period_s:.3f}",
            "delay to motion, ms": lambda row: f"{1e3 * row[1].lag_s:.0f}" if row[1].lag_s else "in the log",
        },
    )
    return Section("Runs and terms", text, table)
