"""Limb curvature over one actuation cycle: the formula, its fit to measured strokes, interpolation.

A stroke straightens a curled limb within some 50 ms and lets it curl back over the rest of the cycle. The
paper describes each half by one logistic (Huang 2022, Eq. 9; ``HalvesProfile``, with which the published
simulations were made). One logistic down and two up, with the mean taken out that would leave a step between
two cycles, fit all 48 measured profiles within 1.4 1/m RMS (``Profile``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.files import csv_numbers, write_text
from frogkick.robot.toml_text import to_toml

TERMS = 3  # one heating, two cooling: two terms leave 2.0 1/m RMS at worst, four gain 0.16 on average
DIGITS_HZ = 9  # decimal places in which frequencies are compared
FREQUENCY_SAME = 0.02
"""Relative difference up to which the lowest and the highest measured frequency stand for others: a recording
that ends one picture before its period has a frequency that is too high by some 1 %."""
SAMPLE_S = 0.0001  # linear interpolation at this step errs by less than 5e-6 of the activation


@dataclass(frozen=True)
class Profile:
    """Curvature of a limb over one cycle, fitted to a measurement.

    k(t) = rest + raw(t) - raw(0) - (raw(T) - raw(0)) t / T with
    raw(t) = sum over terms of amplitude / (1 + exp(-(t - centre) / width)), so k(0) = k(T) = rest.
    """

    egain_percent: float
    frequency_hz: float
    duration_s: float
    rest_curvature_per_m: float
    amplitude_per_m: tuple[float, ...]
    centre_s: tuple[float, ...]
    width_s: tuple[float, ...]
    rms_per_m: float

    def curvature_per_m(self, time_s: Float64) -> Float64:
        """Curvature (1/m) at times (s, any shape) since the pulse began; rest outside of the cycle."""
        inside = np.clip(time_s, 0.0, self.duration_s)
        parameters = np.concatenate(
            [
                [self.rest_curvature_per_m],
                *zip(self.amplitude_per_m, self.centre_s, self.width_s, strict=True),
            ]
        )
        return _formula(parameters, inside, self.duration_s)


@dataclass(frozen=True)
class HalvesProfile(Profile):
    """Curvature of a limb over one cycle in the paper's form: two halves that meet where it is straightest.

    In each half k(t) = a + (b - a) (l(t) - l(start)) / (l(end) - l(start)), with the logistic
    l(t) = 1 / (1 + exp(-(t - centre) / width)). The first half falls from ``start_per_m`` to the lowest
    measured curvature at ``straightest_s``. The second rises from there to the last measured curvature. The
    two amplitudes are the differences b - a.

    It is the limb's curvature itself and not a drop from a robot's rest. ``rest_curvature_per_m`` is that of
    the robot's limbs, which they leave for good with the first stroke.
    """

    start_per_m: float
    straightest_s: float

    def curvature_per_m(self, time_s: Float64) -> Float64:
        """Curvature (1/m) at times (s, any shape) since the pulse began; outside of the cycle its end's."""
        (down, up), straight, end = self.amplitude_per_m, self.straightest_s, self.duration_s
        heating, cooling = zip(self.centre_s, self.width_s, strict=True)
        return np.asarray(
            self.start_per_m
            + down * _rise(np.clip(time_s, 0.0, straight), 0.0, straight, *heating)
            + up * _rise(np.clip(time_s, straight, end), straight, end, *cooling)
        )


@dataclass(frozen=True)
class Actuation:
    """The effect of a stroke on a limb, sampled for the simulation."""

    duration_s: float  # from the pulse's start to rest
    step_s: float  # spacing of the samples
    drop_per_m: float  # largest drop of the curvature, 1/m
    # (n,) share of that drop: 0 at rest, 1 where the limb is straightest; 0 at both ends, if not of a
    # HalvesProfile
    activation: Float64


