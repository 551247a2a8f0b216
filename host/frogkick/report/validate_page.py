"""The report of ``frogkick validate``: measurement, the model and the authors' simulation compared."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick.report.page import Section, Table, left_out, write_page
from frogkick.validation.gaits import CYCLES, FIRST_CYCLE
from frogkick.validation.measured import EXPERIMENTS, SIMULATIONS
from frogkick.validation.validate import (
    SPEED_LIMITS_MPS,
    WITHIN_CYCLE_LIMIT_M,
    ExperimentResult,
    Result,
    SimulationResult,
    SpeedNoise,
    Validation,
)

MODEL = style.PREDICTED
AUTHORS = "#56b4e9"  # of the same palette, for the authors' simulation
AUTHORS_LABEL = "authors' simulation"


def write_validation_report(target: Path, validation: Validation, noise: SpeedNoise) -> None:
    """Write the report of ``validate`` as one HTML file."""
    speed = validation.speed_rmse_mps
    lead = (
        f"{len(validation.simulations)} of the authors' simulations and {len(validation.experiments)} "
        f"measured swims are compared with the model {validation.robot.title}, with one parameter set "
        "for all."
    )
    for kind, against in ((SIMULATIONS, "the authors' simulations"), (EXPERIMENTS, "measurement")):
        if kind in speed:
            lead += f" Against {against}: speed RMSE {_mm(speed[kind])} mm/s."
    sections = [_requirements(validation)]
    if validation.simulations:
        sections += [_speeds(validation), _errors(validation), _waves(validation)]
    if validation.experiments:
        sections.append(_experiments(validation, noise))
    skipped = [(each.case, each.reason) for each in validation.skipped]
    sections += [_cases(validation), left_out(skipped, "case")]
    write_page(target, "frogkick: the model against the paper's data", lead, sections)


def _mm(value_m: float | None, digits: int = 2) -> str:
    return "-" if value_m is None or not math.isfinite(value_m) else f"{1e3 * value_m:.{digits}f}"


def _requirements(validation: Validation) -> Section:
    rows = []
    for each in (*validation.requirements, *validation.single_groups_above):
        is_speed = each.what == "speed_rmse_mps"
        what, unit = ("speed RMSE", "mm/s") if is_speed else ("RMS within a cycle", "mm")
        values = f"{_mm(each.value)} {unit}", f"{_mm(each.limit, 1)} {unit}"
        rows.append((what, each.group, *values, "held" if each.held else "MISSED"))
    text = (
        "The limits bound the difference from the authors' simulations over all cases of a kind. Below "
        "them are the single groups that exceed the limit of their kind. Measured swims have no limit "
        "here, because identification deals with what the model lacks.",
    )
    return Section("Limits", text, Table(("what", "over which cases", "value", "limit", "verdict"), rows))


def _sweeps(validation: Validation) -> dict[str, list[Result]]:
    """Return the results by sweep (``freq/10``), simulated and measured."""
    found: dict[str, list[Result]] = {}
    everything: Sequence[Result] = (*validation.simulations, *validation.experiments)
    for result in everything:
        parts = result.case.group.split("/")
        if parts[1] in ("freq", "phase"):
            found.setdefault("/".join(parts[1:3]), []).append(result)
    return dict(sorted(found.items()))


def _place(result: Result, sweep: str) -> float:
    return result.case.gait.phase if sweep.startswith("phase") else result.case.gait.frequency_hz


def _title(sweep: str) -> str:
    kind, name = sweep.split("/", 1)
    egain, _, hz = name.partition("_")
    return f"{egain} % EGaIn, phase 0.5" if kind == "freq" else f"{egain} % EGaIn, {hz[:-2]} Hz"


def _axis_label(sweep: str) -> str:
    return "phase offset (share of the cycle)" if sweep.startswith("phase") else "frequency (Hz)"


@contextmanager
def _panels(count: int, height: float) -> Iterator[tuple[Figure, list[Axes]]]:
    """Yield a figure and its panels, three in a row, to draw on; their legend is outside of them."""
    columns = min(3, count)
    rows = math.ceil(count / columns)
    with style.new_figure(3.8 * columns, height * rows) as figure:
        every = list(np.ravel(figure.subplots(rows, columns, squeeze=False)))
        for spare in every[count:]:
            spare.set_visible(False)
        yield figure, every[:count]
        entries: dict[Any, Any] = {}
        for panel in every[:count]:
            handles, labels = panel.get_legend_handles_labels()
            entries |= zip(labels, handles, strict=True)
        figure.legend(entries.values(), entries, loc="outside upper center", ncols=len(entries))


def _speeds(validation: Validation) -> Section:
    sweeps = _sweeps(validation)
    with _panels(len(sweeps), 2.7) as (figure, panels):
        for axes, (sweep, results) in zip(panels, sweeps.items(), strict=True):
            _speed_panel(axes, sweep, results)
    caption = (
        f"Speed of every gait. Simulated: mean over cycles {FIRST_CYCLE} to {CYCLES}. Measured: slope of a "
        "line through distance over time; bars are two standard deviations of the mean over the whole cycles "
        "of one swim. They do not include the difference between two swims."
    )
    return Section("Speeds", images=[(figure, caption)])


def _speed_panel(axes: Axes, sweep: str, results: Sequence[Result]) -> None:
    ordered = sorted(results, key=lambda result: _place(result, sweep))
    model = sorted({(_place(r, sweep), 1e3 * r.model_mps) for r in ordered})
    axes.plot(*np.array(model).T, "o-", color=MODEL, markersize=4, label="model", zorder=3)
    simulated, swims = (
        [r for r in ordered if isinstance(r, kind)] for kind in (SimulationResult, ExperimentResult)
    )
    authors, measured = (
        np.array([(_place(r, sweep), 1e3 * r.reference.speed_mps) for r in some])
        for some in (simulated, swims)
    )
    if simulated:
        axes.plot(*authors.T, "s--", color=AUTHORS, markersize=4, label=AUTHORS_LABEL)
    if swims:
        bars = [2e3 * (r.reference.sd_mps or 0.0) for r in swims]
        look = style.look(color=style.MEASURED, markersize=4, capsize=2, label="measured")
        axes.errorbar(measured[:, 0], measured[:, 1], bars, fmt="D", **look)
    axes.set_ylim(bottom=0.0)
    axes.set(title=_title(sweep), xlabel=_axis_label(sweep), ylabel="speed (mm/s)")


def _errors(validation: Validation) -> Section:
    kinds = [kind for kind in SPEED_LIMITS_MPS if any(_in(r, kind) for r in validation.simulations)]
    with style.new_figure(11.0, 3.4 * len(kinds)) as figure:
        for row, kind in zip(figure.subplots(len(kinds), 2, squeeze=False), kinds, strict=True):
            _error_panels(row[0], row[1], kind, [r for r in validation.simulations if _in(r, kind)])
    text = ("Dotted lines are the limits. They hold for the RMS over all cases of a row, not for each case.",)
    caption = "Difference of every simulated case, one marker for each sweep (legend on the right)."
    return Section("Against the authors' simulations", text, images=[(figure, caption)])


def _error_panels(speed: Axes, wave: Axes, kind: str, members: Sequence[SimulationResult]) -> None:
    for marker, group in zip("os^Dv<>P" * 8, sorted({r.case.group for r in members}), strict=False):
        sweep = group.split("/", 1)[1]
        own = [r for r in members if r.case.group == group]
        x = [_place(r, sweep) for r in own]
        look = style.look(color=MODEL, markersize=4, linewidth=0.8, label=_title(sweep))
        speed.plot(x, 1e3 * np.array([r.error_mps for r in own]), f"{marker}-", **look)
        wave.plot(x, 1e3 * np.array([r.within_cycle_rms_m for r in own]), f"{marker}-", **look)
    limit = 1e3 * SPEED_LIMITS_MPS[kind]
    for axes, edge in ((speed, -limit), (speed, limit), (wave, 1e3 * WITHIN_CYCLE_LIMIT_M)):
        axes.axhline(edge, color="black", linestyle=":", linewidth=1.0)
    wave.set_ylim(bottom=0.0)
    name, along = "frequency" if kind.endswith("freq") else "phase offset", _axis_label(kind.split("/")[1])
    speed.set(title=f"Speed over {name}: model minus authors", xlabel=along, ylabel="speed difference (mm/s)")
    wave.set(title=f"Within a cycle over {name}: RMS difference", xlabel=along, ylabel="RMS difference (mm)")
    wave.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _in(result: Result, kind: str) -> bool:
    return result.case.group.startswith(kind + "/")


def _waves(validation: Validation) -> Section:
    by_rms = sorted(validation.simulations, key=lambda r: r.within_cycle_rms_m)
    picked = {"best": by_rms[0], "median": by_rms[len(by_rms) // 2], "worst": by_rms[-1]}
    with _panels(3, 3.0) as (figure, panels):
        for axes, (name, result) in zip(panels, picked.items(), strict=True):
            gait = result.case.gait
            cycles = result.time_s * gait.frequency_hz
            axes.plot(cycles, 1e3 * result.reference_wave_m, "--", color=AUTHORS, label=AUTHORS_LABEL)
            axes.plot(cycles, 1e3 * result.model_wave_m, color=MODEL, label="model")
            case = f"{gait.egain_percent:g} %, {gait.frequency_hz:g} Hz, phase {gait.phase:g}"
            axes.set_title(f"{name}: {case}\nRMS {_mm(result.within_cycle_rms_m)} mm")
            axes.set(xlabel="time (cycles)", ylabel="forward minus mean speed (mm)")
    caption = (
        f"Forward position over cycles {FIRST_CYCLE} to {CYCLES} without the mean speed of each: best, "
        "median and worst case."
    )
    return Section("Within a cycle", images=[(figure, caption)])


def _experiments(validation: Validation, noise: SpeedNoise) -> Section:
    swims = validation.experiments
    ours, authors = validation.speed_rmse_mps, validation.authors_rmse_mps
    table = Table.of(
        [group for group in ours if group.startswith(EXPERIMENTS)],
        {
            "group": lambda group: group,
            "swims": lambda group: sum(r.case.group == group or _in(r, group) for r in swims),
            "model RMSE, mm/s": lambda group: _mm(ours[group]),
            "authors' RMSE, mm/s": lambda group: _mm(authors.get(group)),
            "noise floor (neighbours), mm/s": lambda group: _mm(noise.neighbours.get(group)),
            "within a swim, mm/s": lambda group: _mm(noise.within_swim.get(group)),
        },
    )
    repeats = (
        f"Swims of a gait that was measured again ({noise.repeated}) differ by {_mm(noise.repeats)} mm/s."
        if noise.repeated
        else "No gait was measured twice."
    )
    text = (
        "The noise floor is the standard deviation of a measured speed. It comes from second differences of "
        f"{noise.triples.get(EXPERIMENTS, 0)} triples of neighbours along a sweep, and is too high where the "
        "true speeds bend. Within a swim, it is the scatter between whole cycles over the root of their "
        f"number, without the difference between swims. {repeats} An exact model would still have the noise "
        "floor as its RMSE.",
    )
    caption = (
        "Simulated over measured speed. They agree on the diagonal; the band around it is one noise floor."
    )
    return Section("Against measurement", text, table, [(_scatter(swims, noise), caption)])


def _scatter(swims: Sequence[ExperimentResult], noise: SpeedNoise) -> Figure:
    with style.new_figure(6.2, 5.4) as figure:
        axes = figure.subplots()
        measured = np.array([1e3 * r.reference.speed_mps for r in swims])
        model = [1e3 * r.model_mps for r in swims]
        top = 1.1 * max(measured.max(), max(model))
        line, floor = np.array([0.0, top]), 1e3 * noise.neighbours.get(EXPERIMENTS, 0.0)
        look = style.look(color=style.MEASURED)
        axes.fill_between(line, line - floor, line + floor, alpha=0.2, label="noise floor", **look)
        axes.plot(line, line, linewidth=1.0, label="measured", **look)
        theirs = [(r.reference.speed_mps, r.authors_mps) for r in swims if r.authors_mps]
        if theirs:
            axes.plot(*(1e3 * np.array(theirs).T), "s", color=AUTHORS, markersize=5, label=AUTHORS_LABEL)
        axes.plot(measured, model, "o", color=MODEL, markersize=4, label="model")
        axes.set(xlim=(0.0, top), ylim=(0.0, top), aspect="equal", title="Measured swims")
        axes.set(xlabel="measured speed (mm/s)", ylabel="simulated speed (mm/s)")
        axes.legend(loc="upper left")
    return figure


def _cases(validation: Validation) -> Section:
    every: Sequence[Result] = (*validation.simulations, *validation.experiments)
    table = Table.of(
        every,
        {
            "case": lambda r: r.case.name,
            "reference, mm/s": lambda r: _mm(r.reference.speed_mps),
            "model, mm/s": lambda r: _mm(r.model_mps),
            "difference, mm/s": lambda r: f"{1e3 * r.error_mps:+.2f}",
            "within a cycle, mm": lambda r: (
                _mm(r.within_cycle_rms_m) if isinstance(r, SimulationResult) else "-"
            ),
            "limb profile": lambda r: r.profile,
        },
    )
    return Section("Every case", table=table)
