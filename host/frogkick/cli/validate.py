"""``frogkick validate``: the model against the paper's simulations and measured swims."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show
from frogkick.files import require_writable
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.study.measured import Skipped
    from frogkick.study.noise import Noise
    from frogkick.study.validate import ExperimentResult, Requirement, SimulationResult, Validation

_NOISE_METHOD = (
    "standard deviation of a measured speed from second differences (a - 2 b + c) / sqrt(6) of three evenly "
    "spaced neighbours along a sweep; too high where the true speeds bend"
)


def _simulation_row(result: SimulationResult) -> dict[str, Any]:
    gait = result.case.gait
    return {
        "case": result.case.name,
        "group": result.case.group,
        "egain_percent": gait.egain_percent,
        "frequency_hz": gait.frequency_hz,
        "phase": gait.phase,
        "reference_mps": result.reference_mps,
        "model_mps": result.model_mps,
        "error_mps": result.error_mps,
        "within_cycle_rms_mm": 1e3 * result.within_cycle_rms_m,
        "profile": result.profile,
    }


def _experiment_row(result: ExperimentResult) -> dict[str, Any]:
    gait = result.case.gait
    return {
        "case": result.case.name,
        "group": result.case.group,
        "egain_percent": gait.egain_percent,
        "frequency_hz": gait.frequency_hz,
        "phase": gait.phase,
        "reference_mps": result.reference.speed_mps,
        "reference_sd_mps": result.reference.sd_mps,
        "cycles": result.reference.cycles,
        "tabulated_mps": result.tabulated_mps,
        "model_mps": result.model_mps,
        "error_mps": result.error_mps,
        "authors_mps": result.authors_mps,
        "profile": result.profile,
    }


def _skipped_row(skipped: Skipped) -> dict[str, str]:
    return {"case": skipped.case, "reason": skipped.reason}


def _requirement_row(requirement: Requirement) -> dict[str, Any]:
    return {
        "what": requirement.what,
        "group": requirement.group,
        "limit": requirement.limit,
        "value": requirement.value,
        "held": requirement.held,
    }


def _profiles_used(validation: Validation) -> str:
    found = len(validation.profiles.measured)
    if found:
        return f"{found} fitted to the files in profile/"
    return f"cached coefficients of robot {validation.robot.id}: the data has no profile/"


def _result(validation: Validation, noise: Noise) -> dict[str, Any]:
    from frogkick.study.validate import (
        authors_rmse_mps,
        requirements,
        single_groups_above,
        speed_rmse_mps,
        within_cycle_rms_m,
    )

    return {
        "robot": validation.robot.id,
        "profiles": _profiles_used(validation),
        "rmse_mps": speed_rmse_mps(validation),
        "within_cycle_rms_mm": {g: 1e3 * rms for g, rms in within_cycle_rms_m(validation).items()},
        "requirements": [_requirement_row(r) for r in requirements(validation)],
        "groups_above_limit": [_requirement_row(r) for r in single_groups_above(validation)],
        "authors_rmse_mps": authors_rmse_mps(validation),
        "noise_floor_mps": noise.neighbours,
        "noise": {
            "method": _NOISE_METHOD,
            "second_differences": noise.triples,
            "repeats_mps": noise.repeats,
            "repeats": noise.repeated,
            "within_swim_mps": noise.within_swim,
        },
        "simulations": [_simulation_row(r) for r in validation.simulations],
        "experiments": [_experiment_row(r) for r in validation.experiments],
        "skipped": [_skipped_row(s) for s in validation.skipped],
    }


def _text(validation: Validation, noise: Noise) -> str:
    from frogkick.study.measured import EXPERIMENTS
    from frogkick.study.validate import (
        authors_rmse_mps,
        requirements,
        single_groups_above,
        speed_rmse_mps,
        within_cycle_rms_m,
    )

    shape, authors = within_cycle_rms_m(validation), authors_rmse_mps(validation)
    lines = [f"profiles: {_profiles_used(validation)}"]
    for group, rmse in speed_rmse_mps(validation).items():
        line = f"{group}: speed RMSE {1e3 * rmse:.2f} mm/s"
        if group in shape:
            line += f", within a cycle {1e3 * shape[group]:.2f} mm RMS"
        if group in authors:
            line += f"; the authors' simulation {1e3 * authors[group]:.2f}"
        if group in noise.neighbours:
            line += f", noise floor {1e3 * noise.neighbours[group]:.2f}"
        lines.append(line)
    for asked in (*requirements(validation), *single_groups_above(validation)):
        verdict = "held" if asked.held else "MISSED"
        lines.append(
            f"limit {verdict}: {asked.what} of {asked.group} {asked.value:.3g}, limit {asked.limit:.3g}"
        )
    if any(group.startswith(EXPERIMENTS) for group in noise.neighbours):
        lines.append(f"noise floor: {_NOISE_METHOD}")
    lines += [f"skipped {skipped.case}: {skipped.reason}" for skipped in validation.skipped]
    return "\n".join(lines)


def validate(
    data_dir: Annotated[Path, typer.Argument(help="The paper's data: sim/, exp/, profile/.")],
    robot: Annotated[str, typer.Option(help="TOML file or built-in name.")] = "frog2022",
    report: Annotated[Path | None, typer.Option(help="HTML report to write.")] = None,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0 = one for each core.")] = 0,
    check: Annotated[bool, typer.Option(help="Exit 1 where a limit is missed.")] = False,
    json: JsonOption = False,
) -> None:
    """Compare the model with every simulation and measured swim of a data folder.

    One parameter set for all; limb profiles come from the folder's own files where it has them.
    """
    from frogkick.report.validate_page import write_validation_report
    from frogkick.robot import load_robot
    from frogkick.study.noise import noise_of
    from frogkick.study.validate import requirements
    from frogkick.study.validate import validate as run_validation

    require_writable(report)
    began = time.perf_counter()
    with progress_bar("validate: gaits") as progress:
        validation = run_validation(load_robot(robot), data_dir, workers or os.cpu_count() or 1, progress)
    noise = noise_of(validation.experiments)
    result = _result(validation, noise)
    if report is not None:
        write_validation_report(report, validation, noise)
        result["report"] = str(report)
    result["wall_s"] = round(time.perf_counter() - began, 3)
    show(result, json, _text(validation, noise))
    if check and not all(requirement.held for requirement in requirements(validation)):
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(validate)
