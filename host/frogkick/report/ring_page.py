"""The demo's report: the results of all stages, path by path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.poses import PredictionError
from frogkick.report.identify_figures import error_figure
from frogkick.report.page import Section, Table, write_page
from frogkick.report.robot_figure import actions_figure, robot_figure
from frogkick.report.run_figure import run_figure
from frogkick.report.style import ESTIMATED, NOMINAL, PREDICTED, legend_below, new_figure
from frogkick.ring import Adaptation, Ring, RingRun
from frogkick.runs.live_view import fan_of
from frogkick.runs.runlog import RunLog
from frogkick.runs.summary import bends_of, lost_of, tracking_of_log
from frogkick.tables.layout import LIMBS_MAX
from frogkick_codegen.firmware import CHIPS


def write_ring_report(target: Path, ring: Ring) -> None:
    """Write the report of ``run_demo`` as one HTML file."""
    error = ring.prediction_error
    lead = (
        f"A simulated robot, {ring.robot.title}, followed three paths with the planner running on a virtual "
        f"nRF52832. Mean distance to the path {1e3 * ring.mean_distance_m:.1f} mm. The pool is simulated "
        "with the rods, not with the table: the prediction of the table one period ahead has an error "
        f"of {error:.1f} (RMSE, {error.count} periods)."
    )
    sections = [_robot(ring), _paths(ring), *(_one_path(run) for run in ring.runs), _chip(ring)]
    if ring.adaptation is not None:
        outcome = ring.adaptation.outcome
        found = ", ".join(term.title for term in outcome.terms) or "no effect"
        lead += (
            " Then a limb was worn, and the model did not contain the wear. The verdict of identification "
            f"from the logs of four runs is: {outcome.verdict} ({found}). One "
            f"period ahead on the test run, the nominal model has an error of {outcome.tested.before}. With "
            f"the identified effects the error is {outcome.tested.after}. Noise of the fixes alone causes "
            f"{outcome.tested.noise_floor}."
        )
        sections.append(_adaptation(ring.adaptation))
    write_page(
        target, "frogkick demo: from the model to the firmware and back", lead, [*sections, _how(ring)]
    )


def _adaptation(adaptation: Adaptation) -> Section:
    outcome, true_effect = adaptation.outcome, adaptation.true_effect
    hidden = {key: value for key, value in true_effect.items() if key not in ("name", "limb")}
    true = f"{true_effect['name']} {true_effect['limb']}"
    rows = [
        (
            term.title,
            each.name,
            f"{each.value:.3g}{'' if each.unit == '1' else ' ' + each.unit}",
            f"{each.low:.3g} to {each.high:.3g}",
            f"{hidden.get(each.name, declared.nominal):g}" if term.title == true else "not there",
        )
        for term, parameters in zip(outcome.terms, outcome.parameters, strict=True)
        for declared, each in zip(term.parameters, parameters, strict=True)
    ]
    text = [
        f"Hidden in the pool: {true}, {', '.join(f'{key} {value:g}' for key, value in hidden.items())}. The "
        "worn robot followed four paths. Identification used the logs of these runs (fixes, strokes, "
        "decisions) and no true poses. The last run is the test run; all others are the training runs.",
        "A new library, table and firmware were made with the identified effects. The worn robot was "
        f"{1e3 * adaptation.distance_m(adaptation.new):.1f} mm from its paths on average with these, and "
        f"{1e3 * adaptation.distance_m(adaptation.old):.1f} mm with the old ones."
        if adaptation.new
        else "No effect was found, so library, table and firmware were not changed.",
        "With the old table the robot can also estimate the wear of its limbs while it swims (run --learn). "
        f"It was then {1e3 * adaptation.distance_m(adaptation.learned):.1f} mm from the same paths. "
        f"Estimated at the end of each run: {', '.join(_wear_estimate(run) for run in adaptation.learned)}.",
    ]
    worse = [
        f"the {_name(old)} from {_distance(old)} to {_distance(new)} mm"
        for old, new in zip(adaptation.old, adaptation.new, strict=False)
        if tracking_of_log(new).mean_distance_m > tracking_of_log(old).mean_distance_m
    ]
    if worse:
        text.append(
            f"Not every path improved: {', '.join(worse)}. Each value comes from one swim, in which a "
            "different early decision changes the rest. 'frogkick study loop' averages over many seeds."
        )
    images = [(error_figure(outcome), "Errors on the test run before and after.")]
    if adaptation.new:
        images.append((_distances(adaptation), "The worn robot on its paths, with the same noise each time."))
    table = Table(("found", "parameter", "value", "interval", "true value"), rows) if rows else None
    links = [("identify.html", "The full report of the identification")]
    return Section("A worn limb, identified from the logs", text, table, images, links)


def _wear_estimate(run: RunLog) -> str:
    """Return the wear of limbs that the robot had estimated at the end of a run."""
    shares = lost_of(run) or {}
    lost = [f"{name} has lost {100.0 * share:.0f} %" for name, share in shares.items() if share]
    return f"on the {_name(run)} {' and '.join(lost) or 'nothing is lost'}"


def _distances(adaptation: Adaptation) -> Figure:
    names = [_name(run) for run in adaptation.old]
    with new_figure(6.6, 2.8) as figure:
        axes = figure.subplots()
        for shift, runs, colour, label in (
            (-0.27, adaptation.old, NOMINAL, "old firmware"),
            (0.0, adaptation.learned, ESTIMATED, "old firmware, learning"),
            (0.27, adaptation.new, PREDICTED, "new firmware"),
        ):
            heights = [1e3 * tracking_of_log(run).mean_distance_m for run in runs]
            axes.bar(np.arange(len(runs)) + shift, heights, 0.25, color=colour, label=label)
            for place, height in enumerate(heights):
                axes.text(place + shift, height, f"{height:.1f}", ha="center", va="bottom", fontsize=8)
        axes.set_xticks(range(len(names)), names)
        axes.set(xlabel="path", ylabel="mean distance (mm)", title="Worn robot: distance from the path")
        axes.margins(y=0.12)
        legend_below(figure, axes, 3)
    return figure


def _name(run: RunLog) -> str:
    return run.path.name if run.path else "path"


def _distance(run: RunLog) -> str:
    return f"{1e3 * tracking_of_log(run).mean_distance_m:.1f}"


def _robot(ring: Ring) -> Section:
    robot = ring.robot
    ends = fan_of(ring.tables, np.zeros(6, dtype=np.float32), (0,) * LIMBS_MAX)
    text = (
        f"It has {len(robot.limbs)} limbs on a frame. A pulse of {1e3 * robot.pulse_s:.0f} ms heats a limb, "
        f"which bends and pushes the water. Every {robot.period_s:g} s the robot chooses one of "
        f"{len(robot.actions)} actions: which limbs to heat immediately, and which ones "
        f"{robot.second_delay_s:g} s later.",
    )
    images = (
        (robot_figure(robot), "The robot from above, swimming up the page."),
        (
            actions_figure(robot, ends),
            "The actions. Orange limbs are heated first, pink ones after them. The arrow and the numbers "
            "show how far a stroke from rest moves the robot in one period, and how far it turns the robot "
            "(positive: to the left).",
        ),
    )
    return Section("The robot", text, images=images)


def _why(ring: Ring) -> list[str]:
    """Compare the turns of the worst path with those that the robot made."""
    worst = max(ring.runs, key=lambda run: run.tracking.mean_distance_m)
    bends = bends_of(worst.log, worst.tracking.progress_mps)
    if bends is None or worst.log.truth is None:
        return []
    asked_deg, turned_deg = np.rad2deg(bends.asked_rad), np.rad2deg(bends.turned_rad)
    text = (
        f"The {_name(worst.log)} has the largest mean distance, {_distance(worst.log)} mm. "
        f"In one period the robot moved {1e3 * bends.step_m:.0f} mm along it. Where the path bends most, its "
        f"direction changes by {asked_deg:.0f} degrees over that length. The largest turn of the robot in "
        f"any period was {turned_deg:.0f} degrees."
    )
    if bends.too_tight:
        text += (
            " So no choice of actions can stay on the path there. A path about "
            f"{asked_deg / turned_deg:.1f} times as large would help, or limbs that turn the robot more."
        )
    else:
        text += " So the path is not too tight. The distance comes from the prediction error (see below)."
    return [text]


def _paths(ring: Ring) -> Section:
    table = Table.of(
        ring.runs,
        {
            "path": lambda run: _name(run.log),
            "mean distance, mm": lambda run: _distance(run.log),
            "95th percentile, mm": lambda run: f"{1e3 * run.tracking.p95_distance_m:.1f}",
            "progress, mm/s": lambda run: f"{1e3 * run.tracking.progress_mps:.1f}",
            "completed": lambda run: "yes" if run.tracking.completed else f"no ({run.log.notes})",
            "decisions": lambda run: run.tracking.decisions,
            "prediction error": lambda run: f"{PredictionError.of(run.gap_body):.1f}",
            "chip against Python twin, mismatches": lambda run: run.mismatches,
            "guard limits violated": lambda run: run.tracking.limit_violations,
        },
    )
    links = [(f"{_name(run.log)}.h5", f"The log of the {_name(run.log)}") for run in ring.runs]
    return Section("The paths", _why(ring), table, links=links)


def _one_path(run: RingRun) -> Section:
    name = _name(run.log)
    figure = run_figure(run.log, f"{name}: {run.tracking.decisions} decisions on the chip")
    caption = (
        "Left: the true track over the desired path, with the noisy fixes that the robot saw. Right: "
        "distance to the path; the actions chosen; the error of the robot's own estimate; the error of the "
        "prediction."
    )
    return Section(name.capitalize(), images=[(figure, caption)])


def _chip(ring: Ring) -> Section:
    chip, built = ring.chip, ring.built
    of = CHIPS[built.target]
    flash, ram = 100 * built.flash_bytes / of.flash_bytes, 100 * built.ram_bytes / of.ram_bytes
    slowest_ms = max(run.tracking.plan_ms_p99 or 0.0 for run in ring.runs)
    rows = [
        ("flash", f"{built.flash_bytes:,} bytes, {flash:.1f} % of the chip"),
        ("of which the table", f"{len(ring.tables.image):,} bytes, {len(ring.tables.states)} states"),
        ("RAM with reserved stack", f"{built.ram_bytes:,} bytes, {ram:.1f} %"),
        ("deepest stack measured", f"{chip.stack_bytes:,} bytes"),
        *(
            (f"one plan at depth {depth}", f"{ms:.2f} ms ({chip.plan_cycles[depth]:,} cycles at 64 MHz)")
            for depth, ms in chip.plan_ms.items()
        ),
        ("computing time of a decision, 99th percentile", f"{slowest_ms:.2f} ms"),
        ("tests of the firmware", f"{sum(chip.checks.values())} of {len(chip.checks)} passed"),
    ]
    text = (
        "The times come from instructions counted on the virtual chip with its cycle model "
        "(host/frogkick/pool/chip), not from a real board.",
    )
    return Section("On the chip", text, Table(("what", "measured"), rows))


def _how(ring: Ring) -> Section:
    rows = [(stage, f"{seconds:.1f} s") for stage, seconds in ring.stage_s.items()]
    text = (
        f"Robot {ring.robot.id}: period {ring.robot.period_s} s, pulse {1e3 * ring.robot.pulse_s:.0f} ms, "
        f"{len(ring.robot.limbs)} limbs, {len(ring.robot.actions)} actions. Fixes at 15 Hz, 80 ms late, with "
        "the noise measured on the paper's recorded runs (0.2 mm, 0.2 degrees).",
    )
    return Section("How it was made", text, Table(("stage", "time on this computer"), rows))
