"""The demo's report: what the ring gave, path by path."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from frogkick.report.page import Section, Table, write_page
from frogkick.report.run_figure import run_figure
from frogkick.report.style import figure_uri
from frogkick.study.ring import Ring, RingRun
from frogkick_codegen.firmware import FLASH_BYTES, RAM_BYTES


def write_ring_report(target: Path, ring: Ring) -> None:
    """Write the report of ``go_round`` as one HTML file."""
    missed = ring.missed
    lead = (
        f"A simulated robot, {ring.robot.title}, followed three paths with the planner running on a virtual "
        f"nRF52832. Mean distance to the path {1e3 * ring.mean_distance_m:.1f} mm. The pool's physics is the "
        "rod simulation, not the table: the table's prediction one period ahead missed by "
        f"{1e3 * float(missed['position_rmse_m']):.1f} mm and "
        f"{np.rad2deg(float(missed['heading_rmse_rad'])):.1f} degrees (RMSE, {missed['periods']} periods)."
    )
    sections = [_paths(ring), *(_one_path(run) for run in ring.runs), _chip(ring), _how(ring)]
    write_page(target, "frogkick: once round the ring", lead, sections)


def _paths(ring: Ring) -> Section:
    rows = [
        (
            run.log.path.name if run.log.path else "",
            f"{1e3 * run.tracking.mean_distance_m:.1f}",
            f"{1e3 * run.tracking.p95_distance_m:.1f}",
            f"{1e3 * run.tracking.progress_mps:.1f}",
            "yes" if run.tracking.completed else f"no ({run.log.notes})",
            str(run.tracking.decisions),
            f"{1e3 * run.missed.position_rmse_m:.1f} / {np.rad2deg(run.missed.heading_rmse_rad):.1f}",
            str(run.mismatches),
            str(run.tracking.limit_violations),
        )
        for run in ring.runs
    ]
    header = (
        "path",
        "mean distance, mm",
        "95th percentile, mm",
        "progress, mm/s",
        "completed",
        "decisions",
        "prediction missed, mm / deg",
        "chip against Python twin, mismatches",
        "limits broken",
    )
    return Section("The three paths", table=Table(header, rows))


def _one_path(run: RingRun) -> Section:
    name = run.log.path.name if run.log.path else "path"
    figure = run_figure(run.log, f"{name}: {run.tracking.decisions} decisions on the chip")
    caption = (
        "Left: the true track over the desired path, with the noisy fixes that the robot saw. Right: "
        "distance to the path; the actions chosen; the error of the robot's own estimate; the error of the "
        "prediction."
    )
    return Section(name.capitalize(), images=[(figure_uri(figure), caption)])


def _chip(ring: Ring) -> Section:
    chip = ring.chip
    rows = [
        ("flash", f"{ring.flash_bytes:,} bytes, {100 * ring.flash_bytes / FLASH_BYTES:.1f} % of the chip"),
        ("of it the table", f"{len(ring.tables.image):,} bytes, {len(ring.tables.states)} states"),
        ("RAM with reserved stack", f"{ring.ram_bytes:,} bytes, {100 * ring.ram_bytes / RAM_BYTES:.1f} %"),
        ("deepest stack seen", f"{chip.stack_bytes:,} bytes"),
        *(
            (f"one plan at depth {depth}", f"{ms:.2f} ms ({chip.plan_cycles[depth]:,} cycles at 64 MHz)")
            for depth, ms in chip.plan_ms.items()
        ),
        (
            "computing time of a decision, 99th percentile",
            f"{max(run.tracking.plan_ms_p99 for run in ring.runs):.2f} ms",
        ),
        ("firmware trial", f"{sum(chip.checks.values())} of {len(chip.checks)} checks held"),
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
