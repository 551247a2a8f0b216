"""Theory about the water, tested on measured swims and recorded runs.

Each hypothesis is a set of effects with values from theory, not from data.

- Swims: the speeds of all gaits are multiplied by one factor, which represents the drag of the frame. It is
  fitted without the group that is predicted: an EGaIn fraction, a band of frequencies, or a series.
- Recorded runs: predictions one period ahead. Nothing is fitted but the process noise of the filter, one of
four.

With ``joint`` all effects of the calibrated robot are fitted to all runs together with the hypothesis, whose
own values stay those of theory; only the amount of vortex shedding of the tips is fitted as well. Then each
run is predicted by the fit without it, which is one Gauss-Newton step away from the fit to all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError
from frogkick.core.progress import shown
from frogkick.effects import make_effect
from frogkick.effects.acting import LEG_S
from frogkick.effects.body import frame_mass_kg, gyration_m
from frogkick.effects.swims import Gait
from frogkick.identification.calibrated import (
    NOISES,
    GaussNewton,
    calibrated_starts,
    end_deviance,
    end_residuals,
    term_of,
)
from frogkick.identification.fit import Model, coarsened, rollouts_of
from frogkick.identification.segments import Segments, read_segments, reliable
from frogkick.identification.terms import Term
from frogkick.report import style
from frogkick.robot import Robot, load_robot
from frogkick.validation.measured import Profiles
from frogkick.validation.validate import ExperimentResult, root_mean_square, swum_of, validate
from frogkick_studies import StudyResult
from frogkick_studies.configs import Water
from frogkick_studies.steady import gain_of, groupings, with_effects

Table = Mapping[str, Any]

INNER_M, HEIGHT_M, DENSITY_SHARE = 0.035, 0.035, 0.9
"""The paper's frame: a ring of 90 and 35 mm, 35 mm high; its density over the water's (matched)."""

PREDICTING = "limbs are plates"
"""The hypothesis by which speeds are predicted for alloys without measured swims."""

STEPS, DAMPING = 6, 1e-3
"""Largest number of steps of a joint fit, and the damping of the step that holds a run out."""


def ring(robot: Robot) -> dict[str, float]:
    """Return the effect ``hull`` that gives a square frame the mass and the inertia of a ring.

    Its share at the centre takes the radius of gyration from that of its outline to that of a filled ring.
    """
    corners = np.array(robot.frame.corners_m)
    outer = float(np.hypot(*(corners[1] - corners[0])))
    area = outer**2 - INNER_M**2
    mass = DENSITY_SHARE * robot.water_density_kg_per_m3 * area * HEIGHT_M
    gyration2 = (outer**4 - INNER_M**4) / (6.0 * area)
    return {
        "mass": mass / frame_mass_kg(robot.frame),
        "centre_share": 1.0 - gyration2 / gyration_m(robot.frame) ** 2,
    }


def hypotheses(robot: Robot) -> dict[str, tuple[Table, ...]]:
    """Return name -> effects."""
    hull = ring(robot)
    return {
        "nominal": (),
        "a ring's radius of gyration": ({"name": "hull", "centre_share": hull["centre_share"]},),
        "a ring's mass and inertia": ({"name": "hull", **hull},),
        "limbs are plates": ({"name": "limb_plate", "added": 1.0},),
        "both": ({"name": "hull", **hull}, {"name": "limb_plate", "added": 1.0}),
        "their tips shed": ({"name": "limb_plate", "added": 1.0, "shedding": 1.0},),
        "four times the limbs' drag": ({"name": "hull", "limb_drag": 4.0},),
    }


FITTED = {"their tips shed": ("limb_plate", "shedding", 0.5)}
"""Hypothesis -> effect and parameter that a joint fit fits as well, and where it starts."""


@dataclass(frozen=True)
class Swims:
    """Measured swims by one hypothesis.

    Attributes:
        rmse_mps: without a fit.
        factor: on its speeds, fitted to all.
        left_out_mps: way of grouping -> RMSE of groups that the factor was not fitted to.
        gain_m2_per_s2: way -> by how much this lowers the mean square error of the nominal robot, and the
            interval of 95 % of that.
    """

    rmse_mps: float
    factor: float
    left_out_mps: Mapping[str, float]
    gain_m2_per_s2: Mapping[str, tuple[float, float, float]]


def of_swims(speeds: Float64, nominal: Float64, rows: Sequence[ExperimentResult]) -> Swims:
    """Compare speeds, m/s, of measured swims with measurement and with the nominal robot's without a fit."""
    measured = np.array([row.reference.speed_mps for row in rows])
    ways = groupings(rows) | {"series": [row.case.group for row in rows]}
    left_out, gains = {}, {}
    for way, label in ways.items():
        groups, errors = np.array(label), np.empty(len(rows))
        for group in sorted(set(label)):
            kept = groups != group
            errors[~kept] = _factor(speeds[kept], measured[kept]) * speeds[~kept] - measured[~kept]
        left_out[way] = root_mean_square(errors.tolist())
        gains[way] = gain_of(nominal - measured, errors)
    return Swims(root_mean_square((speeds - measured).tolist()), _factor(speeds, measured), left_out, gains)


