"""The model compared with the authors' simulations and with measured swims, case by case."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.der import WIDTH
from frogkick.effects.swims import Gait
from frogkick.robot import Robot
from frogkick.validation import measured
from frogkick.validation.gaits import CYCLES, FIRST_CYCLE, GaitSwim, speed_over_cycles, swim_chunks
from frogkick.validation.measured import EXPERIMENTS, SIMULATIONS, Case, Profiles, Skipped, SteadySpeed

SPEED_LIMITS_MPS = {f"{SIMULATIONS}/freq": 1.2e-3, f"{SIMULATIONS}/phase": 0.5e-3}
WITHIN_CYCLE_LIMIT_M = 0.3e-3
_SAMPLES_PER_CYCLE = 200
_SAME, _SAME_SPEED_MPS = 1e-6, 1e-9
_END_SLACK_S = 0.0015  # the authors' files end one of their 1 ms steps around the last cycle's end


Track = tuple[Float64, Float64]
"""(n,) times, s, and forward positions, m, of one of the authors' simulations."""


@dataclass(frozen=True)
class Result:
    """What a gait is compared with, and the model's swim."""

    case: Case
    # of the simulation over cycles 5 to 8; of the swim's own file, or of the table if there is no file
    reference: SteadySpeed
    model_mps: float
    profile: str  # origin of the limb's profile

    @property
    def error_mps(self) -> float:
        """Model minus reference."""
        return self.model_mps - self.reference.speed_mps


@dataclass(frozen=True)
class SimulationResult(Result):
    """One of the authors' simulations and the model's, over cycles 5 to 8.

    The positions are compared each without its mean speed, and without the mean difference.
    """

    time_s: Float64  # (n,)
    reference_wave_m: Float64  # (n,) the compared positions
    model_wave_m: Float64

    @property
    def within_cycle_rms_m(self) -> float:
        """RMS difference of the compared positions."""
        return float(np.sqrt(np.mean((self.model_wave_m - self.reference_wave_m) ** 2)))


@dataclass(frozen=True)
class ExperimentResult(Result):
    """A measured swim, the authors' simulation of it if the data has one, and the model's."""

    tabulated_mps: float | None  # the authors' speed of this gait; if there are several, the nearest
    authors_mps: float | None


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


@dataclass(frozen=True)
class Validation:
    """All cases, and those that were left out."""

    robot: Robot
    profiles: Profiles
    simulations: tuple[SimulationResult, ...]
    experiments: tuple[ExperimentResult, ...]
    skipped: tuple[Skipped, ...]

    @cached_property
    def speed_rmse_mps(self) -> dict[str, float]:
        """RMS speed error of each group of simulations and of experiments, m/s."""
        results: tuple[Result, ...] = (*self.simulations, *self.experiments)
        return by_group((each.case.group, each.error_mps) for each in results)

    @cached_property
    def within_cycle_rms_m(self) -> dict[str, float]:
        """RMS of ``within_cycle_rms_m`` over each group of simulations, m."""
        return by_group((each.case.group, each.within_cycle_rms_m) for each in self.simulations)

    @property
    def authors_rmse_mps(self) -> dict[str, float]:
        """RMS error of the authors' simulations against each group of experiments, m/s."""
        return by_group(
            (each.case.group, each.authors_mps - each.reference.speed_mps)
            for each in self.experiments
            if each.authors_mps is not None
        )

    def _required(self, speeds: Mapping[str, float], shapes: Iterable[str]) -> list[Requirement]:
        """The limits of the groups that this data has: ``speeds`` group -> limit, ``shapes`` groups."""
        speed, shape = self.speed_rmse_mps, self.within_cycle_rms_m
        asked = [("speed_rmse_mps", group, limit, speed) for group, limit in speeds.items()]
        asked += [("within_cycle_rms_m", group, WITHIN_CYCLE_LIMIT_M, shape) for group in shapes]
        return [Requirement(what, group, limit, of[group]) for what, group, limit, of in asked if group in of]

    @property
    def requirements(self) -> list[Requirement]:
        """The limits on the agreement with the authors' simulations that this data can test."""
        return self._required(SPEED_LIMITS_MPS, (SIMULATIONS, *SPEED_LIMITS_MPS))

    @property
    def single_groups_above(self) -> list[Requirement]:
        """The single groups (one EGaIn fraction or one phase sweep) above the limit of their kind."""
        found: list[Requirement] = []
        for group in self.within_cycle_rms_m:
            if group.count("/") == 2:
                limit = SPEED_LIMITS_MPS.get(group.rsplit("/", 1)[0], math.inf)
                found += self._required({group: limit}, [group])
        return [requirement for requirement in found if not requirement.held]


