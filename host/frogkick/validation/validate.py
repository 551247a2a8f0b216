"""The model compared with the authors' simulations and with measured swims, case by case."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.der import WIDTH
from frogkick.effects.swims import Gait
from frogkick.robot import Robot
from frogkick.validation.gaits import CYCLES, FIRST_CYCLE, GaitSwim, speed_over_cycles, swim_chunks
from frogkick.validation.measured import (
    EXPERIMENTS,
    SIMULATIONS,
    Case,
    Profiles,
    Skipped,
    SteadySpeed,
    find_cases,
    read_profiles,
    read_simulation,
    read_speeds,
    read_swim,
    steady_speed,
)

SPEED_LIMITS_MPS = {f"{SIMULATIONS}/freq": 1.2e-3, f"{SIMULATIONS}/phase": 0.5e-3}
WITHIN_CYCLE_LIMIT_M = 0.3e-3
_SAMPLES_PER_CYCLE = 200
_SAME, _SAME_SPEED_MPS = 1e-6, 1e-9
_END_SLACK_S = 0.0015  # the authors' files end one of their 1 ms steps around the last cycle's end


@dataclass(frozen=True)
class SimulationResult:
    """One of the authors' simulations and the model's, over cycles 5 to 8."""

    case: Case
    reference_mps: float
    model_mps: float
    # RMS difference of the forward positions, each without its mean speed, and without the mean difference
    within_cycle_rms_m: float
    profile: str  # origin of the limb's profile
    time_s: Float64  # (n,)
    reference_wave_m: Float64  # (n,) the compared positions
    model_wave_m: Float64

    @property
    def error_mps(self) -> float:
        """Model minus reference."""
        return self.model_mps - self.reference_mps


@dataclass(frozen=True)
class ExperimentResult:
    """A measured swim, the authors' simulation of it if the data has one, and the model's."""

    case: Case
    reference: SteadySpeed  # of the swim's own file, or of the table if there is no file
    tabulated_mps: float | None  # the authors' speed of this gait; if there are several, the nearest
    model_mps: float
    authors_mps: float | None
    profile: str  # origin of the limb's profile

    @property
    def error_mps(self) -> float:
        """Model minus measurement."""
        return self.model_mps - self.reference.speed_mps

    @property
    def authors_error_mps(self) -> float | None:
        """The authors' simulation minus measurement."""
        return None if self.authors_mps is None else self.authors_mps - self.reference.speed_mps


@dataclass(frozen=True)
class Validation:
    """All cases, and those that were left out."""

    folder: Path
    robot: Robot
    profiles: Profiles
    simulations: tuple[SimulationResult, ...]
    experiments: tuple[ExperimentResult, ...]
    skipped: tuple[Skipped, ...]


@dataclass(frozen=True)
class _Reference:
    """The reference of a case: a simulation's track or a swim's speed."""

    case: Case
    track: tuple[Float64, Float64] | None = None
    steady: SteadySpeed | None = None
    tabulated_mps: float | None = None


def validate(
    robot: Robot, folder: Path, workers: int, progress: Callable[[int, int], None] | None = None
) -> Validation:
    """Swim every gait that a data folder has a simulation or a measurement of, and compare.

    One robot for all cases. Limb profiles are fitted to the folder's files; where one is missing the robot's
    own coefficients serve, or those next to it; outside of them a case is skipped.

    Args:
        folder: laid out as ``frogkick.validation.measured`` says.

    Raises:
        InputError: no such folder, or nothing in it.
    """
    cases, skipped = find_cases(folder)
    profiles, unusable = read_profiles(folder / "profile", robot.profiles)
    skipped += unusable
    references: list[_Reference] = []
    table = folder / "exp" / "speeds.csv"
    tabulated = read_speeds(table)
    for case in cases:
        try:
            references.append(_read(case, tabulated))
        except InputError as error:
            skipped.append(Skipped(case.name, str(error)))
    references += _only_tabulated(tabulated, references, table)
    swum, failed = swum_of(
        robot, profiles, {reference.case.gait for reference in references}, workers, progress
    )
    simulations, experiments = list[SimulationResult](), list[ExperimentResult]()
    authors = {
        r.case.gait: speed_over_cycles(*r.track, r.case.gait.frequency_hz) for r in references if r.track
    }
    for reference in references:
        gait = reference.case.gait
        if gait in failed:
            skipped.append(Skipped(reference.case.name, failed[gait]))
        elif reference.track is not None:
            simulations.append(_against_simulation(reference.case, reference.track, swum[gait], profiles))
        elif reference.steady is not None:
            experiments.append(
                ExperimentResult(
                    reference.case,
                    reference.steady,
                    reference.tabulated_mps,
                    swum[gait].speed_mps,
                    authors.get(gait),
                    profiles.source(gait),
                )
            )
    return Validation(folder, robot, profiles, tuple(simulations), tuple(experiments), tuple(skipped))