def _formula(parameters: Float64, time_s: Float64, end_s: float) -> Float64:
    amplitude, centre, width = (parameters[1 + i :: 3] for i in range(3))

    def raw(t: Float64) -> Float64:
        scaled = (np.asarray(t)[..., None] - centre) / width
        logistic = 0.5 * (1.0 + np.tanh(0.5 * scaled))  # tanh does not overflow, exp would
        return np.asarray((amplitude * logistic).sum(axis=-1))

    start, end = raw(np.zeros(())), raw(np.full((), end_s))
    return np.asarray(parameters[0] + raw(time_s) - start - (end - start) * time_s / end_s)


def _rise(time_s: Float64, start_s: float, end_s: float, centre_s: float, width_s: float) -> Float64:
    """A logistic, scaled to rise from 0 at the start to 1 at the end."""
    at, first, last = (
        0.5 * (1.0 + np.tanh(0.5 * (t - centre_s) / width_s)) for t in (time_s, start_s, end_s)
    )
    return np.asarray((at - first) / (last - first))


def _measured_cycle(
    time_s: Sequence[float] | Float64, curvature_per_m: Sequence[float] | Float64, name: str
) -> tuple[Float64, Float64]:
    """The samples of a cycle as (n,) arrays.

    Raises:
        InputError: see ``fit_profile``.
    """
    t = np.asarray(time_s, dtype=np.float64).ravel()
    k = np.asarray(curvature_per_m, dtype=np.float64).ravel()
    if t.shape != k.shape or t.size < 20:
        raise InputError(
            f"{name} has {t.size} times and {k.size} curvatures: give two equal rows of 20 or more"
        )
    if not (np.isfinite(t).all() and np.isfinite(k).all() and (np.diff(t) > 0).all()):
        raise InputError(
            f"{name} has a non-finite sample or times that do not increase: clean the measurement"
        )
    rest, low = float(k[0]), float(k.min())
    if not rest - low > 1.0:
        raise InputError(
            f"{name} falls from {rest:.3g} to {low:.3g} 1/m: a stroke lowers it by more than 1 1/m"
        )
    if not np.any(t > max(t[int(k.argmin())], 0.1 * float(t[-1]))):
        raise InputError(f"{name} is lowest at its end: a cycle lasts until the limb is at rest")
    return t, k


def fit_profile(
    time_s: Sequence[float] | Float64,
    curvature_per_m: Sequence[float] | Float64,
    egain_percent: float,
    frequency_hz: float,
) -> Profile:
    """Fit the formula of ``Profile`` to one measured cycle by least squares.

    Args:
        time_s: (n,) seconds since the pulse began, increasing, over one cycle, n >= 20.
        curvature_per_m: (n,) measured curvature, 1/m; the largest value is rest, the pulse drives it down.
        egain_percent: liquid metal in the limb, per cent by volume.
        frequency_hz: actuation frequency of the measurement.

    Raises:
        InputError: shapes differ, too few or non-finite samples, time not increasing, no stroke in it.

    Source: Huang 2022, Eq. 9 (one logistic each way); the second cooling term is ours.
    """
    from scipy.optimize import least_squares

    name = f"profile at {egain_percent:g} % EGaIn, {frequency_hz:g} Hz"
    t, k = _measured_cycle(time_s, curvature_per_m, name)
    end, rest, low = float(t[-1]), float(k[0]), float(k.min())
    half_down = t[int(np.argmax(k < 0.5 * (rest + low)))]
    cooling = np.flatnonzero(t > max(t[int(k.argmin())], 0.1 * end))
    best_cost, best = np.inf, np.zeros(1 + 3 * TERMS)
    for spread in (0.5, 0.8):  # two starts: one narrow, one wide pair of cooling terms
        start = [rest, low - rest, half_down, 0.008]
        for level in np.linspace(0.5 - spread / 2, 0.5 + spread / 2, TERMS - 1):
            rising = np.flatnonzero(k[cooling] > low + level * (k[cooling].max() - low))
            centre = t[cooling[rising[0]]] if rising.size else 0.5 * end
            start += [(rest - low) / (TERMS - 1), centre, 0.15 * end / TERMS]
        amplitude_max = max(300.0, 2.0 * (rest - low))  # 300 is that of robots/frog2022.profiles.toml
        lower = [0.0] + [-amplitude_max, 0.0, 0.002] + [-amplitude_max, 0.0, 0.004] * (TERMS - 1)
        upper = [2.0 * rest] + [amplitude_max, end, 0.1] + [amplitude_max, 1.3 * end, end] * (TERMS - 1)
        guess = np.clip(start, np.asarray(lower) + 1e-9, np.asarray(upper) - 1e-9)
        fit = least_squares(
            lambda p: _formula(p, t, end) - k, guess, bounds=(lower, upper), x_scale="jac", max_nfev=400
        )
        if fit.cost < best_cost:
            best_cost, best = float(fit.cost), fit.x
    digits = [float(f"{value:.6g}") for value in best]
    residual = _formula(np.asarray(digits), t, end) - k
    return Profile(
        egain_percent=float(egain_percent),
        frequency_hz=float(frequency_hz),
        duration_s=float(f"{end:.9g}"),
        rest_curvature_per_m=digits[0],
        amplitude_per_m=tuple(digits[1::3]),
        centre_s=tuple(digits[2::3]),
        width_s=tuple(digits[3::3]),
        rms_per_m=float(f"{np.sqrt(np.mean(residual**2)):.3g}"),
    )


