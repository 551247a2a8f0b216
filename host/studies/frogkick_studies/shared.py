"""One drag of the water for measured swims and recorded runs: how well it fits both, and where they differ.

Two numbers of the water are shared by all robots, see ``hierarchy``. They are chosen by theory and by leaving
one alloy out. Recorded runs know the same water: all numbers of the calibrated robot are fitted together, of
which only the water's are shared and the others belong to its build. This is done with the runs' own water,
with that of the swims, and with one for both: what the swims say of the water is a prior of the runs
(Laplace's approximation), and the water of that fit is given to the swims. Each run is predicted by the fit
without it, one Gauss-Newton step away from that to all, and each group of swims likewise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError
from frogkick.core.progress import shown
from frogkick.identification.calibrated import (
    DAMPINGS,
    NOISES,
    GaussNewton,
    calibrated_starts,
    end_deviance,
)
from frogkick.identification.fit import Model, coarsened, rollouts_of
from frogkick.identification.segments import Segments
from frogkick.identification.steps import bounded_step, whiten, whitener
from frogkick.robot import Robot, load_robot
from frogkick.validation.validate import validate
from frogkick_studies import StudyResult
from frogkick_studies.configs import Shared
from frogkick_studies.hierarchy import Estimate, Interval, Speeds, SwimsFit, fit_swims, unseen
from frogkick_studies.steady import (
    FRAME_DRAG,
    LIMB_DRAG,
    PLATE,
    Free,
    Simulation,
    Table,
    groupings,
    tables_of,
)
from frogkick_studies.water import (
    DAMPING,
    Joint,
    left_out_figure,
    quietest,
    recorded,
    started,
    unmeasured,
)

STEPS = 3  # of a fit to runs, which starts from calibrated values

HELD = 1e-6  # variance, in widths, of numbers that are given

OWN = ("drag of limbs and frame", "the same, limbs are plates")
"""Those of ``waters`` whose numbers the calibrated robot has as well, so that recorded runs show them."""


def waters(robot: Robot) -> dict[str, tuple[tuple[Free, ...], tuple[Table, ...]]]:
    """Return name -> two numbers of the water that all robots share, and what is given beside them.

    The last asks what swims would say if their limbs were mounted as recorded runs show them by themselves.
    """
    drag, plates = (LIMB_DRAG, FRAME_DRAG), ({"name": "limb_plate", "added": 1.0},)
    found: dict[str, tuple[tuple[Free, ...], tuple[Table, ...]]] = {
        OWN[0]: (drag, ()),
        OWN[1]: (drag, plates),
        "mass of plates, drag of the frame": ((PLATE, FRAME_DRAG), ()),
    }
    for name in calibrated_starts(robot):
        mounts = [table for table in load_robot(name).effects if table["name"] == "limb_mount"]
        found["limbs are plates, mounted as in recorded runs"] = (drag, (*plates, *mounts))
        break
    return found


@dataclass(eq=False)
class Informed(GaussNewton):
    """Gauss-Newton on runs, with what else is known of some scaled values: their mean and a root of its
    precision."""

    known: Sequence[int] = ()
    mean: Float64 = field(default_factory=lambda: np.zeros(0))
    root: Float64 = field(default_factory=lambda: np.zeros((0, 0)))

    def away(self, at: Float64) -> Float64:
        """Return whitened distances from the mean."""
        return np.asarray(self.root @ (at[list(self.known)] - self.mean))

    def stepped(self, at: Float64, residuals: Float64, derivatives: Float64, damping: float) -> Model:
        left, rows = whiten(whitener(residuals), residuals, derivatives)
        more = np.zeros((len(self.root), len(at)))
        more[:, list(self.known)] = self.root
        low, high = self._scaled(np.maximum(self.low, -1e9)), self._scaled(self.high)
        step = bounded_step(
            np.concatenate([rows, more]),
            np.concatenate([left, self.away(at)]),
            np.full(len(at), damping * 0.05 * len(left)),
            np.maximum(low - at, -2.0) * self.free,
            np.minimum(high - at, 2.0) * self.free,
        )
        return self.model.with_values(self._values(at + step))

    def run(self, steps_max: int) -> Model:
        for _ in range(steps_max):
            at, residuals, derivatives, now = self.linearised()
            now += float(self.away(at) @ self.away(at))
            base, columns = np.concatenate(residuals), np.concatenate(derivatives)
            models = [self.stepped(at, base, columns, share) for share in DAMPINGS]
            costs = []
            for model, rollouts in zip(models, rollouts_of(models, self.swims), strict=True):
                away = self.away(self._scaled(model.values))
                costs.append(end_deviance(rollouts, self.swims) + float(away @ away))
            best = int(np.argmin(costs))
            if costs[best] >= now - 0.5:
                break
            self.model = models[best]
        return self.model


def fit_runs(
    robot: Robot,
    water: tuple[Sequence[Free], Sequence[Table]],
    swims: Sequence[Segments],
    *,
    prior: Estimate | None = None,
    held: bool = False,
) -> tuple[Joint, Estimate]:
    """Fit the recorded robot; return the fit, and what its runs alone say of the shared numbers there.

    Args:
        prior: what else is known of the shared numbers, in widths.
        held: they have the prior's values.
    """
    shared, given = water
    said = list(given)
    if held and prior is not None:
        own = {free: free.value(float(w)) for free, w in zip(shared, prior.at, strict=True)}
        said = [*given, *tables_of(own)]
    merged: dict[str, dict[str, Any]] = {}
    for table in said:
        merged.setdefault(str(table["name"]), {}).update(table)
    terms, fixed = started(robot, list(merged.values()))
    model = quietest(Model(coarsened(robot), terms, NOISES[0], 0.05, fixed=fixed), swims)
    places = {
        (term.name, parameter.name): model.indices(k)[n]
        for k, term in enumerate(terms)
        for n, parameter in enumerate(term.parameters)
    }
    chosen = [places[free.effect, free.parameter] for free in shared]
    fit = Informed(model, swims)
    # One width of each, in scaled values: factors are scaled logarithms of both.
    width = np.array([free.width for free in shared]) / fit.reach[chosen]
    if prior is not None and not held:
        precision = np.linalg.inv(prior.covariance) / np.outer(width, width)
        fit.known, fit.mean, fit.root = (
            chosen,
            prior.at * width,
            np.asarray(np.linalg.cholesky(precision).T, dtype=np.float64),
        )
    fit.run(STEPS)
    at, residuals, derivatives, _ = fit.linearised()
    every, columns = np.concatenate(residuals), np.concatenate(derivatives)
    _, rows = whiten(whitener(every), every, columns)
    normal = rows.T @ rows + DAMPING * 0.05 * len(rows) * np.eye(len(at))
    inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    covariance = inverse[np.ix_(chosen, chosen)] / np.outer(width, width)
    return Joint.of(fit, robot, at, residuals, derivatives), Estimate(at[chosen] / width, covariance)


@dataclass(frozen=True)
class Row:
    """One choice of shared numbers.

    Attributes:
        swims: what the drag was fitted to -> the swims: "swims" alone, or "both".
        runs: what the drag was fitted to -> the recorded runs: "runs" alone, that of the "swims", or "both".
        unseen: alloys of which no swim is known, by the water of swims.
    """

    name: str
    swims: Mapping[str, SwimsFit]
    runs: Mapping[str, Joint]
    unseen: Sequence[Interval]


@dataclass(frozen=True, eq=False)
class SharedStudy(StudyResult):
    """Each choice of shared numbers."""

    rows: Sequence[Row]

    def as_json(self) -> dict[str, Any]:
        return {
            "waters": [
                {
                    "name": row.name,
                    "swims": {whose: asdict(fit) for whose, fit in row.swims.items()},
                    "runs": {whose: fit.as_json() for whose, fit in row.runs.items()},
                    "unseen": [asdict(each) for each in row.unseen],
                }
                for row in self.rows
            ]
        }

    def text(self, values: dict[str, Any]) -> str:
        lines = []
        for row in values["waters"]:
            lines.append(f"{row['name']}:")
            for whose, fit in row["swims"].items():
                left = "; ".join(
                    f"by {way} {1e3 * each['rmse_mps']:.2f} mm/s, {100.0 * each['inside']:.0f} % within 90 %"
                    for way, each in fit["left_out"].items()
                )
                rmse_mm_s = 1e3 * fit["rmse_mps"]
                lines.append(f"  swims, drag fitted to {whose}: {rmse_mm_s:.2f} mm/s, left out {left}")
                lines += [
                    f"    {name} {value:.3g} ({low:.3g} to {high:.3g})"
                    for name, (value, low, high) in fit["values"].items()
                ]
            for whose, fit in row["runs"].items():
                errors = [PredictionError(**fit[key]) for key in ("fitted", "left_out")]
                lines.append(f"  recorded runs, drag fitted to {whose}: {errors[0]}; left out {errors[1]}")
                lines += [f"    {name} {value:.3g}" for name, value in fit["values"].items()]
            lines += [
                f"  predicted at {each['egain_percent']:g} % and {each['frequency_hz']:g} Hz: "
                f"{1e3 * each['mean_mps']:.1f} ({1e3 * each['low_mps']:.1f} to "
                f"{1e3 * each['high_mps']:.1f}) mm/s"
                for each in row["unseen"]
            ]
        return "\n".join(lines)

    def plot(self) -> Figure:
        errors_mps = {
            row.name: {way: each.rmse_mps for way, each in row.swims["swims"].left_out.items()}
            for row in self.rows
        }
        return left_out_figure("One drag for all alloys and builds", errors_mps)


def run(config: Shared) -> SharedStudy:
    robot = load_robot(config.robot)
    with shown(True, "shared: swims") as tell:
        found = validate(robot, config.data_dir, config.processes, tell)
    swims = found.experiments
    if len({row.case.gait.egain_percent for row in swims}) < 2:
        raise InputError(f"{str(config.data_dir)!r} needs measured swims of two alloys, with limb profiles")
    gaits = [row.case.gait for row in swims]
    measured = np.array([row.reference.speed_mps for row in swims])
    series = [row.case.group for row in swims]
    ways = groupings(swims) | {"series": series}
    other = unmeasured(found.profiles, swims)
    runs = recorded(config.data_dir, robot)[1] if config.runs else []
    simulation = Simulation(robot, found.profiles.profiles, config.processes)
    rows = []
    with shown(True, "shared: waters") as tell:
        every = waters(robot)
        for done, (name, water) in enumerate(every.items()):
            tell(done, len(every))
            speeds = Speeds(simulation, water, gaits, series)
            alone, estimate = fit_swims(speeds, measured, ways)
            size = len(water[0])
            says = Estimate(estimate.at[:size], estimate.covariance[:size, :size])
            by_whose, runs_by = {"swims": alone}, {}
            if runs and name in OWN:
                runs_by["runs"], _ = fit_runs(robot, water, runs)
                runs_by["swims"], _ = fit_runs(robot, water, runs, prior=says, held=True)
                runs_by["both"], there = fit_runs(robot, water, runs, prior=says)
                held, begin = Estimate(there.at, HELD * np.eye(size)), estimate.at.copy()
                begin[:size] = there.at
                by_whose["both"], _ = fit_swims(speeds, measured, ways, held, begin)
            rows.append(Row(name, by_whose, runs_by, unseen(speeds, estimate, other)))
        tell(len(every), len(every))
    return SharedStudy(rows)