def _read(case: Case, tabulated: Sequence[tuple[Gait, float]]) -> _Reference:
    gait = case.gait
    if case.group.startswith(SIMULATIONS):
        time_s, forward_m = read_simulation(case.file)
        needed_s = CYCLES / gait.frequency_hz
        if time_s[-1] < needed_s - _END_SLACK_S:
            raise InputError(f"it ends at {time_s[-1]:g} s: cycle {CYCLES} ends at {needed_s:g} s")
        return _Reference(case, track=(time_s, forward_m))
    steady = steady_speed(*read_swim(case.file), gait.frequency_hz)
    rows = [speed for row, speed in tabulated if row == gait]
    nearest = min(rows, key=lambda speed: abs(speed - steady.speed_mps), default=None)
    return _Reference(case, steady=steady, tabulated_mps=nearest)


def _only_tabulated(
    tabulated: Sequence[tuple[Gait, float]], references: Sequence[_Reference], file: Path
) -> list[_Reference]:
    """Return the tabulated speeds of gaits without a file."""
    filed = {reference.case.gait for reference in references if reference.steady is not None}
    rows: list[_Reference] = []
    for number, (gait, speed_mps) in enumerate(tabulated, start=2):
        if gait not in filed:
            case = Case(f"exp/speeds.csv line {number}", f"{EXPERIMENTS}/tabulated", gait, file)
            rows.append(_Reference(case, steady=SteadySpeed(speed_mps, None, 0), tabulated_mps=speed_mps))
    return rows


def swum_of(
    robot: Robot,
    profiles: Profiles,
    gaits: Iterable[Gait],
    workers: int,
    progress: Callable[[int, int], None] | None,
) -> tuple[dict[Gait, GaitSwim], dict[Gait, str]]:
    """Swim each gait once; return the swims, and the reasons of failures."""
    ordered = sorted(gaits, key=lambda gait: (gait.frequency_hz, gait.egain_percent, gait.phase))
    chunks = [ordered[first : first + WIDTH] for first in range(0, len(ordered), WIDTH)]
    swum: dict[Gait, GaitSwim] = {}
    failed: dict[Gait, str] = {}
    for index, results in swim_chunks(robot, profiles.profiles, chunks, workers):
        for gait, result in zip(chunks[index], results, strict=True):
            if isinstance(result, GaitSwim):
                swum[gait] = result
            else:
                failed[gait] = result
        if progress is not None:
            progress(len(swum) + len(failed), len(ordered))
    return swum, failed


def _wave(at_s: Float64, time_s: Float64, forward_m: Float64, speed_mps: float) -> Float64:
    wave = np.interp(at_s, time_s, forward_m) - speed_mps * at_s
    return np.asarray(wave - wave.mean())


def _model_wave(at_s: Float64, swum: GaitSwim) -> Float64:
    return _wave(at_s, swum.time_s, swum.forward_m, swum.speed_mps)


