"""``frogkick study openloop``: effects fitted to some groups of measured swims, tested on the others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.options import RobotFileOption
from frogkick.core.errors import InputError
from frogkick.core.files import require_writable

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
    robot: RobotFileOption = "frog2022",
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
    from frogkick_studies.identification_studies import study_open_loop

    require_writable(out, folder=True)
    if (train is None) != (test is None) or (train is None) == (data_dir is None):
        raise InputError("give DATA_DIR, or both --train DIR and --test DIR")
    folder = data_dir if train is None else train
    assert folder is not None
    found = study_open_loop(
        folder,
        test_dir=test,
        train_egain=train_egain or (),
        test_egain=test_egain or (),
        robot=robot,
        workers=workers or None,
        progress=True,
    )
    values = found.as_json()
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_picture(found.plot(), out / "openloop.png")
        values["figure"] = str(out / "openloop.png")
        for row, file in zip(values["splits"], found.save_robots(out), strict=True):
            row["robot"] = str(file)
    show(values, json, _text(values))


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
