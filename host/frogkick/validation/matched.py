"""The robot's unpublished constants, matched to the authors' simulations without some of them
(cross-validation).

Constants that neither the paper nor a measurement gives were matched to the authors' simulations, so errors
on these simulations are too low. Here the constants are matched to all EGaIn fractions but one, for each
fraction, and the errors are those on the fraction that was left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Bool, Float64
from frogkick.core.errors import InputError
from frogkick.robot import Limb, Robot
from frogkick.robot.profile import HalvesProfile
from frogkick.validation.gaits import GaitSwim
from frogkick.validation.validate import Validation, by_group, model_wave, root_mean_square, swum_of

SPEED_SD_MPS = 0.5e-3
"""Standard deviation of a speed in the fit: a negligible difference between two simulations of a gait."""

WIDTH = 0.5
"""Standard deviation of the logarithm of a constant's factor in the prior."""

STEP, STEPS_MOST = 0.03, 8
"""Step of the finite differences, as a share of a factor; largest number of evaluations of a fit."""

FACTORS = (0.2, 5.0)
"""Bounds of each factor; beyond them simulations fail."""

Change = Callable[[Robot, float], Robot]


def _limbs(change: Callable[[Limb, float], Limb]) -> Change:
    return lambda robot, by: replace(robot, limbs=tuple(change(limb, by) for limb in robot.limbs))


_COMMON: Mapping[str, Change] = {
    "frame mass": lambda robot, by: replace(
        robot, frame=replace(robot.frame, mass_per_length_kg_per_m=robot.frame.mass_per_length_kg_per_m * by)
    ),
    "limb stiffness": _limbs(lambda limb, by: replace(limb, second_moment_m4=limb.second_moment_m4 * by)),
    "limb drag": _limbs(
        lambda limb, by: replace(
            limb, drag_normal=limb.drag_normal * by, drag_tangential=limb.drag_tangential * by
        )
    ),
    "limb mass": _limbs(
        lambda limb, by: replace(limb, mass_per_length_kg_per_m=limb.mass_per_length_kg_per_m * by)
    ),
}
CONSTANTS: Mapping[str, Change] = {
    **_COMMON,
    "limb curvature": _limbs(
        lambda limb, by: replace(limb, rest_curvature_per_m=limb.rest_curvature_per_m * by)
    ),
}
"""The matched constants. The frame's drag is the paper's: masses, drags and stiffnesses that all grow by one
factor give the same motion."""

ABSOLUTE_CONSTANTS: Mapping[str, Change] = {
    **_COMMON,
    "EGaIn's mass": _limbs(lambda limb, by: replace(limb, egain_mass_ratio=limb.egain_mass_ratio * by)),
    "limb length": _limbs(lambda limb, by: replace(limb, length_m=limb.length_m * by)),
    # the angle from backward to a limb's root
    "limb direction": _limbs(
        lambda limb, by: replace(
            limb,
            direction_rad=limb.direction_rad
            - (by - 1.0) * (math.copysign(math.pi, limb.direction_rad) - limb.direction_rad),
        )
    ),
}
"""Those of a robot whose profiles are curvatures themselves: its limbs' rest curvature has no effect."""


def constants_of(robot: Robot) -> Mapping[str, Change]:
    """Return the constants that are matched for a robot."""
    absolute = all(isinstance(profile, HalvesProfile) for profile in robot.profiles)
    return ABSOLUTE_CONSTANTS if absolute else CONSTANTS


@dataclass(frozen=True)
class LeftOut:
    """A fraction that the constants were not matched to."""

    egain_percent: float
    factors: Mapping[str, float]  # constant -> its match to the other fractions over the robot's own value
    matched_rmse_mps: float  # of the speeds on the other fractions
    left_out_rmse_mps: float  # and on this one


@dataclass(frozen=True)
class Matched:
    """Each fraction left out once."""

    parts: tuple[LeftOut, ...]  # the results for each fraction
    # group of simulations -> RMSE of its speeds, each from the fit without its fraction
    rmse_mps: Mapping[str, float]
    within_cycle_rms_m: Mapping[str, float]  # group -> RMS of the forward position within a cycle, likewise


def matched_without(
    validation: Validation, workers: int = 1, progress: Callable[[int, int], None] = lambda _done, _all: None
) -> Matched:
    """Match the constants to all EGaIn fractions but one, for each fraction, and predict that one.

    Raises:
        InputError: fewer than two fractions, or a gait that does not converge.
    """
    from scipy.optimize import least_squares

    cases = [result.case for result in validation.simulations]
    known = np.array([result.reference.speed_mps for result in validation.simulations])
    fraction = np.array([case.gait.egain_percent for case in cases])
    every, constants = np.unique(fraction), constants_of(validation.robot)
    if len(every) < 2:
        raise InputError(
            f"simulations of {len(every)} EGaIn fractions, needed are 2 to leave one out: give sim/ with more"
        )

    def swum_with(factors: Float64, rows: Bool) -> list[GaitSwim]:
        robot = validation.robot
        for change, factor in zip(constants.values(), factors.tolist(), strict=True):
            robot = change(robot, factor)
        gaits = [cases[k].gait for k in np.flatnonzero(rows)]
        swum, failed = swum_of(robot, validation.profiles, set(gaits), workers)
        if failed:
            raise InputError(next(iter(failed.values())))
        return [swum[gait] for gait in gaits]

    def missed(factors: Float64, rows: Bool) -> Float64:
        return np.asarray([swim.speed_mps for swim in swum_with(factors, rows)] - known[rows])

    def residual(factors: Float64, rows: Bool) -> Float64:
        return np.asarray(np.append(missed(factors, rows) / SPEED_SD_MPS, np.log(factors) / WIDTH))

    parts, errors_mps, waves_m = list[LeftOut](), np.zeros(len(cases)), np.zeros(len(cases))
    for percent in every:
        progress(len(parts), len(every))
        rows = fraction != percent
        fit = least_squares(
            residual,
            np.ones(len(constants)),
            bounds=FACTORS,
            diff_step=STEP,
            max_nfev=STEPS_MOST,
            ftol=1e-3,
            args=(rows,),
        )
        for k, swim in zip(np.flatnonzero(~rows), swum_with(fit.x, ~rows), strict=True):
            errors_mps[k] = swim.speed_mps - known[k]
            result = validation.simulations[k]
            waves_m[k] = replace(result, model_wave_m=model_wave(result.time_s, swim)).within_cycle_rms_m
        parts.append(
            LeftOut(
                float(percent),
                dict(zip(constants, fit.x.tolist(), strict=True)),
                root_mean_square((SPEED_SD_MPS * fit.fun[: rows.sum()]).tolist()),
                root_mean_square(errors_mps[~rows].tolist()),
            )
        )
    progress(len(every), len(every))
    groups = [case.group for case in cases]
    speeds, waves = (by_group(zip(groups, each.tolist(), strict=True)) for each in (errors_mps, waves_m))
    return Matched(tuple(parts), speeds, waves)
