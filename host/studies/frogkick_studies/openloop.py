"""Effects fitted to some groups of measured open-loop swims, tested on the held-out groups (``fits.py``)."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.core.errors import InputError
from frogkick.core.files import write_text
from frogkick.core.progress import shown
from frogkick.report import style
from frogkick.robot import Robot, load_robot
from frogkick.robot.toml_text import to_toml
from frogkick_studies import StudyResult
from frogkick_studies.configs import Openloop
from frogkick_studies.fits import OpenLoop, Predicted, Split, open_loop, rmse_by_group
from frogkick_studies.steady import gain_of, with_effects

_MARKS = "os^Dv<>P"


@dataclass(frozen=True, eq=False)
class OpenLoopStudy(StudyResult):
    """Effects fitted to some groups of measured swims, and their predictions of the others.

    Attributes:
        robots: TOML file of the nominal robot with the fitted effects, for each split; empty: not written.
    """

    nominal: Robot
    found: OpenLoop
    robots: Sequence[Path]

    def plot(self) -> Figure:
        return openloop_figure(self.found)

    def as_json(self) -> dict[str, Any]:
        validation, splits = self.found.validation, self.found.splits
        group = "experiments"
        kinds = dict.fromkeys(split.kind for split in splits)
        pooled = {kind: [row for s in splits if s.kind == kind for row in s.test] for kind in kinds}
        return {
            "robot": validation.robot.id,
            "nominal": {
                "rmse_mps": {g: v for g, v in validation.speed_rmse_mps.items() if g.startswith(group)},
                "authors_rmse_mps": validation.authors_rmse_mps,
            },
            "noise_floor_mps": self.found.noise.neighbours,
            "test": _errors(pooled[next(iter(kinds))]),
            "test_by_kind": {kind: _errors(rows) for kind, rows in pooled.items()},
            "splits": [
                _split_row(split) | ({"robot": str(self.robots[place])} if self.robots else {})
                for place, split in enumerate(splits)
            ],
            "skipped": [
                asdict(skipped)
                for skipped in validation.skipped
                if skipped.case.startswith(("exp", "profile"))
            ],
        }

    def text(self, values: dict[str, Any]) -> str:
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
                    f"nominal {p['nominal']:g})"
                )
            if not split["parameters"]:
                lines.append(
                    "  no effect improves the prediction of held-out groups beyond the sampling error: the "
                    "nominal model is kept"
                )
            for turn in split["tried"]:
                gains = ", ".join(f"by {way} {_gain(g)}" for way, g in turn["mse_gain_m2_per_s2"].items())
                lines.append(
                    f"  tried {' '.join(turn['parameters'])}: mean square error of held-out groups falls "
                    f"{gains} mm^2/s^2: {'taken' if turn['taken'] else 'not taken'}"
                )
            left = split["left_out_rmse_mps"]
            lines.append(
                f"  left-out swims: nominal {_mm(left['nominal'])}, with effects {_mm(left['effects'])}"
            )
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
                f"{_mm(test['rmse_mps'])} mm/s over {test['swims']} held-out swims"
            )
        lines += [f"skipped {skipped['case']}: {skipped['reason']}" for skipped in values["skipped"]]
        return "\n".join(lines)


def _split_row(split: Split) -> dict[str, Any]:
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
            for turn in split.fitted.iterations
        ],
        "assumed_sd_mps": split.fitted.sd_mps,
        "train": _errors(split.train),
        "test": _errors(split.test),
        "cases": [_case(row, name) for name in ("train", "test") for row in getattr(split, name)],
    }


def _errors(rows: Sequence[Predicted]) -> dict[str, Any]:
    nominal, effects = rmse_by_group(rows, nominal=True), rmse_by_group(rows)
    swum = [row for row in rows if math.isfinite(row.error_mps)]
    errors = [row.error_mps for row in swum]
    gain = gain_of(np.array([row.experiment.error_mps for row in swum]), np.array(errors))
    return {
        "swims": len(rows),
        "failed": sum(not math.isfinite(row.speed_mps) for row in rows),
        "nominal_rmse_mps": nominal["all"],
        "rmse_mps": effects["all"],
        "mse_gain_m2_per_s2": {"value": gain[0], "interval": list(gain[1:])},
        "nominal_mean_error_mps": sum(row.experiment.error_mps for row in rows) / max(len(rows), 1),
        "mean_error_mps": sum(errors) / len(errors) if errors else math.nan,
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
        **asdict(gait),
        "measured_mps": experiment.reference.speed_mps,
        "nominal_mps": experiment.model_mps,
        "predicted_mps": row.speed_mps,
        "profile": experiment.profile,
    }


def _mm(value: float) -> str:
    return f"{1e3 * value:.2f}"


def _gain(gain: dict[str, Any]) -> str:
    value, low, high = (1e6 * each for each in (gain["value"], *gain["interval"]))
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"


def run(config: Openloop) -> OpenLoopStudy:
    """Fit effects to some groups of measured swims, and predict the speeds of those left out."""
    data, train, test = config.data_dir, config.train, config.test
    if (train is None) != (test is None) or (train is None) == (data is None):
        raise InputError("DATA_DIR, --train, --test: give DATA_DIR, or both --train DIR and --test DIR")
    folder = data if train is None else train
    assert folder is not None
    nominal, cores = load_robot(config.robot), config.processes
    fractions = config.train_egain or (), config.test_egain or ()
    with shown(True, "openloop: rounds of fits") as tell:
        found = open_loop(nominal, folder, *fractions, cores, tell, test)
    return OpenLoopStudy(
        nominal, found, [] if config.out is None else save_robots(nominal, found, config.out)
    )


def save_robots(nominal: Robot, found: OpenLoop, folder: Path) -> list[Path]:
    """Write for each split the nominal robot with the fitted effects (TOML), and return the files."""
    files = []
    for split in found.splits:
        name = re.sub(r"[^a-z0-9.]+", "-", split.name.lower()).strip("-")
        files.append(folder / f"{nominal.id}-{name}.toml")
        table = tomllib.loads(nominal.toml)
        effects = with_effects(nominal, split.fitted.tables).effects
        if effects:
            table["effect"] = [dict(effect) for effect in effects]
        write_text(files[-1], to_toml(table))
    return files


def openloop_figure(found: OpenLoop) -> Figure:
    """Draw a row for each fit: its test swims, its training swims, and its errors over frequency."""
    rows = len(found.splits)
    with style.new_figure(13.0, 4.4 * rows + 0.5) as figure:
        panels = figure.subplots(rows, 3, squeeze=False)
        every = [row for split in found.splits for row in (*split.train, *split.test)]
        speeds = [1e3 * r.experiment.reference.speed_mps for r in every]
        speeds += [1e3 * r.experiment.model_mps for r in every] + [1e3 * r.speed_mps for r in every]
        low, high = min(0.0, float(np.nanmin(speeds))), 1.05 * float(np.nanmax(speeds))
        fractions = sorted({row.experiment.case.gait.egain_percent for row in every})
        marks = {percent: _MARKS[place % len(_MARKS)] for place, percent in enumerate(fractions)}
        floor = found.noise.neighbours.get("experiments")
        for (test, train, over), split in zip(panels, found.splits, strict=True):
            _against(test, split.test, marks, (low, high), floor)
            test.set_title(f"Fitted to {split.name}: predicted for others")
            _against(train, split.train, marks, (low, high), floor)
            train.set_title(f"The swims fitted to ({split.name})")
            _over_frequency(over, split.test, marks, floor)
            over.set_title("Error of the predictions over frequency")
    return figure


def _against(
    axes: Axes,
    rows: Sequence[Predicted],
    marks: dict[float, str],
    limits: tuple[float, float],
    floor_mps: float | None,
) -> None:
    axes.plot(limits, limits, color=style.DESIRED, linewidth=0.9)
    if floor_mps is not None:
        wide = 1e3 * floor_mps
        axes.fill_between(
            limits, [limits[0] - wide, limits[1] - wide], [limits[0] + wide, limits[1] + wide],
            color=style.DESIRED, alpha=0.15, linewidth=0.0, label=f"noise floor, {wide:.1f} mm/s",
        )  # fmt: skip
    nominal, effects = (1e3 * rmse_by_group(rows, nominal=plain)["all"] for plain in (True, False))
    for percent, mark in marks.items():
        some = [row for row in rows if row.experiment.case.gait.egain_percent == percent]
        if not some:
            continue
        measured = [1e3 * row.experiment.reference.speed_mps for row in some]
        axes.plot(
            measured, [1e3 * row.experiment.model_mps for row in some], mark, color=style.DESIRED, ms=5,
            fillstyle="none", label=f"nominal, {percent:g} %",
        )  # fmt: skip
        axes.plot(
            measured, [1e3 * row.speed_mps for row in some], mark, color=style.TRUE, ms=5, alpha=0.8,
            label=f"with effects, {percent:g} %",
        )  # fmt: skip
    axes.annotate(
        f"RMSE {nominal:.2f} mm/s nominal,\n{effects:.2f} with effects", (0.03, 0.97),
        xycoords="axes fraction", va="top",
    )  # fmt: skip
    axes.set_xlim(*limits)
    axes.set_ylim(*limits)
    axes.set_aspect("equal")
    axes.set_xlabel("measured speed (mm/s)")
    axes.set_ylabel("speed of the model (mm/s)")
    axes.legend(loc="lower right")


def _over_frequency(
    axes: Axes, rows: Sequence[Predicted], marks: dict[float, str], floor_mps: float | None
) -> None:
    axes.axhline(0.0, color=style.DESIRED, linewidth=0.9)
    if floor_mps is not None:
        axes.axhspan(-1e3 * floor_mps, 1e3 * floor_mps, color=style.DESIRED, alpha=0.15, linewidth=0.0)
    for row in rows:
        gait, nominal, effects = row.experiment.case.gait, row.experiment.error_mps, row.error_mps
        at, mark = gait.frequency_hz, marks[gait.egain_percent]
        axes.plot([at, at], [1e3 * nominal, 1e3 * effects], color=style.DESIRED, linewidth=0.5, alpha=0.6)
        axes.plot(at, 1e3 * nominal, mark, color=style.DESIRED, fillstyle="none", ms=5)
        axes.plot(at, 1e3 * effects, mark, color=style.TRUE, ms=5, alpha=0.8)
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("model minus measured (mm/s)")