def _factor(speeds: Float64, measured: Float64) -> float:
    return float(speeds @ measured / (speeds @ speeds))


@dataclass(frozen=True)
class Joint:
    """All effects of a robot, with those of its water, fitted together to recorded runs.

    Attributes:
        fitted, left_out: errors one period ahead on all runs, and on each by the fit without it.
        values: effect and parameter -> value, of those that are not nominal.
    """

    fitted: PredictionError
    left_out: PredictionError
    values: Mapping[str, float]

    @classmethod
    def of(
        cls,
        fit: GaussNewton,
        robot: Robot,
        at: Float64,
        residuals: Sequence[Float64],
        derivatives: Sequence[Float64],
    ) -> Joint:
        """Hold each run out of a fit that is done, from its linearisation.

        Args:
            robot: simulates the held-out runs; the fit may have used a coarser one.
            at, residuals, derivatives: see ``GaussNewton.linearised``.
        """
        swims, ends = fit.swims, []
        for left in range(len(swims)):
            base, columns = (
                np.concatenate([each for run, each in enumerate(of) if run != left])
                for of in (residuals, derivatives)
            )
            without = replace(fit.stepped(at, base, columns, DAMPING), robot=robot)
            (rollouts,) = rollouts_of([without], swims[left : left + 1])
            ends.append(end_residuals(rollouts, swims[left : left + 1]))
        fitted, left_out = (PredictionError.of(np.concatenate(each)) for each in (residuals, ends))
        values = {
            f"{term.title} {p.name}": value
            for term in fit.model.terms
            for p, value in zip(term.parameters, term.values, strict=True)
            if value != p.nominal
        }
        return cls(fitted, left_out, values)

    def as_json(self) -> dict[str, Any]:
        """Return both errors and the values, as studies report them."""
        return {
            "fitted": self.fitted.as_json(),
            "left_out": self.left_out.as_json(),
            "values": dict(self.values),
        }


def quietest(model: Model, swims: Sequence[Segments]) -> Model:
    """Return the model with the one of NOISES that predicts best."""
    models = [replace(model, noise=noise) for noise in NOISES]
    found = [end_deviance(rollouts, swims) for rollouts in rollouts_of(models, swims)]
    return models[int(np.argmin(found))]


def as_it_stands(robot: Robot, tables: Sequence[Table], swims: Sequence[Segments]) -> PredictionError:
    """Return the error of a hypothesis one period ahead, to which nothing is fitted but the noise."""
    terms = tuple(term_of(dict(table), make_effect(dict(table), Path())) for table in tables)
    model = quietest(Model(robot, terms, NOISES[0], LEG_S), swims)
    (rollouts,) = rollouts_of([model], swims)
    return PredictionError.of(end_residuals(rollouts, swims))


def together(robot: Robot, name: str, swims: Sequence[Segments]) -> Joint:
    """Fit all effects of the robot's calibrated start together with a hypothesis, and hold each run out."""
    terms, fixed = started(robot, hypotheses(robot)[name], FITTED.get(name))
    model = quietest(Model(coarsened(robot), terms, NOISES[0], LEG_S, fixed=fixed), swims)
    model = quietest(GaussNewton(model, swims).run(STEPS), swims)
    fit = GaussNewton(model, swims)
    at, residuals, derivatives, _ = fit.linearised()
    return Joint.of(fit, robot, at, residuals, derivatives)


