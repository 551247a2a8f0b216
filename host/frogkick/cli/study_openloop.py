"""``frogkick study openloop``: effects fitted to some groups of measured swims, tested on the others."""

from __future__ import annotations

import math
import os
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.errors import InputError
from frogkick.files import require_writable, write_text
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.robot import Robot
    from frogkick.study.openloop import OpenLoop, Predicted, Split

_PercentOption = Annotated[
    list[float] | None,
    typer.Option("--train-egain", help="EGaIn fraction to fit to, per cent; may be repeated."),
]
_TestOption = Annotated[
    list[float] | None,
    typer.Option("--test-egain", help="Fraction to predict; may be repeated; default: all others."),
]


def openloop(
    data_dir: Annotated[
        Path | None, typer.Argument(help="The paper's data: exp/, profile/; or give --train and --test.")
    ] = None,
    train: Annotated[
        Path | None, typer.Option(help="Folder to fit to, all of it, laid out as DATA_DIR.")
    ] = None,
    test: Annotated[Path | None, typer.Option(help="Folder to predict, laid out as DATA_DIR.")] = None,
    train_egain: _PercentOption = None,
    test_egain: _TestOption = None,
    robot: Annotated[str, typer.Option(help="TOML file or built-in name.")] = "frog2022",
    out: Annotated[
        Path | None, typer.Option(help="Folder for openloop.png and a robot's TOML for each fit.")
    ] = None,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0 = one for each core.")] = 0,
    json: JsonOption = False,
) -> None:
    """Fit effects to some groups of measured swims and predict the speeds of those left out.

    Without further options each EGaIn fraction and each band of frequency is left out in turn; --train-egain
    fits to one fraction at a time; --train and --test fit to one folder and predict another. Effects are the
    same for every alloy: alloys differ by their measured limb profiles alone. Effects are taken up only where
    groups of the training swims that are left out of the fit are predicted better by more than the sampling
    error (paired bootstrap over cases); else the nominal model stays.
    """
    from frogkick.report.openloop_figure import openloop_figure
    from frogkick.robot import load_robot
    from frogkick.study.openloop import open_loop

    require_writable(out, folder=True)
    if (train is None) != (test is None) or (train is None) == (data_dir is None):
        raise InputError("give DATA_DIR, or both --train DIR and --test DIR")
    folder = data_dir if train is None else train
    assert folder is not None
    nominal = load_robot(robot)
    with progress_bar("openloop: rounds of fits") as progress:
        cores = workers or os.cpu_count() or 1
        found = open_loop(nominal, folder, train_egain or (), test_egain or (), cores, progress, test)
    values = _result(found)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_picture(openloop_figure(found), out / "openloop.png")
        values["figure"] = str(out / "openloop.png")
        for split, row in zip(found.splits, values["splits"], strict=True):
            target = out / f"{nominal.id}-{re.sub(r'[^a-z0-9.]+', '-', split.name.lower()).strip('-')}.toml"
            _write_robot(target, nominal, split)
            row["robot"] = str(target)
    show(values, json, _text(values))


def _result(found: OpenLoop) -> dict[str, Any]:
    from frogkick.study.validate import authors_rmse_mps, speed_rmse_mps

    validation, splits = found.validation, found.splits
    group = "experiments"
    kinds = dict.fromkeys(split.kind for split in splits)
    pooled = {kind: [row for s in splits if s.kind == kind for row in s.test] for kind in kinds}
    return {
        "robot": validation.robot.id,
        "nominal": {
            "rmse_mps": {g: v for g, v in speed_rmse_mps(validation).items() if g.startswith(group)},
            "authors_rmse_mps": authors_rmse_mps(validation),
        },
        "noise_floor_mps": found.noise.neighbours,
        "test": _errors(pooled[next(iter(kinds))]),
        "test_by_kind": {kind: _errors(rows) for kind, rows in pooled.items()},
        "splits": [_split(split) for split in splits],
        "skipped": [
            {"case": skipped.case, "reason": skipped.reason}
            for skipped in validation.skipped
            if skipped.case.startswith(("exp", "profile"))
        ],
    }


def _split(split: Split) -> dict[str, Any]:
    scores = split.fitted.left_out_mps
    return {
        "kind": split.kind,
        "fitted_to": split.name,
        "train_egain_percent": sorted({row.experiment.case.gait.egain_percent for row in split.train}),
        "test_egain_percent": sorted({row.experiment.case.gait.egain_percent for row in split.test}),
        "parameters": [
            {
                "name": estimate.free.name,
                "value": estimate.value,
                "low": estimate.low,
                "high": estimate.high,
                "nominal": estimate.free.declared.nominal,
                "unit": estimate.free.declared.unit,
            }
            for estimate in split.fitted.estimates
        ],
        "effects": list(split.fitted.tables),
        "left_out_rmse_mps": {"nominal": scores[0], "effects": scores[-1]},
        "tried": [
            {
                "parameters": list(turn.parameters),
                "taken": turn.taken,
                "mse_gain_m2_per_s2": {
                    way: {"value": gain, "interval": [low, high]}
                    for way, (gain, low, high) in turn.gains.items()
                },
            }
            for turn in split.fitted.turns
        ],
        "assumed_sd_mps": split.fitted.sd_mps,
        "train": _errors(split.train),
        "test": _errors(split.test),
        "cases": [_case(row, name) for name in ("train", "test") for row in getattr(split, name)],
    }