def wave_rms_m(result: SimulationResult, swum: GaitSwim) -> float:
    """Return ``within_cycle_rms_m`` of another swim of the same gait."""
    gap = _model_wave(result.time_s, swum) - result.reference_wave_m
    return float(np.sqrt(np.mean(gap**2)))


def _against_simulation(
    case: Case, track: tuple[Float64, Float64], swum: GaitSwim, profiles: Profiles
) -> SimulationResult:
    frequency_hz = case.gait.frequency_hz
    samples = _SAMPLES_PER_CYCLE * (CYCLES - FIRST_CYCLE) + 1
    time_s = np.linspace(FIRST_CYCLE, CYCLES, samples) / frequency_hz
    reference_mps = speed_over_cycles(*track, frequency_hz)
    reference_wave = _wave(time_s, *track, reference_mps)
    model_wave = _model_wave(time_s, swum)
    rms = float(np.sqrt(np.mean((model_wave - reference_wave) ** 2)))
    source = profiles.source(case.gait)
    return SimulationResult(
        case, reference_mps, swum.speed_mps, rms, source, time_s, reference_wave, model_wave
    )


def root_mean_square(values: Iterable[float]) -> float:
    """Return the root of the mean square; NaN without values."""
    squares = [value * value for value in values]
    return math.sqrt(sum(squares) / len(squares)) if squares else math.nan


