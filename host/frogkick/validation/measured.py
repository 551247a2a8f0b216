"""Read the published simulations, measured swims, tabulated speeds and limb profiles of the paper's data.

Cases are found by the names of their files, so a folder may hold more cases than the published data:

- ``sim/**/simDER_phaseDelay_P_frequency_F_EGaIn_E.txt``: time s, x m, y m of the robot's centre; y is forward
- ``exp/freq/E/FHz.mat`` (at phase 0.5) and ``exp/phase/E_FHz/<10 P>.mat``: ``t`` s and ``distance`` mm
- ``exp/speeds.csv``: egain_percent, frequency_hz, phase_offset, speed_mm_per_s
- ``profile/<E/10>/<10 F>.mat``: ``t`` s and ``mean`` 1/m

Source: data published with Huang, Patterson et al. 2022, doi 10.1002/aisy.202200163.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.effects.swims import Gait
from frogkick.robot import Profile, fit_profile
from frogkick.robot.profile import HalvesProfile, fit_halves, read_mat

SIMULATIONS = "simulations"
EXPERIMENTS = "experiments"

_NUMBER = r"(\d+(?:(?:\.|dot)\d+)?)"
_SIMULATION = re.compile(rf"simDER_phaseDelay_{_NUMBER}_frequency_{_NUMBER}_EGaIn_{_NUMBER}\.txt", re.I)
_FREQUENCY = re.compile(rf"freq/{_NUMBER}/{_NUMBER} ?Hz\.mat", re.I)
_PHASE = re.compile(rf"phase/{_NUMBER}_{_NUMBER} ?Hz/{_NUMBER}\.mat", re.I)
_FREQUENCY_SWEEP_PHASE = 0.5


@dataclass(frozen=True)
class Case:
    """One swim of the data."""

    name: str  # its file, relative to the data's folder
    group: str  # ``simulations`` or ``experiments``, then ``freq/<EGaIn>`` or ``phase/<EGaIn>_<F>Hz``
    gait: Gait
    file: Path


@dataclass(frozen=True)
class Skipped:
    """A file or case that was left out, and the reason."""

    case: str
    reason: str


@dataclass(frozen=True)
class SteadySpeed:
    """The speed of a measured swim."""

    speed_mps: float  # slope of the straight line fitted to distance over time, as the authors tabulate it
    # standard deviation of the mean of the speeds over its whole cycles; None below two cycles
    sd_mps: float | None
    cycles: int  # whole cycles that it lasts


@dataclass(frozen=True)
class Profiles:
    """Limb profiles for the simulation."""

    # fits to the data's files if there are any, otherwise the robot's own coefficients
    profiles: tuple[Profile, ...]
    measured: frozenset[tuple[float, float]]  # (EGaIn fraction, frequency) of those from files

    def source(self, gait: Gait) -> str:
        """Return the origin of a gait's profile: a file, cached coefficients, or interpolation."""
        key = (gait.egain_percent, gait.frequency_hz)
        if key in self.measured:
            return "measured file"
        known = {(profile.egain_percent, profile.frequency_hz) for profile in self.profiles}
        return "cached coefficients" if key in known else "interpolated"


def _number(text: str) -> float:
    return float(text.lower().replace("dot", "."))


def _gait_of(relative: str) -> Gait | None:
    """The gait that a file's name says; None if it says none."""
    if found := _SIMULATION.fullmatch(relative.rsplit("/", 1)[-1]):
        phase, frequency, egain = map(_number, found.groups())
        return Gait(egain, frequency, phase)
    if found := _FREQUENCY.search(relative):
        return Gait(_number(found[1]), _number(found[2]), _FREQUENCY_SWEEP_PHASE)
    if found := _PHASE.search(relative):
        text = found[3]
        phase = _number(text) if "." in text or "dot" in text else int(text) / 10.0
        return Gait(_number(found[1]), _number(found[2]), phase)
    return None


def _group(kind: str, relative: str, gait: Gait) -> str:
    folder = relative.split("/")[1]
    if folder == "freq":
        return f"{kind}/freq/{gait.egain_percent:g}"
    if folder == "phase":
        return f"{kind}/phase/{gait.egain_percent:g}_{gait.frequency_hz:g}Hz"
    return f"{kind}/other"


def find_cases(folder: Path) -> tuple[list[Case], list[Skipped]]:
    """Find every simulation and measured swim of a data folder by its name, in order of group and gait.

    Returns:
        Cases, and files whose names say no gait.

    Raises:
        InputError: no such folder, or no case in it.
    """
    if not folder.is_dir():
        raise InputError(f"data folder {str(folder)!r} does not exist: name the one that holds sim/ and exp/")
    cases: list[Case] = []
    skipped: list[Skipped] = []
    for kind, top, pattern in ((SIMULATIONS, "sim", "*.txt"), (EXPERIMENTS, "exp", "*.mat")):
        for file in sorted((folder / top).rglob(pattern)):
            relative = file.relative_to(folder).as_posix()
            gait = _gait_of(relative)
            if gait is None or not (gait.frequency_hz > 0.0 and 0.0 <= gait.phase < 1.0):
                skipped.append(Skipped(relative, "its name says no EGaIn fraction, frequency and phase"))
            else:
                cases.append(Case(relative, _group(kind, relative, gait), gait, file))
    if not cases:
        raise InputError(f"{str(folder)!r} holds no case: it needs sim/**/simDER_*.txt or exp/{{freq,phase}}")
    cases.sort(key=lambda case: (case.group.split("/")[:2], astuple(case.gait), case.name))
    return cases, skipped