def fit_halves(
    time_s: Sequence[float] | Float64,
    curvature_per_m: Sequence[float] | Float64,
    egain_percent: float,
    frequency_hz: float,
    rest_curvature_per_m: float,
) -> HalvesProfile:
    """Fit the paper's form to one measured cycle, each half by itself, through its measured ends.

    Args:
        rest_curvature_per_m: of the robot's limbs, without its sign, 1/m; at least the largest measured.

    The other arguments and the errors are those of ``fit_profile``.

    Source: Huang 2022, Eq. 9. That the halves meet, and end where the measurement does, was found from the
    published simulations: their speed has a kink, and no jump, at the time of the lowest measured curvature.
    """
    from scipy.optimize import least_squares

    name = f"profile at {egain_percent:g} % EGaIn, {frequency_hz:g} Hz"
    t, k = _measured_cycle(time_s, curvature_per_m, name)
    if float(k.max()) > rest_curvature_per_m:
        raise InputError(
            f"{name} is {k.max():.4g} 1/m at most, the robot's limbs {rest_curvature_per_m:g} 1/m at rest: "
            "give the limbs a rest curvature of at least that"
        )
    lowest, end = int(k.argmin()), float(t[-1])
    halfway = lowest + int(np.argmax(k[lowest:] > 0.5 * (k[lowest] + k[0])))
    amplitudes, centres, widths = list[float](), list[float](), list[float]()
    for part, centre_s, width_s, narrowest_s in (
        (slice(0, lowest + 1), 0.5 * t[lowest], 0.01, 0.001),
        (slice(lowest, None), t[halfway], 0.05, 0.004),
    ):
        at, seen = t[part], k[part]
        change = float(seen[-1] - seen[0])

        def missed(shape: Float64, at: Float64 = at, seen: Float64 = seen, change: float = change) -> Float64:
            return np.asarray(seen[0] + change * _rise(at, at[0], at[-1], *shape) - seen)

        fit = least_squares(missed, [centre_s, width_s], bounds=([0.0, narrowest_s], [2.0 * end, 2.0 * end]))
        for known, value in zip((amplitudes, centres, widths), (change, *fit.x), strict=True):
            known.append(float(f"{value:.6g}"))
    profile = HalvesProfile(
        egain_percent=float(egain_percent),
        frequency_hz=float(frequency_hz),
        duration_s=float(f"{end:.9g}"),
        rest_curvature_per_m=float(rest_curvature_per_m),
        amplitude_per_m=tuple(amplitudes),
        centre_s=tuple(centres),
        width_s=tuple(widths),
        rms_per_m=0.0,
        start_per_m=float(f"{k[0]:.6g}"),
        straightest_s=float(f"{t[lowest]:.9g}"),
    )
    residual = profile.curvature_per_m(t) - k
    return replace(profile, rms_per_m=float(f"{np.sqrt(np.mean(residual**2)):.3g}"))