def started(
    robot: Robot, tables: Sequence[Table], fitted: tuple[str, str, float] | None = None
) -> tuple[tuple[Term, ...], frozenset[int]]:
    """Return the calibrated start with a hypothesis in it, and which of its values a fit does not change.

    These are all that the hypothesis names but the one that is ``fitted``, and those that are nominal in the
    calibrated file.
    """
    starts = calibrated_starts(robot)
    if not starts:
        raise InputError(f"no built-in robot is {robot.id!r} with effects: a joint fit has nowhere to start")
    terms = list(next(iter(starts.values())))
    said = {str(table["name"]): dict(table) for table in tables}
    named = {term.name for term in terms}
    terms += [
        term_of({"name": name}, make_effect({"name": name}, Path())) for name in said if name not in named
    ]
    fixed, count = set[int](), 0
    for place, term in enumerate(terms):
        given = said.get(term.name, {})
        free = {fitted[1]: fitted[2]} if fitted is not None and fitted[0] == term.name else {}
        values = [
            float((given | free).get(p.name, value))
            for p, value in zip(term.parameters, term.values, strict=True)
        ]
        for p, value in zip(term.parameters, values, strict=True):
            if p.name not in free and (p.name in given or value == p.nominal):
                fixed.add(count)
            count += 1
        terms[place] = term.at(values)
    return tuple(terms), frozenset(fixed)


@dataclass(frozen=True)
class Row:
    """One hypothesis: measured swims and recorded runs by it; ``runs`` is None without any.

    Attributes:
        joint: None if not asked for, or without recorded runs.
    """

    name: str
    swims: Swims
    runs: PredictionError | None
    joint: Joint | None


@dataclass(frozen=True)
class Prediction:
    """Speeds of a gait of an EGaIn fraction of which no swim was measured: nominal, and by PREDICTING."""

    egain_percent: float
    frequency_hz: float
    nominal_mps: float
    predicted_mps: float


@dataclass(frozen=True, eq=False)
class WaterStudy(StudyResult):
    """Each hypothesis, the nominal robot first.

    Attributes:
        predictions: one for each limb profile of a fraction without a measured swim, at phase 0.5.
    """

    rows: Sequence[Row]
    run_names: Sequence[str]
    predictions: Sequence[Prediction]

    def as_json(self) -> dict[str, Any]:
        return {
            "runs": list(self.run_names),
            "hypotheses": [_row_json(row) for row in self.rows],
            "predictions": [asdict(each) for each in self.predictions],
        }

    def text(self, values: dict[str, Any]) -> str:
        lines = []
        for row in values["hypotheses"]:
            lines.append(f"{row['name']}:")
            swims = row["swims"]
            left = ", ".join(f"by {way} {1e3 * v:.2f}" for way, v in swims["left_out_mps"].items())
            lines.append(
                f"  swims {1e3 * swims['rmse_mps']:.2f} mm/s without a fit; times {swims['factor']:.2f} "
                f"fitted to others, held out {left} mm/s"
            )
            gains = ", ".join(
                f"by {way} {1e6 * gain:.0f} ({1e6 * low:.0f} to {1e6 * high:.0f})"
                for way, (gain, low, high) in swims["gain_m2_per_s2"].items()
            )
            lines.append(f"  mean square error of the nominal robot falls {gains} mm^2/s^2")
            if runs := row["runs"]:
                lines.append(f"  recorded runs without a fit: {PredictionError(**runs)}")
            if joint := row["joint"]:
                lines.append(
                    f"  fitted together: {PredictionError(**joint['fitted'])}; held-out runs: "
                    f"{PredictionError(**joint['left_out'])}"
                )
                lines += [f"    {name} {value:.3g}" for name, value in joint["values"].items()]
        lines += [
            f"predicted at {row['egain_percent']:g} % and {row['frequency_hz']:g} Hz: "
            f"{1e3 * row['predicted_mps']:.1f} mm/s ({PREDICTING}, times its factor); nominal "
            f"{1e3 * row['nominal_mps']:.1f}"
            for row in values["predictions"]
        ]
        return "\n".join(lines)

    def plot(self) -> Figure:
        return left_out_figure(
            "Theory about the water", {row.name: row.swims.left_out_mps for row in self.rows}
        )


