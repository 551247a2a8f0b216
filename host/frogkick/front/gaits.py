"""Gaits: the model compared with the paper's simulations and measured swims, and a sweep over gaits."""

from __future__ import annotations

import csv
import io
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from frogkick.core.arguments import typed
from frogkick.core.files import require_writable, write_text
from frogkick.core.progress import Progress, shown
from frogkick.report.style import page_of
from frogkick.robot import Robot, load_robot
from frogkick.validation import sweep as sweeps
from frogkick.validation.matched import Matched, matched_without
from frogkick.validation.sweep import PAPER_PHASE, Point, Sweep, Verdict, by_cost, by_speed, point_row
from frogkick.validation.validate import (
    ExperimentResult,
    Requirement,
    Result,
    SpeedNoise,
    Validation,
    noise_of,
)
from frogkick.validation.validate import validate as swim_and_compare

__all__ = ["Point", "Swept", "Validated", "sweep", "validate"]

_NOISE_METHOD = (
    "standard deviation of a measured speed from second differences (a - 2 b + c) / sqrt(6) of three evenly "
    "spaced neighbours along a sweep; too high where the true speeds bend"
)
_TOP = 10


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Validated:
    """The model compared with every simulation and measured swim of a data folder.

    Attributes:
        validation: all cases, and those left out.
        noise: noise of the measured speeds.
        matched: the robot's constants, matched again without each EGaIn fraction; None: not requested.
    """

    validation: Validation
    noise: SpeedNoise
    matched: Matched | None = None

    @property
    def rmse_mps(self) -> dict[str, float]:
        """Group of cases -> root-mean-square error of the model's speeds, m/s."""
        return self.validation.speed_rmse_mps

    @property
    def held(self) -> bool:
        """Whether every limit is held."""
        return all(requirement.held for requirement in self.validation.requirements)

    def report(self, file: Path | str) -> None:
        """Write an HTML page: errors by group, speeds, waves within a cycle, every case.

        Raises:
            InputError: the file cannot be written.
        """
        from frogkick.report.validate_page import write_validation_report

        write_validation_report(Path(file), self.validation, self.noise)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``validate``."""
        validation, noise = self.validation, self.noise
        return {
            "robot": validation.robot.id,
            "profiles": (
                f"{len(measured)} fitted to the files in profile/"
                if (measured := validation.profiles.measured)
                else f"cached coefficients of robot {validation.robot.id}: the data has no profile/"
            ),
            "rmse_mps": self.rmse_mps,
            "within_cycle_rms_mm": _in_mm(validation.within_cycle_rms_m),
            "requirements": [_requirement_row(r) for r in validation.requirements],
            "groups_above_limit": [_requirement_row(r) for r in validation.single_groups_above],
            "left_out": None if self.matched is None else _matched_row(self.matched),
            "authors_rmse_mps": validation.authors_rmse_mps,
            "noise_floor_mps": noise.neighbours,
            "noise": {
                "method": _NOISE_METHOD,
                "second_differences": noise.triples,
                "repeats_mps": noise.repeats,
                "repeats": noise.repeated,
                "within_swim_mps": noise.within_swim,
            },
            "simulations": [
                _row(r, {"within_cycle_rms_mm": 1e3 * r.within_cycle_rms_m}) for r in validation.simulations
            ],
            "experiments": [_row(r, {"authors_mps": r.authors_mps}) for r in validation.experiments],
            "skipped": [asdict(skipped) for skipped in validation.skipped],
        }

    def __repr__(self) -> str:
        found = self.validation
        errors = ", ".join(f"{group} {1e3 * rmse:.2f}" for group, rmse in list(self.rmse_mps.items())[:4])
        return (
            f"Validated({found.robot.id!r}: {len(found.simulations)} simulations, "
            f"{len(found.experiments)} swims; speed RMSE {errors} mm/s)"
        )

    def _repr_html_(self) -> str:
        rows = {group: f"{1e3 * rmse:.2f} mm/s" for group, rmse in self.rmse_mps.items()}
        return page_of(f"Validated {self.validation.robot.id}", rows)


@typed
def validate(
    data_dir: Path | str,
    robot: Robot | str = "frog2022-sim",
    *,
    left_out: bool = False,
    workers: int | None = None,
    progress: Progress = False,
) -> Validated:
    """Compare the model with every simulation and measured swim of a data folder.

    All are compared with one parameter set. Limb profiles come from the folder's own files if it has them.

    Args:
        data_dir: folder of the paper's data, ``sim/``, ``exp/``, ``profile/``.
        robot: the robot, its name or its TOML file.
        left_out: for each EGaIn fraction, match the robot's constants again to all others and measure the
            error on that fraction; this takes minutes.
        workers: number of processes; None: one for each core.
        progress: of the gaits and the fractions: True for a bar, or a function of (done, all).

    Raises:
        InputError: an unknown folder or robot, or an empty folder; with ``left_out`` fewer than two
            fractions.
    """
    described = load_robot(robot)
    processes = workers or os.cpu_count() or 1
    with shown(progress, "validate: gaits") as tell:
        found = swim_and_compare(described, Path(data_dir), processes, tell)
    matched = None
    if left_out:
        with shown(progress, "validate: fractions left out") as tell:
            matched = matched_without(found, processes, tell)
    return Validated(found, noise_of(found.experiments), matched)


def _matched_row(matched: Matched) -> dict[str, Any]:
    return {
        "rmse_mps": dict(matched.rmse_mps),
        "within_cycle_rms_mm": _in_mm(matched.within_cycle_rms_m),
        "parts": [asdict(part) for part in matched.parts],
    }


def _in_mm(rms_m: Mapping[str, float]) -> dict[str, float]:
    return {group: 1e3 * rms for group, rms in rms_m.items()}


def _row(result: Result, more: dict[str, Any]) -> dict[str, Any]:
    row = {"case": result.case.name, "group": result.case.group, **asdict(result.case.gait)}
    row["reference_mps"] = result.reference.speed_mps
    if isinstance(result, ExperimentResult):
        row |= {"reference_sd_mps": result.reference.sd_mps, "cycles": result.reference.cycles}
        row["tabulated_mps"] = result.tabulated_mps
    row |= {"model_mps": result.model_mps, "error_mps": result.error_mps}
    return {**row, **more, "profile": result.profile}


def _requirement_row(requirement: Requirement) -> dict[str, Any]:
    return {**asdict(requirement), "held": requirement.held}


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Swept:
    """Every gait of a robot, simulated and ranked.

    Attributes:
        sweep: the plan and its points.
        verdicts: the paper's winners compared with those here.
    """

    sweep: Sweep
    verdicts: Sequence[Verdict]

    @property
    def points(self) -> tuple[Point, ...]:
        """Speed (m/s) and cost of transport of each gait, or the reason of its failure."""
        return self.sweep.points

    @property
    def fastest(self) -> list[Point]:
        """The designs (EGaIn fraction and frequency), fastest first, each at its listed phase.

        Of the phases that are at most 0.5 mm/s slower than a design's fastest one, the listed phase is the
        one nearest to half a cycle.
        """
        return sweeps.rank_designs(self.sweep, by_speed)

    @property
    def most_efficient(self) -> list[Point]:
        """The designs by cost of transport, lowest first, each at its listed phase (see ``fastest``)."""
        return sweeps.rank_designs(self.sweep, by_cost)

    @property
    def energy_model(self) -> str:
        """A paragraph on what the cost of transport includes."""
        return sweeps.energy_model(self.sweep.plan.robot)

    def save(self, folder: Path | str) -> list[Path]:
        """Write ``sweep.csv``, a page and its pictures into a folder, and return the files.

        Raises:
            InputError: the folder cannot be written to.
        """
        from frogkick.report.sweep_page import write_sweep_report

        out = Path(folder)
        buffer = io.StringIO()
        columns = ["egain_percent", "frequency_hz", "phase", "speed_mps", "cost_of_transport", "failure"]
        writer = csv.DictWriter(buffer, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(point_row(point) for point in self.points)
        write_text(out / "sweep.csv", buffer.getvalue())
        return [out / "sweep.csv", *write_sweep_report(out, self.sweep, self.verdicts)]

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``sweep``."""
        sweep, plan = self.sweep, self.sweep.plan
        result: dict[str, Any] = {
            "robot": plan.robot.id,
            "designs": len(plan.designs),
            "gaits": plan.gaits,
            **_best(sweep),
            "listed_phase": (
                f"nearest to half a cycle of those within {sweeps.PHASE_TIE_MPS:g} m/s of the design's "
                "fastest phase"
            ),
            "fastest_gaits": [point_row(point) for point in sweeps.rank_gaits(sweep, by_speed)[:_TOP]],
            "most_efficient_gaits": [point_row(point) for point in sweeps.rank_gaits(sweep, by_cost)[:_TOP]],
        }
        if PAPER_PHASE in plan.phases:
            result[f"at_phase_{PAPER_PHASE:g}"] = _best(sweep, PAPER_PHASE)
        return {
            **result,
            "paper": [_verdict_row(verdict) for verdict in self.verdicts],
            "energy_model": sweeps.energy_model(plan.robot),
            "interpolated": [asdict(design) for design in sorted(plan.interpolated)],
            "skipped": [asdict(skipped) for skipped in plan.skipped],
            "failures": [point_row(point) for point in sweep.points if point.failure],
        }

    def __repr__(self) -> str:
        plan = self.sweep.plan
        best = ""
        if self.fastest:
            first = self.fastest[0]
            best = (
                f"; fastest {first.gait.egain_percent:g} % EGaIn, {first.gait.frequency_hz:g} Hz, phase "
                f"{first.gait.phase:g}: {1e3 * first.speed_mps:.1f} mm/s"
            )
        return f"Swept({plan.robot.id!r}: {len(plan.designs)} designs, {plan.gaits} gaits{best})"

    def _repr_html_(self) -> str:
        rows = {
            f"{p.gait.egain_percent:g} %, {p.gait.frequency_hz:g} Hz, phase {p.gait.phase:g}": (
                f"{1e3 * p.speed_mps:.1f} mm/s, {p.cost_text}"
            )
            for p in self.fastest[:_TOP]
        }
        return page_of(repr(self), rows)