def _known_hz(profile: Profile) -> float:
    """The rounded frequency, for comparisons."""
    return round(profile.frequency_hz, DIGITS_HZ)


def _brackets(values: list[float], wanted: float) -> tuple[float, float, float] | None:
    """The two neighbours of a value and the weight of the upper one; None outside of the range."""
    if not values or not values[0] <= wanted <= values[-1]:
        return None
    upper = next(v for v in values if v >= wanted)
    lower = max(v for v in values if v <= wanted)
    return lower, upper, 0.0 if upper == lower else (wanted - lower) / (upper - lower)


def actuation(profiles: Sequence[Profile], egain_percent: float, frequency_hz: float) -> Actuation:
    """The stroke at an EGaIn fraction and a frequency, interpolated between measured profiles.

    Between two frequencies the drops of the curvature are interpolated at equal times since the pulse, over
    the cycle 1 / frequency; a profile that has ended counts as rest, and the rest at the cycle's end is
    removed by a ramp. The same holds between EGaIn fractions. A frequency outside of the measured ones is
    the nearest of them up to ``FREQUENCY_SAME``.
    """
    wanted_hz = round(float(frequency_hz), DIGITS_HZ)
    fractions = sorted({p.egain_percent for p in profiles})
    covered = {e: sorted(_known_hz(p) for p in profiles if p.egain_percent == e) for e in fractions}
    measured = ", ".join(f"{e:g} %: {f[0]:g}-{f[-1]:g} Hz" for e, f in covered.items())
    error = InputError(
        f"no limb profile at {egain_percent:g} % EGaIn and {frequency_hz:g} Hz: measured are {measured}; "
        "choose within, profiles are not extrapolated"
    )
    pair = _brackets(fractions, float(egain_percent))
    if pair is None or not np.isfinite(wanted_hz):
        raise error
    chosen: list[tuple[float, Profile]] = []
    for egain, egain_weight in ((pair[0], 1.0 - pair[2]), (pair[1], pair[2])):
        if egain_weight == 0.0:
            continue
        nearest_hz = min(max(wanted_hz, covered[egain][0]), covered[egain][-1])
        near = abs(nearest_hz - wanted_hz) <= FREQUENCY_SAME * wanted_hz
        between = _brackets(covered[egain], nearest_hz) if near else None
        if between is None:
            raise error
        for hz, weight in ((between[0], 1.0 - between[2]), (between[1], between[2])):
            if weight > 0.0:
                profile = next(p for p in profiles if p.egain_percent == egain and _known_hz(p) == hz)
                chosen.append((egain_weight * weight, profile))
    halves = any(isinstance(profile, HalvesProfile) for _, profile in chosen)
    end = chosen[0][1].duration_s if len(chosen) == 1 and not halves else 1.0 / wanted_hz
    count = int(np.ceil(end / SAMPLE_S)) + 1
    time_s = np.linspace(0.0, end, count)
    drops = np.zeros(count)
    for weight, profile in chosen:
        drops += weight * (profile.rest_curvature_per_m - profile.curvature_per_m(time_s))
    if not halves:
        drops -= drops[-1] * time_s / end
    drops = np.maximum(drops, 0.0)  # fits overshoot by up to 0.9 1/m; rest is the most curled state
    largest = float(drops.max())
    return Actuation(end, end / (count - 1), largest, drops / largest)


