"""Pictures and report of ``frogkick sweep``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from frogkick.core.arrays import Float64
from frogkick.core.files import write_bytes
from frogkick.effects.swims import Gait
from frogkick.report import style
from frogkick.report.page import Section, Table, left_out, write_page
from frogkick.validation import sweep as sweeps
from frogkick.validation.sweep import PAPER_PHASE, PHASE_TIE_MPS, Design, Point, Sweep, Verdict

_TOP = 10
_MISSING = "#ececec"


def write_sweep_report(out: Path, sweep: Sweep, verdicts: Sequence[Verdict]) -> list[Path]:
    """Write ``sweep.png``, ``phases.png`` and ``sweep.html`` into a folder, with the same bytes each time."""
    designs, phases = style.png_of(_designs(sweep, verdicts)), style.png_of(_phases(sweep))
    files = [out / "sweep.png", out / "phases.png", out / "sweep.html"]
    for file, picture in zip(files, (designs, phases), strict=False):
        write_bytes(file, picture)
    plan = sweep.plan
    lead = (
        f"{len(plan.designs)} designs (EGaIn fraction and frequency) of the robot {plan.robot.title}, each "
        f"at {len(plan.phases)} phase offsets: {plan.gaits} gaits, simulated from rest. "
        f"{sweeps.energy_model(plan.robot)}"
    )
    sections = [
        Section(
            "Designs",
            (
                "Each design is shown at the phase nearest to half a cycle among those within "
                f"{1e3 * PHASE_TIE_MPS:g} mm/s of its fastest, because smaller differences are below the "
                "accuracy of the model. A star marks a limb profile interpolated between measured ones.",
            ),
            images=[(designs, "Speed and cost of transport; boxes mark the designs that the paper names.")],
        ),
        _ranking("Fastest", sweeps.rank_designs(sweep, sweeps.by_speed)),
    ]
    if efficient := sweeps.rank_designs(sweep, sweeps.by_cost):
        sections.append(_ranking("Most efficient", efficient))
    if verdicts:
        sections.append(_paper(verdicts))
    caption = (
        "Every gait, with one column of pictures for each EGaIn fraction. The last row shows the effect of "
        "the phase alone: speed minus the mean over the phases of that design."
    )
    sections.append(Section("Phases", images=[(phases, caption)]))
    rows = [(skipped.case, skipped.reason) for skipped in plan.skipped]
    rows += [(_named(point.gait, point.gait.phase), point.failure) for point in sweep.points if point.failure]
    sections.append(left_out(rows, "design"))
    write_page(files[2], "frogkick: sweep of designs and gaits", lead, sections)
    return files


def _ranking(title: str, ranked: Sequence[Point]) -> Section:
    table = Table.of(
        enumerate(ranked[:_TOP], start=1),
        {
            "rank": lambda row: row[0],
            "EGaIn, %": lambda row: f"{row[1].gait.egain_percent:g}",
            "frequency, Hz": lambda row: f"{row[1].gait.frequency_hz:g}",
            "phase": lambda row: f"{row[1].gait.phase:g}",
            "speed, mm/s": lambda row: f"{1e3 * row[1].speed_mps:.2f}",
            "cost of transport": lambda row: f"{row[1].cost_of_transport:.1f}",
        },
    )
    return Section(title, table=table)


def _paper(verdicts: Sequence[Verdict]) -> Section:
    rows = []
    for verdict in verdicts:
        winner, ours = verdict.winner, verdict.ours
        better = 1e3 * (verdict.best.speed_mps - ours.speed_mps)
        if winner.speed_mps is not None:
            what = ("fastest", f"{1e3 * winner.speed_mps:.0f} mm/s", f"{1e3 * ours.speed_mps:.1f} mm/s")
        else:
            what = ("most efficient", f"{winner.cost_of_transport:g}", f"{ours.cost_of_transport:.1f}")
        ranks = f"{verdict.rank} / {verdict.rank_all_phases}"
        best = f"{verdict.best.gait.phase:g} (+{better:.2f} mm/s)"
        rows.append((_named(winner.design), *what, ranks, best, verdict.why))
    header = (
        "design", "in the paper", "value in the paper", "value here",
        f"rank at phase {PAPER_PHASE:g} / at any phase", "best phase", "why the figures differ",
    )  # fmt: skip
    agreeing = sum(verdict.agrees for verdict in verdicts)
    text = (
        f"{agreeing} of {len(verdicts)} designs that the paper names are among the first two of their "
        f"ranking here. The paper compares at phase {PAPER_PHASE:g}.",
    )
    return Section("The paper's winners", text, Table(header, rows))


def _named(design: Design | Gait, phase: float | None = None) -> str:
    name = f"{design.egain_percent:g} %, {design.frequency_hz:g} Hz"
    return name if phase is None else f"{name}, phase {phase:g}"


def _fractions(sweep: Sweep) -> list[float]:
    return sorted({design.egain_percent for design in sweep.plan.designs})


def _draw(axes: Axes, values: Float64, colours: str, shown: Float64) -> None:
    """Draw cells of some values, coloured by the range of all those that are shown in this colour map."""
    axes.set_facecolor(_MISSING)
    axes.grid(False)
    if not np.isfinite(shown).any():
        return
    low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
    image = axes.imshow(values, origin="lower", aspect="auto", cmap=colours, vmin=low, vmax=high)
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(image, ax=axes, pad=0.01)


def _ticks(places: Sequence[float], most: int = 12) -> tuple[list[int], list[str]]:
    """Return the labels along an axis of cells, thinned out if there are too many."""
    step = max(1, math.ceil(len(places) / most))
    return list(range(0, len(places), step)), [f"{value:g}" for value in places[::step]]


def _designs(sweep: Sweep, verdicts: Sequence[Verdict]) -> Figure:
    frequencies = sorted({design.frequency_hz for design in sweep.plan.designs})
    fractions = _fractions(sweep)
    shape = (len(fractions), len(frequencies))
    speed, cost = np.full(shape, np.nan), np.full(shape, np.nan)
    for point in sweeps.rank_designs(sweep, sweeps.by_speed):
        cell = fractions.index(point.gait.egain_percent), frequencies.index(point.gait.frequency_hz)
        speed[cell] = 1e3 * point.speed_mps
        cost[cell] = point.cost_of_transport if math.isfinite(point.cost_of_transport) else np.nan
    width, height = max(6.0, 2.0 + 0.48 * len(frequencies)), 2 * (1.2 + 0.42 * len(fractions))
    with style.new_figure(width, height) as figure:
        panels = figure.subplots(2, 1)
        for axes, values, title, colours in (
            (panels[0], speed, "Speed (mm/s)", "viridis"),
            (panels[1], cost, "Cost of transport (electrical energy / weight / distance)", "viridis_r"),
        ):
            _draw(axes, values, colours, values)
            _write_cells(axes, values, sweep, frequencies, fractions)
            axes.set_title(title)
            axes.set_xticks(range(len(frequencies)), [f"{hz:g}" for hz in frequencies])
            axes.set_yticks(range(len(fractions)), [f"{egain:g}" for egain in fractions])
            axes.set(xlabel="frequency (Hz)", ylabel="EGaIn (% by volume)")
        for verdict in verdicts:
            design = verdict.winner.design
            corner = frequencies.index(design.frequency_hz) - 0.5, fractions.index(design.egain_percent) - 0.5
            panel = panels[0] if verdict.winner.speed_mps is not None else panels[1]
            panel.add_patch(Rectangle(corner, 1.0, 1.0, fill=False, edgecolor=style.ALARM, linewidth=2.5))
    return figure


def _write_cells(
    axes: Axes, values: Float64, sweep: Sweep, frequencies: Sequence[float], fractions: Sequence[float]
) -> None:
    """The value in each cell, in black or white, whichever can be read on its colour."""
    low, high = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
    bright_high = bool(axes.images) and axes.images[0].get_cmap().name == "viridis"
    for (row, column), value in np.ndenumerate(values):
        if not math.isfinite(value):
            continue
        share = (value - low) / (high - low) if high > low else 1.0
        bright = share > 0.6 if bright_high else share < 0.4
        star = "*" if Design(fractions[row], frequencies[column]) in sweep.plan.interpolated else ""
        colour = "black" if bright else "white"
        text = f"{value:.1f}" if value < 100.0 else f"{value:.0f}"
        axes.text(column, row, text + star, ha="center", va="center", fontsize=8, color=colour)


def _phases(sweep: Sweep) -> Figure:
    fractions, phases = _fractions(sweep), sweep.plan.phases
    tables: dict[float, tuple[list[float], Float64, Float64]] = {}
    for fraction in fractions:
        own = [design for design in sweep.plan.designs if design.egain_percent == fraction]
        speed = np.full((len(phases), len(own)), np.nan)
        cost = np.full((len(phases), len(own)), np.nan)
        for column, design in enumerate(own):
            for point in sweep.of_design(design):
                row = phases.index(point.gait.phase)
                speed[row, column] = 1e3 * point.speed_mps
                cost[row, column] = point.cost_of_transport
        cost[~np.isfinite(cost)] = np.nan
        tables[fraction] = [design.frequency_hz for design in own], speed, cost
    # A masked mean, as that of an array warns of a column of NaN alone.
    turns = {
        fraction: speed - np.ma.masked_invalid(speed).mean(axis=0, keepdims=True).filled(0.0)
        for fraction, (_, speed, _) in tables.items()
    }
    speeds = np.concatenate([speed.ravel() for _, speed, _ in tables.values()])
    costs = np.concatenate([cost.ravel() for _, _, cost in tables.values()])
    turn = float(np.nanmax([np.nanmax(np.abs(t), initial=0.0) for t in turns.values()])) or 1.0
    with style.new_figure(1.0 + 2.7 * len(fractions), 8.4) as figure:
        panels = figure.subplots(3, len(fractions), squeeze=False)
        for column, (fraction, (frequencies, speed, cost)) in enumerate(tables.items()):
            rows = (
                (speed, "speed (mm/s)", "viridis", speeds),
                (cost, "cost of transport", "viridis_r", costs),
                (turns[fraction], "phase alone (mm/s)", "RdBu_r", np.array([-turn, turn])),
            )
            for axes, (values, title, colours, shown) in zip(panels[:, column], rows, strict=True):
                _draw(axes, values, colours, shown)
                axes.set_title(f"{fraction:g} %: {title}")
                axes.set_xticks(*_ticks(frequencies, 6))
                axes.set_yticks(*_ticks(phases))
                axes.set(xlabel="frequency (Hz)", ylabel="phase offset")
    return figure
