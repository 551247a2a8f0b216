"""The report of ``frogkick identify``: what was predicted, what happened, which effects were tried."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from frogkick.identify.outcome import Outcome
from frogkick.identify.verdict import gaps
from frogkick.report import style
from frogkick.report.page import Section, Table, write_page

FloatArray = npt.NDArray[np.float64]


def write_identify_page(target: Path, outcome: Outcome) -> None:
    """Write the report as one HTML file.

    Raises:
        InputError: the file cannot be written.
    """
    if outcome.found is None:
        lead = f"Verdict: {outcome.verdict}. {outcome.reason[:1].upper()}{outcome.reason[1:]}."
        write_page(target, "What the model lacks", lead, [])
        return
    tested = outcome.tested
    names = ", ".join(term.title for term in outcome.terms) or "no effect"
    before, after, floor = (
        f"{1e3 * error.position_rmse_m:.2f} mm and {np.rad2deg(error.heading_rmse_rad):.2f} degrees"
        for error in (tested.before, tested.after, tested.noise_floor)
    )
    lead = (
        f"Verdict: {outcome.verdict} ({names}). A period ahead, on runs kept out of learning, the nominal "
        f"model of {outcome.robot.title} is off by {before} (RMSE), with what was found by {after}; what the "
        f"fixes themselves allow is {floor}."
    )
    write_page(
        target,
        "What the model lacks",
        lead,
        [_errors(outcome), _effects(outcome), _tried(outcome), _rest(outcome)],
    )


def _errors(outcome: Outcome) -> Section:
    """Before and after, action by action and period by period, with the noise floor drawn in."""
    nominal, fitted = gaps(outcome.nominal_tracks, outcome.test), gaps(outcome.tracks, outcome.test)
    action = np.concatenate([swim.action for swim in outcome.test])
    known = np.isfinite(nominal).all(axis=1) & np.isfinite(fitted).all(axis=1)
    nominal, fitted, action = nominal[known], fitted[known], action[known]
    names = outcome.test[0].action_names
    floor = outcome.tested.noise_floor
    with style.styled():
        figure = Figure(figsize=(11.0, 6.4), layout="constrained")
        panels = figure.subplots(2, 2)
        for row, (size, unit, what, level) in enumerate(
            (
                (_position_mm, "mm", "position", 1e3 * floor.position_rmse_m),
                (_heading_deg, "deg", "heading", float(np.rad2deg(floor.heading_rmse_rad))),
            )
        ):
            left, right = panels[row]
            left.plot(size(nominal), "o-", color=style.DESIRED, markersize=3, linewidth=0.7, label="nominal")
            left.plot(size(fitted), "o-", color=style.TRUE, markersize=3, linewidth=0.7, label="with effects")
            left.axhline(level, color=style.ALARM, linestyle="--", label="noise floor (RMS)")
            left.set_xlabel("period of the test runs")
            left.set_ylabel(f"{what} missed ({unit})")
            left.set_title(f"{what.capitalize()} missed, a period ahead")
            left.legend()
            labels = np.unique(action)
            place = np.arange(len(labels))
            for shift, gap, colour in ((-0.2, nominal, style.DESIRED), (0.2, fitted, style.TRUE)):
                heights = [float(np.sqrt((size(gap[action == label]) ** 2).mean())) for label in labels]
                right.bar(place + shift, heights, 0.38, color=colour)
            right.axhline(level, color=style.ALARM, linestyle="--")
            right.set_xticks(place, [names[label] if label >= 0 else "?" for label in labels])
            right.set_xlabel("action")
            right.set_ylabel(f"RMS ({unit})")
            right.set_title(f"{what.capitalize()} missed, by action")
    rows = [
        (name, f"{1e3 * error.position_rmse_m:.2f}", f"{np.rad2deg(error.heading_rmse_rad):.2f}")
        for name, error in (
            ("nominal", outcome.tested.before),
            ("with effects", outcome.tested.after),
            ("noise floor", outcome.tested.noise_floor),
        )
    ]
    text = (
        "Each period of the test runs was predicted from the fixes known at its start, and compared with the "
        "fixes at its end. Grey is the nominal model, blue the one with the effects found."
    )
    alt = "missed position and heading of each period and each action, before and after"
    table = Table(("model", "position, mm RMS", "heading, deg RMS"), rows)
    return Section("Before and after", [text], table, [(style.figure_uri(figure), alt)])


def _position_mm(gap: FloatArray) -> FloatArray:
    return np.asarray(1e3 * np.hypot(gap[:, 0], gap[:, 1]))


def _heading_deg(gap: FloatArray) -> FloatArray:
    return np.asarray(np.rad2deg(np.abs(gap[:, 2])))


def _effects(outcome: Outcome) -> Section:
    rows = [
        (term.title, each.name, f"{each.value:.4g}", f"{each.low:.4g} to {each.high:.4g}", each.unit)
        for term, parameters in zip(outcome.terms, outcome.parameters, strict=True)
        for each in parameters
    ]
    text = [
        "Intervals hold all parameters of an effect together with 95 percent."
        if rows
        else "No effect was taken into the model."
    ]
    if outcome.found is not None:
        text += [
            f"The data cannot tell {term.title} from {', '.join(others)}."
            for term, others in zip(outcome.terms, outcome.found.alike, strict=True)
            if others
        ]
    table = Table(("effect", "parameter", "value", "interval", "unit"), rows) if rows else None
    return Section("What was found", text, table)


def _tried(outcome: Outcome) -> Section:
    assert outcome.found is not None
    if outcome.terms and not outcome.found.turns:
        text = (
            "The effects of a robot of the same body that was measured before were fitted to these runs, all "
            "at once: they explain so much of so large a miss that no search for single effects was made."
        )
        return Section("What was tried", [text])
    rows = [
        (
            str(turn + 1),
            each.title,
            f"{each.gain:.0f}",
            f"{each.held_out:.2f}" if each.refined else "not simulated",
            "taken" if each.chosen else "",
        )
        for turn, tried in enumerate(outcome.found.turns)
        for each in tried[:10]
    ]
    text = (
        "At each turn every candidate was ranked by how much likelier it would make the misses; the best "
        "were fitted by simulation and judged on parts of the runs that were held out. One is taken where it "
        "gains clearly in both."
    )
    header = ("turn", "candidate", "gain in -2 log likelihood", "held-out gain for each period", "")
    return Section("What was tried", [text], Table(header, rows))


def _rest(outcome: Outcome) -> Section:
    shares = outcome.signature["shares"]
    rows = [(view, f"{100 * share:.0f}") for view, share in sorted(shares.items(), key=lambda item: -item[1])]
    text = str(outcome.signature["text"])
    return Section(
        "What is left, in the training runs",
        [text[:1].upper() + text[1:] + "."],
        Table(("told by", "share, %"), rows),
    )