def validate(
    robot: Robot, folder: Path, workers: int, progress: Callable[[int, int], None] = lambda _done, _all: None
) -> Validation:
    """Swim every gait that a data folder has a simulation or a measurement of, and compare.

    One robot for all cases. Limb profiles are fitted to the folder's files; where one is missing the robot's
    own coefficients serve, or those next to it; outside of them a case is skipped.

    Args:
        folder: laid out as ``frogkick.validation.measured`` says.

    Raises:
        InputError: no such folder, or nothing in it.
    """
    cases, skipped = measured.find_cases(folder)
    profiles, unusable = measured.read_profiles(folder / "profile", robot.profiles)
    skipped += unusable
    references: list[tuple[Case, Track | SteadySpeed]] = []
    table = folder / "exp" / "speeds.csv"
    tabulated = measured.read_speeds(table)
    for case in cases:
        try:
            references.append((case, _read(case)))
        except InputError as error:
            skipped.append(Skipped(case.name, str(error)))
    filed = {case.gait for case, reference in references if isinstance(reference, SteadySpeed)}
    for number, (gait, speed_mps) in enumerate(tabulated, start=2):
        if gait not in filed:
            case = Case(f"exp/speeds.csv line {number}", f"{EXPERIMENTS}/tabulated", gait, table)
            references.append((case, SteadySpeed(speed_mps, None, 0)))
    swum, failed = swum_of(robot, profiles, {case.gait for case, _ in references}, workers, progress)
    simulations, experiments = list[SimulationResult](), list[ExperimentResult]()
    authors = {
        case.gait: speed_over_cycles(*reference, case.gait.frequency_hz)
        for case, reference in references
        if not isinstance(reference, SteadySpeed)
    }
    for case, reference in references:
        gait = case.gait
        if gait in failed:
            skipped.append(Skipped(case.name, failed[gait]))
            continue
        model_mps, profile = swum[gait].speed_mps, profiles.source(gait)
        if isinstance(reference, SteadySpeed):
            speeds = [speed_mps for row, speed_mps in tabulated if row == gait]
            nearest = min(speeds, key=lambda speed: abs(speed - reference.speed_mps), default=None)
            experiments.append(
                ExperimentResult(case, reference, model_mps, profile, nearest, authors.get(gait))
            )
        else:
            steady = SteadySpeed(speed_over_cycles(*reference, gait.frequency_hz), None, CYCLES - FIRST_CYCLE)
            samples = _SAMPLES_PER_CYCLE * (CYCLES - FIRST_CYCLE) + 1
            time_s = np.linspace(FIRST_CYCLE, CYCLES, samples) / gait.frequency_hz
            waves = _wave(time_s, *reference, steady.speed_mps), model_wave(time_s, swum[gait])
            simulations.append(SimulationResult(case, steady, model_mps, profile, time_s, *waves))
    return Validation(robot, profiles, tuple(simulations), tuple(experiments), tuple(skipped))


def _read(case: Case) -> Track | SteadySpeed:
    """The track of a simulation, or the speed of a swim."""
    frequency_hz = case.gait.frequency_hz
    if not case.group.startswith(SIMULATIONS):
        return measured.steady_speed(*measured.read_swim(case.file), frequency_hz)
    track = measured.read_simulation(case.file)
    end_s, needed_s = track[0][-1], CYCLES / frequency_hz
    if end_s < needed_s - _END_SLACK_S:
        raise InputError(f"it ends at {end_s:g} s: cycle {CYCLES} ends at {needed_s:g} s")
    return track


def swum_of(
    robot: Robot,
    profiles: Profiles,
    gaits: Iterable[Gait],
    workers: int,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> tuple[dict[Gait, GaitSwim], dict[Gait, str]]:
    """Swim each gait once; return the swims, and the reasons of failures."""
    ordered = sorted(gaits, key=lambda gait: (gait.egain_percent, gait.frequency_hz, gait.phase))
    chunks = [ordered[first : first + WIDTH] for first in range(0, len(ordered), WIDTH)]
    swum: dict[Gait, GaitSwim] = {}
    failed: dict[Gait, str] = {}
    for index, results in swim_chunks(robot, profiles.profiles, chunks, workers):
        for gait, result in zip(chunks[index], results, strict=True):
            if isinstance(result, GaitSwim):
                swum[gait] = result
            else:
                failed[gait] = result
        progress(len(swum) + len(failed), len(ordered))
    return swum, failed


def _wave(at_s: Float64, time_s: Float64, forward_m: Float64, speed_mps: float) -> Float64:
    wave = np.interp(at_s, time_s, forward_m) - speed_mps * at_s
    return np.asarray(wave - wave.mean())


def model_wave(at_s: Float64, swum: GaitSwim) -> Float64:
    """Return (n,) the ``model_wave_m`` of a swim at times of a ``SimulationResult``."""
    return _wave(at_s, swum.time_s, swum.forward_m, swum.speed_mps)


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
class SpeedNoise:
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
    """

    neighbours: dict[str, float]  # of each group that allows an estimate
    triples: dict[str, int]  # number of second differences of ``neighbours``
    within_swim: dict[str, float]  # of each group that allows an estimate
    repeats: float  # of all gaits that were measured more than once; NaN without any
    repeated: int  # number of further swims of these gaits


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


def noise_of(experiments: Sequence[ExperimentResult]) -> SpeedNoise:
    """Estimate the noise of measured speeds from the measurements alone."""
    bends: list[tuple[str, float]] = []
    for group in sorted({r.case.group for r in experiments}):
        rows = [r for r in experiments if r.case.group == group]
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
    return SpeedNoise(
        neighbours,
        {name: sum(g == name or g.startswith(name + "/") for g, _ in bends) for name in neighbours},
        by_group((group, sd) for group, sd in within if sd is not None),
        math.sqrt(scatter / spare) if spare else math.nan,
        spare,
    )
