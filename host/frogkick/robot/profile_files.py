"""Fit every measured profile of a folder and write their coefficients as TOML."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from frogkick.errors import InputError
from frogkick.files import write_text
from frogkick.robot.profile import Profile, fit_profile
from frogkick.robot.toml_text import to_toml


def read_measured_profile(path: Path | str) -> tuple[np.ndarray, np.ndarray]:
    """Read one .mat profile: (time_s (n,), curvature_per_m (n,)).

    Raises:
        InputError: missing, not a MATLAB file, or without ``t`` and ``mean``.
    """
    from scipy.io import loadmat

    try:
        content = loadmat(str(path))
    except (OSError, ValueError, NotImplementedError) as error:
        raise InputError(f"profile {str(path)!r} cannot be read as a MATLAB file: {error}") from error
    if "t" not in content or "mean" not in content:
        raise InputError(f"profile {str(path)!r} has no variables 't' and 'mean': record both")
    return (
        np.asarray(content["t"], dtype=np.float64).ravel(),
        np.asarray(content["mean"], dtype=np.float64).ravel(),
    )


def fit_profile_folder(folder: Path | str) -> list[Profile]:
    """Fit all profiles of ``folder/<EGaIn/10>/<frequency*10>.mat``, the layout of the paper's data.

    Raises:
        InputError: no such folder, no profile in it, or a name that is not a number.
    """
    files = sorted(Path(folder).glob("*/*.mat"))
    if not files:
        raise InputError(f"{str(folder)!r} holds no <EGaIn/10>/<frequency*10>.mat: name the profile folder")
    fitted: list[Profile] = []
    for file in files:
        try:
            egain, frequency = 10.0 * int(file.parent.name), int(file.stem) / 10.0
        except ValueError as error:
            raise InputError(f"profile {str(file)!r} is not named <EGaIn/10>/<frequency*10>.mat") from error
        fitted.append(fit_profile(*read_measured_profile(file), egain, frequency))
    return sorted(fitted, key=lambda p: (p.egain_percent, p.frequency_hz))


def write_profiles(profiles: list[Profile], path: Path | str, origin: str) -> None:
    """Write coefficients as the file that a robot's ``profiles_file`` names.

    Args:
        profiles: fitted profiles.
        path: the TOML to write, atomically.
        origin: one line: where the measurements come from.
    """
    worst = max(p.rms_per_m for p in profiles)
    head = (
        f"# Coefficients of the curvature formula in frogkick.robot.profile, fitted by fit_profile_folder.\n"
        f"# Origin: {origin}\n# Worst fit: {worst:g} 1/m RMS; each profile states its own.\n\n"
    )
    write_text(path, head + to_toml({"profile": [asdict(p) for p in profiles]}))
