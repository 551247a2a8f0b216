"""The report of ``frogkick validate``: measurement, the model and the authors' simulation compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick.report.page import Section, Table, write_page
from frogkick.report.style import figure_uri
from frogkick.validation.gaits import CYCLES, FIRST_CYCLE
from frogkick.validation.measured import EXPERIMENTS, SIMULATIONS
from frogkick.validation.validate import (
    SPEED_LIMITS_MPS,
    WITHIN_CYCLE_LIMIT_M,
    ExperimentResult,
    Noise,
    Requirement,
    SimulationResult,
    Validation,
    authors_rmse_mps,
    requirements,
    single_groups_above,
    speed_rmse_mps,
)

MODEL = style.PREDICTED
AUTHORS = "#56b4e9"  # of the same palette, for the authors' simulation

Result = SimulationResult | ExperimentResult


def write_validation_report(target: Path, validation: Validation, noise: Noise) -> None:
    """Write the report of ``validate`` as one HTML file."""
    speed = speed_rmse_mps(validation)
    lead = " ".join(
        text
        for text in (
            f"{len(validation.simulations)} of the authors' simulations and {len(validation.experiments)} "
            f"measured swims are compared with the model {validation.robot.title}, with one parameter set "
            "for all.",
            _lead(speed, SIMULATIONS, "Against the authors' simulations"),
            _lead(speed, EXPERIMENTS, "Against measurement"),
        )
        if text
    )
    sections = [_requirements(validation)]
    if validation.simulations:
        sections += [_speeds(validation), _errors(validation), _waves(validation)]
    if validation.experiments:
        sections.append(_experiments(validation, noise))
    sections += [_cases(validation), _skipped(validation)]
    write_page(target, "frogkick: the model against the paper's data", lead, sections)


def _lead(speed: dict[str, float], kind: str, text: str) -> str:
    return f"{text}: speed RMSE {_mm(speed[kind])} mm/s." if kind in speed else ""


def _mm(value_m: float | None, digits: int = 2) -> str:
    return "-" if value_m is None or not math.isfinite(value_m) else f"{1e3 * value_m:.{digits}f}"


def _requirement_row(requirement: Requirement) -> tuple[str, ...]:
    unit = "mm/s" if requirement.what == "speed_rmse_mps" else "mm"
    what = "speed RMSE" if unit == "mm/s" else "RMS within a cycle"
    verdict = "held" if requirement.held else "MISSED"
    return (
        what,
        requirement.group,
        f"{_mm(requirement.value)} {unit}",
        f"{_mm(requirement.limit, 1)} {unit}",
        verdict,
    )


def _requirements(validation: Validation) -> Section:
    rows = [_requirement_row(r) for r in requirements(validation)]
    rows += [_requirement_row(r) for r in single_groups_above(validation)]
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


def _grid(count: int, height: float) -> tuple[Figure, list[Axes]]:
    columns = min(3, count)
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(3.8 * columns, height * rows), layout="constrained")
    axes = list(np.ravel(figure.subplots(rows, columns, squeeze=False)))
    for spare in axes[count:]:
        spare.set_visible(False)
    return figure, axes[:count]


def _legend_outside(figure: Figure, axes: Sequence[Axes]) -> None:
    entries = {
        label: handle
        for panel in axes
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    figure.legend(list(entries.values()), list(entries), loc="outside upper center", ncols=len(entries))


def _speeds(validation: Validation) -> Section:
    sweeps = _sweeps(validation)
    with style.styled():
        figure, panels = _grid(len(sweeps), 2.7)
        for axes, (sweep, results) in zip(panels, sweeps.items(), strict=True):
            _speed_panel(axes, sweep, results)
        _legend_outside(figure, panels)
    caption = (
        f"Speed of every gait. Simulated: mean over cycles {FIRST_CYCLE} to {CYCLES}. Measured: slope of a "
        "line through distance over time; bars are two standard deviations of the mean over the whole cycles "
        "of one swim. They do not include the difference between two swims."
    )
    return Section("Speeds", images=[(figure_uri(figure), caption)])


def _speed_panel(axes: Axes, sweep: str, results: Sequence[Result]) -> None:
    ordered = sorted(results, key=lambda result: _place(result, sweep))
    model = sorted({(_place(r, sweep), 1e3 * r.model_mps) for r in ordered})
    axes.plot(*np.array(model).T, "o-", color=MODEL, markersize=4, label="model", zorder=3)
    authors = [r for r in ordered if isinstance(r, SimulationResult)]
    if authors:
        rows = np.array([(_place(r, sweep), 1e3 * r.reference_mps) for r in authors])
        axes.plot(*rows.T, "s--", color=AUTHORS, markersize=4, label="authors' simulation")
    swims = [r for r in ordered if isinstance(r, ExperimentResult)]
    if swims:
        rows = np.array([(_place(r, sweep), 1e3 * r.reference.speed_mps) for r in swims])
        bars = [2e3 * (r.reference.sd_mps or 0.0) for r in swims]
        axes.errorbar(
            rows[:, 0],
            rows[:, 1],
            yerr=bars,
            fmt="D",
            color=style.MEASURED,
            markersize=4,
            capsize=2,
            label="measured",
        )
    axes.set_ylim(bottom=0.0)
    axes.set_title(_title(sweep))
    axes.set_xlabel(_axis_label(sweep))
    axes.set_ylabel("speed (mm/s)")


def _errors(validation: Validation) -> Section:
    kinds = [kind for kind in SPEED_LIMITS_MPS if any(_in(r, kind) for r in validation.simulations)]
    with style.new_figure(11.0, 3.4 * len(kinds)) as figure:
        for row, kind in zip(
            np.atleast_2d(figure.subplots(len(kinds), 2, squeeze=False)), kinds, strict=True
        ):
            members = [r for r in validation.simulations if _in(r, kind)]
            for marker, group in zip("os^Dv<>P" * 8, sorted({r.case.group for r in members}), strict=False):
                sweep = group.split("/", 1)[1]
                own = [r for r in members if r.case.group == group]
                x = [_place(r, sweep) for r in own]
                for axes, y in zip(
                    row, ([r.error_mps for r in own], [r.within_cycle_rms_m for r in own]), strict=True
                ):
                    line = f"{marker}-"
                    axes.plot(
                        x,
                        1e3 * np.array(y),
                        line,
                        color=MODEL,
                        markersize=4,
                        linewidth=0.8,
                        label=_title(sweep),
                    )
            limit = 1e3 * SPEED_LIMITS_MPS[kind]
            for edge in (-limit, limit):
                row[0].axhline(edge, color="black", linestyle=":", linewidth=1.0)
            row[1].axhline(1e3 * WITHIN_CYCLE_LIMIT_M, color="black", linestyle=":", linewidth=1.0)
            row[1].set_ylim(bottom=0.0)
            name = "frequency" if kind.endswith("freq") else "phase offset"
            row[0].set_title(f"Speed over {name}: model minus authors")
            row[1].set_title(f"Within a cycle over {name}: RMS difference")
            row[0].set_ylabel("speed difference (mm/s)")
            row[1].set_ylabel("RMS difference (mm)")
            for axes in row:
                axes.set_xlabel(_axis_label(kind.split("/")[1]))
            row[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    text = ("Dotted lines are the limits. They hold for the RMS over all cases of a row, not for each case.",)
    caption = "Difference of every simulated case, one marker for each sweep (legend on the right)."
    return Section("Against the authors' simulations", text, images=[(figure_uri(figure), caption)])


def _in(result: Result, kind: str) -> bool:
    return result.case.group.startswith(kind + "/")


def _waves(validation: Validation) -> Section:
    by_rms = sorted(validation.simulations, key=lambda r: r.within_cycle_rms_m)
    picked = {"best": by_rms[0], "median": by_rms[len(by_rms) // 2], "worst": by_rms[-1]}
    with style.styled():
        figure, panels = _grid(3, 3.0)
        for axes, (name, result) in zip(panels, picked.items(), strict=True):
            gait = result.case.gait
            cycles = result.time_s * gait.frequency_hz
            axes.plot(cycles, 1e3 * result.reference_wave_m, "--", color=AUTHORS, label="authors' simulation")
            axes.plot(cycles, 1e3 * result.model_wave_m, color=MODEL, label="model")
            axes.set_title(
                f"{name}: {gait.egain_percent:g} %, {gait.frequency_hz:g} Hz, phase {gait.phase:g}\n"
                f"RMS {_mm(result.within_cycle_rms_m)} mm"
            )
            axes.set_xlabel("time (cycles)")
            axes.set_ylabel("forward minus mean speed (mm)")
        _legend_outside(figure, panels)
    caption = (
        f"Forward position over cycles {FIRST_CYCLE} to {CYCLES} without the mean speed of each: best, "
        "median and worst case."
    )
    return Section("Within a cycle", images=[(figure_uri(figure), caption)])


def _experiments(validation: Validation, noise: Noise) -> Section:
    ours, authors = speed_rmse_mps(validation), authors_rmse_mps(validation)
    rows = [
        (
            group,
            str(sum(r.case.group == group or _in(r, group) for r in validation.experiments)),
            _mm(ours[group]),
            _mm(authors.get(group)),
            _mm(noise.neighbours.get(group)),
            _mm(noise.within_swim.get(group)),
        )
        for group in ours
        if group.startswith(EXPERIMENTS)
    ]
    header = (
        "group",
        "swims",
        "model RMSE, mm/s",
        "authors' RMSE, mm/s",
        "noise floor (neighbours), mm/s",
        "within a swim, mm/s",
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
    return Section(
        "Against measurement",
        text,
        Table(header, rows),
        [(figure_uri(_scatter(validation, noise)), caption)],
    )


def _scatter(validation: Validation, noise: Noise) -> Figure:
    with style.new_figure(6.2, 5.4) as figure:
        axes = figure.subplots()
        measured = np.array([1e3 * r.reference.speed_mps for r in validation.experiments])
        top = 1.1 * max(measured.max(), max(1e3 * r.model_mps for r in validation.experiments))
        line = np.array([0.0, top])
        floor = 1e3 * noise.neighbours.get(EXPERIMENTS, 0.0)
        axes.fill_between(
            line, line - floor, line + floor, color=style.MEASURED, alpha=0.2, label="noise floor"
        )
        axes.plot(line, line, color=style.MEASURED, linewidth=1.0, label="measured")
        theirs = [(r.reference.speed_mps, r.authors_mps) for r in validation.experiments if r.authors_mps]
        if theirs:
            axes.plot(
                *(1e3 * np.array(theirs).T), "s", color=AUTHORS, markersize=5, label="authors' simulation"
            )
        axes.plot(
            measured,
            [1e3 * r.model_mps for r in validation.experiments],
            "o",
            color=MODEL,
            markersize=4,
            label="model",
        )
        axes.set_xlim(0.0, top)
        axes.set_ylim(0.0, top)
        axes.set_aspect("equal")
        axes.set_xlabel("measured speed (mm/s)")
        axes.set_ylabel("simulated speed (mm/s)")
        axes.set_title("Measured swims")
        axes.legend(loc="upper left")
    return figure


def _cases(validation: Validation) -> Section:
    rows = [
        (
            r.case.name,
            _mm(r.reference_mps),
            _mm(r.model_mps),
            f"{1e3 * r.error_mps:+.2f}",
            _mm(r.within_cycle_rms_m),
            r.profile,
        )
        for r in validation.simulations
    ]
    rows += [
        (
            e.case.name,
            _mm(e.reference.speed_mps),
            _mm(e.model_mps),
            f"{1e3 * e.error_mps:+.2f}",
            "-",
            e.profile,
        )
        for e in validation.experiments
    ]
    header = (
        "case",
        "reference, mm/s",
        "model, mm/s",
        "difference, mm/s",
        "within a cycle, mm",
        "limb profile",
    )
    return Section("Every case", table=Table(header, rows))


def _skipped(validation: Validation) -> Section:
    rows = [(skipped.case, skipped.reason) for skipped in validation.skipped]
    if not rows:
        return Section("Left out", ("No case was left out.",))
    return Section("Left out", table=Table(("case", "reason"), rows))