@typed
def sweep(
    robot: Robot | str = "frog2022",
    *,
    egain_percent: Sequence[float] | None = None,
    frequencies_hz: Sequence[float] | None = None,
    phases: int = 10,
    out: Path | str | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress = False,
) -> Swept:
    """Simulate every EGaIn fraction, frequency and phase offset; rank by speed and by cost of transport.

    Limb profiles between measured ones are interpolated. Designs outside their range are left out and listed.

    Args:
        robot: the robot, its name or its TOML file.
        egain_percent: fractions, %; None: the measured ones.
        frequencies_hz: strokes per second; None: those measured for each fraction.
        phases: number of phase offsets of the rear limbs, evenly spaced from 0.
        out: folder of the results, where an interrupted sweep resumes. None: nothing is kept.
        workers: number of processes; None: one for each core.
        cluster: address of a Dask scheduler to simulate on instead.
        progress: of the gaits: True for a bar, or a function of (done, all).

    Raises:
        InputError: a value out of range, no cluster at the address, or a folder that cannot be written.
        FrogkickError: a worker died, or the cluster failed.
    """
    with ExitStack() as stack:
        if out is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="frogkick-sweep-")))
        else:
            folder = Path(out)
            require_writable(folder, folder=True)
        described = load_robot(robot)
        plan = sweeps.plan_sweep(described, frequencies_hz, phases, egain_percent)
        processes = 1 if cluster else workers or os.cpu_count() or 1
        with shown(progress, "sweep: gaits") as tell:
            found = sweeps.run_sweep(plan, folder, processes, tell, cluster)
    return Swept(found, sweeps.paper_verdicts(found))


def _verdict_row(verdict: Verdict) -> dict[str, Any]:
    winner = verdict.winner
    return {
        "egain_percent": winner.design.egain_percent,
        "frequency_hz": winner.design.frequency_hz,
        "phase": PAPER_PHASE,
        "paper_speed_mps": winner.speed_mps,
        "paper_cost_of_transport": winner.cost_of_transport,
        "speed_mps": verdict.ours.speed_mps,
        "cost_of_transport": verdict.ours.cost_of_transport,
        "mean_speed_24_cycles_mps": verdict.mean_speed_mps,
        "rank_at_that_phase": verdict.rank,
        "rank_at_any_phase": verdict.rank_all_phases,
        "best_phase": verdict.best.gait.phase,
        "gained_there_mps": verdict.best.speed_mps - verdict.ours.speed_mps,
        "agrees": verdict.agrees,
        "why": verdict.why,
    }


def _best(sweep: Sweep, phase: float | None = None) -> dict[str, list[dict[str, Any]]]:
    return {
        "fastest": [point_row(point) for point in sweeps.rank_designs(sweep, by_speed, phase)[:_TOP]],
        "most_efficient": [point_row(point) for point in sweeps.rank_designs(sweep, by_cost, phase)[:_TOP]],
    }