def read_mat(path: Path, name: str) -> tuple[Float64, Float64]:
    """Read ``t`` and one more variable of a MATLAB file, each flattened to one dimension.

    Raises:
        InputError: it is no MATLAB file, or lacks a variable.
    """
    from scipy.io import loadmat

    try:
        content = loadmat(str(path))
        time_s, values = (np.asarray(content[key], dtype=np.float64).ravel() for key in ("t", name))
    except KeyError as error:
        raise InputError(f"{path.name!r} has no variable {error}: record 't' and {name!r}") from error
    except Exception as error:  # a spoilt file makes scipy raise whatever its bytes lead to
        raise InputError(f"{path.name!r} cannot be read as a MATLAB file: {error}") from error
    return time_s, values


@dataclass(frozen=True, eq=False)
class MeasuredStroke:
    """A measured stroke."""

    name: str  # of its file
    time_s: Float64  # (n,) since the pulse began
    curvature_per_m: Float64  # (n,) of the limb, 1/m, positive at rest


def read_stroke(file: Path | str, length_m: float | None = None) -> MeasuredStroke:
    """Read a measured stroke: CSV with a header and one cycle, from the pulse's start to rest.

    The columns are ``time_s`` and ``curvature_per_m``, or ``time_s``, ``tip_x_m``, ``tip_y_m``: the limb's
    tip from its root, x along the tangent at the root. An arc of length l turns by twice the angle of its
    chord, so its curvature is 2 atan2(y, x) / l.

    Args:
        file: the CSV file.
        length_m: length of the limb, for a tracked tip.

    Raises:
        InputError: a column is missing, a number is not finite, or ``length_m`` is needed.
    """
    name = Path(file).name
    rows = np.array(csv_numbers(file, "stroke file", ("time_s",), ("curvature_per_m", "tip_x_m", "tip_y_m")))
    time_s, curvature, x_m, y_m = rows.T
    if np.isnan(curvature).all():
        if np.isnan(x_m).all() or np.isnan(y_m).all():
            raise InputError(
                f"stroke file {name!r} has no column 'curvature_per_m', nor 'tip_x_m' and 'tip_y_m': "
                "its first line is to name them"
            )
        if length_m is None or not 0.0 < length_m < math.inf:
            raise InputError(
                f"stroke file {name!r} has the tip's place, the limb's length is {length_m}: "
                "give it in m, above 0"
            )
        curvature = 2.0 * np.unwrap(np.arctan2(y_m, x_m)) / length_m
    return MeasuredStroke(name, time_s, -curvature if curvature[0] < 0.0 else curvature)


def fit_stroke(stroke: MeasuredStroke, egain_percent: float, frequency_hz: float | None = None) -> Profile:
    """The profile of a measured stroke; the default frequency is one over its last time, to four digits.

    Raises:
        InputError: the stroke begins before 0 s, the frequency is not above 0, or no profile fits.
    """
    time_s = stroke.time_s
    if not time_s[0] >= 0.0:
        raise InputError(f"stroke file {stroke.name!r} begins at {time_s[0]:g} s: 0 is when the pulse begins")
    if frequency_hz is None and time_s[-1] > 0.0:
        frequency_hz = float(f"{1.0 / float(time_s[-1]):.4g}")
    if frequency_hz is None or not 0.0 < frequency_hz < math.inf:
        raise InputError(f"stroke file {stroke.name!r}: {frequency_hz} strokes a second: give more than 0 Hz")
    try:
        return fit_profile(time_s, stroke.curvature_per_m, egain_percent, frequency_hz)
    except InputError as error:
        raise InputError(f"stroke file {stroke.name!r}: {error}") from None


def write_profiles(profiles: list[Profile], path: Path | str, origin: str) -> None:
    """Write coefficients as the file that a robot's ``profiles_file`` names.

    Args:
        profiles: fitted profiles.
        path: the TOML to write, atomically.
        origin: one line: where the measurements come from.
    """
    worst = max(p.rms_per_m for p in profiles)
    head = (
        f"# Coefficients of the curvature formula in frogkick.robot.profile, fitted to measured strokes.\n"
        f"# Origin: {origin}\n# Worst fit: {worst:g} 1/m RMS; each profile states its own.\n\n"
    )
    write_text(path, head + to_toml({"profile": [asdict(p) for p in profiles]}))