def read_simulation(path: Path) -> tuple[Float64, Float64]:
    """Read one of the authors' simulations: (n,) time, s, and forward position, m.

    Raises:
        InputError: missing, not rows of three numbers, or times that do not increase.
    """
    file = existing_file(path, "simulation")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # loadtxt only warns of a file without rows
            rows = np.loadtxt(file, ndmin=2)
    except (ValueError, UserWarning, UnicodeDecodeError) as error:
        raise InputError(f"simulation {path.name!r} is not rows of three numbers: {error}") from error
    if rows.shape[1] < 3 or len(rows) < 2 or not np.isfinite(rows).all():
        raise InputError(f"simulation {path.name!r} is {rows.shape}: give finite rows of time, x, y")
    if not (np.diff(rows[:, 0]) > 0.0).all():
        raise InputError(f"simulation {path.name!r} has times that do not increase: export it again")
    return rows[:, 0], rows[:, 2]


def read_swim(path: Path) -> tuple[Float64, Float64]:
    """Read a measured swim: (n,) times, s, and distances along its track, m.

    Raises:
        InputError: not a MATLAB file, without ``t`` and ``distance``, or not two equal finite rows.
    """
    time_s, distance_mm = read_mat(existing_file(path, "measured swim"), "distance")
    distance_m = 1e-3 * distance_mm
    good = time_s.shape == distance_m.shape and time_s.size >= 10
    if not (good and np.isfinite(time_s).all() and np.isfinite(distance_m).all()):
        raise InputError(
            f"swim {path.name!r} has {time_s.size} times, {distance_m.size} distances: "
            "give two equal finite rows of 10 or more"
        )
    if not (np.diff(time_s) > 0.0).all():
        raise InputError(f"swim {path.name!r} has times that do not increase: export it again")
    return time_s, distance_m


def steady_speed(time_s: Float64, distance_m: Float64, frequency_hz: float) -> SteadySpeed:
    """Return the speed of a measured swim and its standard error.

    The standard error comes from the scatter between cycles; it does not contain the differences between
    swims.
    """
    slope = float(np.polyfit(time_s, distance_m, 1)[0])
    lasts_s = float(time_s[-1] - time_s[0])
    cycles = int(lasts_s * frequency_hz + 1e-6)
    ends_s = time_s[0] + np.arange(cycles + 1) / frequency_hz
    speeds = np.diff(np.interp(ends_s, time_s, distance_m)) * frequency_hz
    sd = float(speeds.std(ddof=1) / np.sqrt(cycles)) if cycles >= 2 else None
    return SteadySpeed(slope, sd, cycles)


def read_speeds(path: Path) -> list[tuple[Gait, float]]:
    """Read the authors' tabulated speeds: gait and m/s of each row; no rows if there is no file.

    Raises:
        InputError: a column is missing, or a cell is no number.
    """
    if not path.is_file():
        return []
    rows: list[tuple[Gait, float]] = []
    with path.open(newline="", encoding="utf-8") as file:
        for number, row in enumerate(csv.DictReader(file), start=2):
            try:
                gait = Gait(
                    float(row["egain_percent"]), float(row["frequency_hz"]), float(row["phase_offset"])
                )
                rows.append((gait, 1e-3 * float(row["speed_mm_per_s"])))
            except (KeyError, TypeError, ValueError) as error:
                raise InputError(
                    f"{path.name!r} line {number}: {error}; give egain_percent, frequency_hz, phase_offset, "
                    "speed_mm_per_s"
                ) from error
    return rows


def read_profiles(folder: Path, cached: Sequence[Profile]) -> tuple[Profiles, list[Skipped]]:
    """Fit the profiles of ``folder``; cached coefficients are used where it has no file.

    Args:
        cached: those of a robot; files are fitted in the same form, the paper's or the smooth one.

    Returns:
        The profiles, and the files that could not be used.
    """
    chosen = {(profile.egain_percent, profile.frequency_hz): profile for profile in cached}
    halves = all(isinstance(profile, HalvesProfile) for profile in cached)
    measured: set[tuple[float, float]] = set()
    skipped: list[Skipped] = []
    for file in sorted(folder.glob("*/*.mat")):
        relative = f"{folder.name}/{file.parent.name}/{file.name}"
        try:
            key = (10.0 * int(file.parent.name), int(file.stem) / 10.0)
        except ValueError:
            skipped.append(Skipped(relative, "not named <EGaIn/10>/<10 frequency>.mat"))
            continue
        try:
            rows = read_mat(file, "mean")
            chosen[key] = (
                fit_halves(*rows, *key, cached[0].rest_curvature_per_m)
                if halves
                else fit_profile(*rows, *key)
            )
        except InputError as error:
            skipped.append(Skipped(relative, str(error)))
            continue
        measured.add(key)
    ordered = tuple(chosen[key] for key in sorted(chosen))
    return Profiles(ordered, frozenset(measured)), skipped
