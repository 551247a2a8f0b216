"""``frogkick validate``: compares the model with the paper's simulations and measured swims."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, RobotFileOption, WorkersOption, show
from frogkick.core.files import require_writable


def _text(result: dict[str, Any]) -> str:
    shape, authors, floor = (
        result[key] for key in ("within_cycle_rms_mm", "authors_rmse_mps", "noise_floor_mps")
    )
    lines = [f"profiles: {result['profiles']}"]
    for group, rmse in result["rmse_mps"].items():
        line = f"{group}: speed RMSE {1e3 * rmse:.2f} mm/s"
        if group in shape:
            line += f", within a cycle {shape[group]:.2f} mm RMS"
        if group in authors:
            line += f"; the authors' simulation {1e3 * authors[group]:.2f}"
        if group in floor:
            line += f", noise floor {1e3 * floor[group]:.2f}"
        lines.append(line)
    for asked in (*result["requirements"], *result["groups_above_limit"]):
        verdict = "held" if asked["held"] else "MISSED"
        lines.append(
            f"limit {verdict}: {asked['what']} of {asked['group']} {asked['value']:.3g}, "
            f"limit {asked['limit']:.3g}"
        )
    if result["left_out"]:
        lines += [
            f"{part['egain_percent']:g} % EGaIn, with constants matched only to the others: speed RMSE "
            f"{1e3 * part['left_out_rmse_mps']:.2f} mm/s, on the others {1e3 * part['matched_rmse_mps']:.2f}"
            for part in result["left_out"]["parts"]
        ]
        lines += [
            f"{group}, each fraction left out: speed RMSE {1e3 * rmse:.2f} mm/s, within a cycle "
            f"{result['left_out']['within_cycle_rms_mm'][group]:.2f} mm RMS"
            for group, rmse in result["left_out"]["rmse_mps"].items()
        ]
    if any(group.startswith("experiments") for group in floor):
        lines.append(f"noise floor: {result['noise']['method']}")
    lines += [f"skipped {skipped['case']}: {skipped['reason']}" for skipped in result["skipped"]]
    return "\n".join(lines)


def validate(
    data_dir: Annotated[Path, typer.Argument(help="Folder of the paper's data: sim/, exp/, profile/.")],
    robot: RobotFileOption = "frog2022",
    report: Annotated[Path | None, typer.Option(help="HTML report to write.")] = None,
    left_out: Annotated[
        bool,
        typer.Option(
            "--left-out",
            help="Match the robot's constants again without each EGaIn fraction; this takes minutes.",
        ),
    ] = False,
    workers: WorkersOption = 0,
    check: Annotated[bool, typer.Option(help="Exit with code 1 if a limit is missed.")] = False,
    json: JsonOption = False,
) -> None:
    """Compare the model with every simulation and measured swim of a data folder.

    All are compared with one parameter set. Limb profiles come from the folder's own files if it has them.
    Constants that no paper gives were matched to these simulations. --left-out shows the errors on fractions
    that the constants were not matched to.
    """
    from frogkick.front.gaits import validate as compare

    require_writable(report)
    began = time.perf_counter()
    found = compare(data_dir, robot, left_out=left_out, workers=workers or None, progress=True)
    result = found.as_json()
    if report is not None:
        found.report(report)
        result["report"] = str(report)
    result["wall_s"] = round(time.perf_counter() - began, 3)
    show(result, json, _text(result))
    if check and not found.held:
        raise typer.Exit(1)
