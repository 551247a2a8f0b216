"""Measured strokes from files, fitted, and their coefficients as TOML."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.files import csv_numbers, write_text
from frogkick.robot.profile import Profile, fit_profile
from frogkick.robot.toml_text import to_toml


def read_mat(path: Path, name: str) -> tuple[Float64, Float64]:
    """Read ``t`` and one more variable of a MATLAB file, as rows.

    Raises:
        InputError: not such a file, or one of the variables is missing.
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
class Stroke:
    """A measured stroke."""

    name: str  # of its file
    time_s: Float64  # (n,) since the pulse began
    curvature_per_m: Float64  # (n,) of the limb, 1/m, positive at rest


def read_stroke(file: Path | str, length_m: float | None = None) -> Stroke:
    """Read a measured stroke: CSV with a header and one cycle, from the pulse's start to rest.

    The columns are ``time_s`` and ``curvature_per_m``, or ``time_s``, ``tip_x_m``, ``tip_y_m``: the limb's
    tip from its root, x along the tangent at the root. An arc of length l turns by twice the angle of its
    chord, so its curvature is 2 atan2(y, x) / l.

    Args:
        file: the CSV file.
        length_m: length of the limb, for a tracked tip.

    Raises:
        InputError: no such file, other columns, a cell that is not a number, or a tip without the length.
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
    return Stroke(name, time_s, -curvature if curvature[0] < 0.0 else curvature)


def fit_stroke(stroke: Stroke, egain_percent: float, frequency_hz: float | None = None) -> Profile:
    """The profile of a measured stroke; the default frequency is one over its last time, to four digits.

    Raises:
        InputError: see ``fit_profile``; times before the pulse.
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