def by_group(rows: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the RMS of (group, value) over each group and over its parents (``simulations/freq``)."""
    members: dict[str, list[float]] = {}
    for group, value in rows:
        parts = group.split("/")
        for length in range(1, min(len(parts), 3) + 1):
            members.setdefault("/".join(parts[:length]), []).append(value)
    return {group: root_mean_square(values) for group, values in sorted(members.items())}


@dataclass(frozen=True)
class Requirement:
    """A limit on a value of a group, in SI units."""

    what: str
    group: str
    limit: float
    value: float

    @property
    def held(self) -> bool:
        """Whether the value is known and within the limit."""
        return self.value <= self.limit


def speed_rmse_mps(validation: Validation) -> dict[str, float]:
    """Return the RMS speed error of each group of simulations and of experiments, m/s."""
    rows = [(s.case.group, s.error_mps) for s in validation.simulations]
    return by_group(rows + [(e.case.group, e.error_mps) for e in validation.experiments])


def within_cycle_rms_m(validation: Validation) -> dict[str, float]:
    """Return the RMS of within_cycle_rms_m over each group of simulations, m."""
    return by_group((r.case.group, r.within_cycle_rms_m) for r in validation.simulations)


def authors_rmse_mps(validation: Validation) -> dict[str, float]:
    """Return the RMS error of the authors' simulations against each group of experiments, m/s."""
    pairs = ((r.case.group, r.authors_error_mps) for r in validation.experiments)
    return by_group((group, error) for group, error in pairs if error is not None)


def requirements(validation: Validation) -> list[Requirement]:
    """Return the limits on the agreement with the authors' simulations that this data can test."""
    speed, shape = speed_rmse_mps(validation), within_cycle_rms_m(validation)
    asked = [
        Requirement("speed_rmse_mps", group, limit, speed[group])
        for group, limit in SPEED_LIMITS_MPS.items()
        if group in speed
    ]
    return asked + [
        Requirement("within_cycle_rms_m", group, WITHIN_CYCLE_LIMIT_M, shape[group])
        for group in (SIMULATIONS, *SPEED_LIMITS_MPS)
        if group in shape
    ]


def single_groups_above(validation: Validation) -> list[Requirement]:
    """Return single groups (one EGaIn fraction or one phase sweep) above the limit of their kind."""
    speed, shape = speed_rmse_mps(validation), within_cycle_rms_m(validation)
    found: list[Requirement] = []
    for group in shape:
        if group.count("/") < 2:
            continue
        limit = SPEED_LIMITS_MPS.get(group.rsplit("/", 1)[0], math.inf)
        found.append(Requirement("speed_rmse_mps", group, limit, speed[group]))
        found.append(Requirement("within_cycle_rms_m", group, WITHIN_CYCLE_LIMIT_M, shape[group]))
    return [requirement for requirement in found if not requirement.held]


@dataclass(frozen=True)
class Noise:
    """Noise of measured speeds: a model's error below it cannot be distinguished from noise.

    Three estimates of the standard deviation of a speed, m/s, by group of experiments, none of which uses the
    model:

    - **neighbours**: along a sweep of frequency or phase, the second difference a - 2 b + c of three evenly
      spaced speeds has six times the variance of one, if the true speeds lie on a line. They nearly do over
      0.1 Hz or a tenth of a cycle; where they bend, the estimate is too high. Phase is cyclic: 0.9 and 0.0
      are neighbours.
    - **repeats**: swims of one gait that were measured twice.
    - **within a swim**: scatter between the cycles of one swim, over the root of their number. It does not
      contain the differences between two swims (start of the robot, state of its actuators): it is too low.

    The reported floor is the first: the second has one or two pairs, and the third misses most of the noise.

    Attributes:
        neighbours, within_swim: of each group that allows an estimate.
        triples: number of second differences of ``neighbours``.
        repeats: of all gaits that were measured more than once; NaN without any.
        repeated: number of further swims of these gaits.
    """

    neighbours: dict[str, float]
    triples: dict[str, int]
    within_swim: dict[str, float]
    repeats: float
    repeated: int


def second_differences(places: Sequence[float], speeds: Sequence[float], cycle: float | None) -> list[float]:
    """Return (a - 2 b + c) / sqrt(6) of each three evenly spaced neighbours; ``cycle`` is the period of
    places."""
    rows = sorted(zip(places, speeds, strict=True))
    if cycle is not None:
        rows += [(place + cycle, speed) for place, speed in rows[:2]]
    found: list[float] = []
    for (x0, a), (x1, b), (x2, c) in zip(rows, rows[1:], rows[2:], strict=False):
        if abs((x2 - x1) - (x1 - x0)) < _SAME and 0.0 < x1 - x0 < 0.15:
            found.append((a - 2.0 * b + c) / math.sqrt(6.0))
    return found


def _distinct(results: Iterable[ExperimentResult]) -> dict[Gait, list[float]]:
    """Return the measured speeds of each gait; a swim that belongs to two sweeps counts once."""
    speeds: dict[Gait, list[float]] = {}
    for result in results:
        known = speeds.setdefault(result.case.gait, [])
        if all(abs(result.reference.speed_mps - speed) > _SAME_SPEED_MPS for speed in known):
            known.append(result.reference.speed_mps)
    return speeds


def noise_of(experiments: Sequence[ExperimentResult]) -> Noise:
    """Estimate the noise of measured speeds from the measurements alone."""
    bends: list[tuple[str, float]] = []
    for group, members in itertools.groupby(
        sorted(experiments, key=lambda r: r.case.group), key=lambda r: r.case.group
    ):
        rows = list(members)
        by_phase = "/phase/" in group
        if not by_phase and "/freq/" not in group:
            continue
        places = [r.case.gait.phase if by_phase else r.case.gait.frequency_hz for r in rows]
        speeds = [r.reference.speed_mps for r in rows]
        bends += [(group, bend) for bend in second_differences(places, speeds, 1.0 if by_phase else None)]
    within = [(r.case.group, r.reference.sd_mps) for r in experiments]
    several = [speeds for speeds in _distinct(experiments).values() if len(speeds) > 1]
    spare = sum(len(speeds) - 1 for speeds in several)
    scatter = sum(sum((s - sum(row) / len(row)) ** 2 for s in row) for row in several)
    neighbours = by_group(bends)
    return Noise(
        neighbours,
        {name: sum(g == name or g.startswith(name + "/") for g, _ in bends) for name in neighbours},
        by_group((group, sd) for group, sd in within if sd is not None),
        math.sqrt(scatter / spare) if spare else math.nan,
        spare,
    )