def left_out_figure(title: str, errors_mps: Mapping[str, Mapping[str, float]]) -> Figure:
    """Draw speed errors of held-out groups of swims: name -> way of grouping -> RMSE, m/s."""
    place, ways = np.arange(len(errors_mps))[::-1], list(next(iter(errors_mps.values())))
    height = 0.8 / max(len(ways), 1)
    with style.new_figure(8.0, 1.8 + 0.5 * len(errors_mps)) as figure:
        axes = figure.subplots()
        for k, way in enumerate(ways):
            errors_mm_s = [1e3 * by_way[way] for by_way in errors_mps.values()]
            axes.barh(place + 0.4 - (k + 0.5) * height, errors_mm_s, 0.9 * height, label=f"by {way}")
        axes.set_yticks(place, list(errors_mps))
        axes.set_xlabel("speed error of held-out groups (mm/s RMS)")
        axes.set_title(title)
        style.legend_below(figure, axes)
    return figure


def _row_json(row: Row) -> dict[str, Any]:
    return {
        "name": row.name,
        "swims": asdict(row.swims),
        "runs": None if row.runs is None else row.runs.as_json(),
        "joint": None if row.joint is None else row.joint.as_json(),
    }


def recorded(data_dir: Path, robot: Robot) -> tuple[list[Path], list[Segments]]:
    """Return the files of a folder's recorded runs that have a path, and the periods of those to rely on."""
    paths = [
        file
        for file in sorted((data_dir / "control").glob("*.csv"))
        if (found_run := re.fullmatch(r"([a-z]+?)(\d+)", file.stem))
        and file.with_name(f"{found_run[1]}p{found_run[2]}.csv").exists()
    ]
    return paths, reliable([read_segments(path, robot) for path in paths])[0]


def run(config: Water) -> WaterStudy:
    robot = load_robot(config.robot)
    with shown(True, "water: swims") as tell:
        found = validate(robot, config.data_dir, config.processes, tell)
    measured = found.experiments
    if not measured:
        raise InputError(
            f"{str(config.data_dir)!r} has no measured swim whose limbs have a profile: "
            "give a folder with exp/ and profile/"
        )
    paths, runs = recorded(config.data_dir, robot)
    nominal = np.array([row.model_mps for row in measured])
    rows = []
    every = hypotheses(robot)
    with shown(True, "water: hypotheses") as tell:
        for done, (name, tables) in enumerate(every.items()):
            tell(done, len(every))
            changed = with_effects(robot, tables)
            gaits = [row.case.gait for row in measured]
            speeds = _speeds(changed, found.profiles, gaits, config.processes)
            rows.append(
                Row(
                    name,
                    of_swims(speeds, nominal, measured),
                    as_it_stands(robot, tables, runs) if runs else None,
                    together(robot, name, runs) if runs and config.joint else None,
                )
            )
        tell(len(every), len(every))
    unseen = unmeasured(found.profiles, measured)
    plain, predicted = (
        _speeds(with_effects(robot, every[name]), found.profiles, unseen, config.processes).tolist()
        for name in (next(iter(every)), PREDICTING)
    )
    factor = next(row.swims.factor for row in rows if row.name == PREDICTING)
    return WaterStudy(
        rows,
        [path.stem for path in paths],
        [
            Prediction(gait.egain_percent, gait.frequency_hz, before, factor * after)
            for gait, before, after in zip(unseen, plain, predicted, strict=True)
        ],
    )


def unmeasured(profiles: Profiles, swims: Sequence[ExperimentResult]) -> list[Gait]:
    """Return a gait, at phase 0.5, for each limb profile of an alloy of which no swim was measured."""
    known = {swim.case.gait.egain_percent for swim in swims}
    return [
        Gait(profile.egain_percent, profile.frequency_hz, 0.5)
        for profile in profiles.profiles
        if profile.egain_percent not in known
    ]


def _speeds(robot: Robot, profiles: Profiles, gaits: Sequence[Gait], workers: int) -> Float64:
    """Return (len(gaits),) speeds, m/s."""
    swum, failed = swum_of(robot, profiles, set(gaits), workers)
    if failed:
        raise InputError(f"{robot.effects}: {next(iter(failed.values()))}")
    return np.array([swum[gait].speed_mps for gait in gaits])