def _errors(rows: list[Predicted] | tuple[Predicted, ...]) -> dict[str, Any]:
    import numpy as np

    from frogkick.study.openloop import rmse_by_group
    from frogkick.study.openloop_groups import gain_of

    nominal, effects = rmse_by_group(rows, nominal=True), rmse_by_group(rows)
    mean = [row.error_mps for row in rows if math.isfinite(row.error_mps)]
    swum = [row for row in rows if math.isfinite(row.error_mps)]
    gain = gain_of(
        np.array([row.experiment.error_mps for row in swum]), np.array([row.error_mps for row in swum])
    )
    return {
        "swims": len(rows),
        "failed": sum(not math.isfinite(row.speed_mps) for row in rows),
        "nominal_rmse_mps": nominal["all"],
        "rmse_mps": effects["all"],
        "mse_gain_m2_per_s2": {"value": gain[0], "interval": list(gain[1:])},
        "nominal_mean_error_mps": sum(row.experiment.error_mps for row in rows) / max(len(rows), 1),
        "mean_error_mps": sum(mean) / len(mean) if mean else math.nan,
        "by_group": {
            group: {"nominal_rmse_mps": nominal[group], "rmse_mps": effects.get(group, math.nan)}
            for group in nominal
            if group != "all"
        },
    }


def _case(row: Predicted, use: str) -> dict[str, Any]:
    experiment, gait = row.experiment, row.experiment.case.gait
    return {
        "case": experiment.case.name,
        "use": use,
        "egain_percent": gait.egain_percent,
        "frequency_hz": gait.frequency_hz,
        "phase": gait.phase,
        "measured_mps": experiment.reference.speed_mps,
        "nominal_mps": experiment.model_mps,
        "predicted_mps": row.speed_mps,
        "profile": experiment.profile,
    }


def _write_robot(target: Path, robot: Robot, split: Split) -> None:
    from frogkick.robot.toml_text import to_toml
    from frogkick.study.steady import with_effects

    table = tomllib.loads(robot.toml)
    effects = with_effects(robot, split.fitted.tables).effects
    if effects:
        table["effect"] = [dict(effect) for effect in effects]
    write_text(target, to_toml(table))


def _mm(value: float) -> str:
    return f"{1e3 * value:.2f}"


def _gain(gain: dict[str, Any]) -> str:
    value, low, high = (1e6 * each for each in (gain["value"], *gain["interval"]))
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"


def _text(values: dict[str, Any]) -> str:
    nominal, floor = values["nominal"], values["noise_floor_mps"]
    lines = []
    for group, rmse in nominal["rmse_mps"].items():
        line = f"nominal {group}: speed RMSE {_mm(rmse)} mm/s"
        if group in nominal["authors_rmse_mps"]:
            line += f"; the authors' simulation {_mm(nominal['authors_rmse_mps'][group])}"
        lines.append(line + (f", noise floor {_mm(floor[group])}" if group in floor else ""))
    for split in values["splits"]:
        lines.append(f"fitted to {split['fitted_to']}:")
        for p in split["parameters"]:
            unit = "" if p["unit"] == "1" else f" {p['unit']}"
            lines.append(
                f"  {p['name']} {p['value']:.3g}{unit} ({p['low']:.3g} to {p['high']:.3g}; "
                f"plain model {p['nominal']:g})"
            )
        if not split["parameters"]:
            lines.append(
                "  no effect predicts left-out groups better beyond sampling error: the plain model stays"
            )
        for turn in split["tried"]:
            gains = ", ".join(f"by {way} {_gain(g)}" for way, g in turn["mse_gain_m2_per_s2"].items())
            lines.append(
                f"  tried {' '.join(turn['parameters'])}: mean square error of left-out groups falls {gains} "
                f"mm^2/s^2: {'taken' if turn['taken'] else 'not taken'}"
            )
        left = split["left_out_rmse_mps"]
        lines.append(f"  left-out swims: nominal {_mm(left['nominal'])}, with effects {_mm(left['effects'])}")
        for use in ("train", "test"):
            rows = {"all": split[use], **split[use]["by_group"]}
            for group, row in rows.items():
                lines.append(
                    f"  {use} {group}: nominal {_mm(row['nominal_rmse_mps'])}, with effects "
                    f"{_mm(row['rmse_mps'])} mm/s"
                )
    for kind, test in values["test_by_kind"].items():
        lines.append(
            f"all tests by {kind}: nominal {_mm(test['nominal_rmse_mps'])}, with effects "
            f"{_mm(test['rmse_mps'])} mm/s over {test['swims']} swims not fitted to"
        )
    lines += [f"skipped {skipped['case']}: {skipped['reason']}" for skipped in values["skipped"]]
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(openloop)
