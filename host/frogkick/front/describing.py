"""A robot in numbers with warnings about doubtful values; the file of a new robot; fits of strokes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.files import require_writable, write_text
from frogkick.der import prepare
from frogkick.effects import effects_of
from frogkick.robot import Robot, load_robot, parse_robot, robot_warnings
from frogkick.robot.profile import MeasuredStroke, Profile, fit_stroke, read_stroke, write_profiles
from frogkick.robot.template import new_robot_text
from frogkick_codegen.firmware import require_limits

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def describe(robot: Robot) -> dict[str, Any]:
    """The keys of the command ``robot show``: the robot as it is simulated, with lengths at rest.

    Raises:
        InputError: an effect of its file is none, or does not fit it.
    """
    effects_of(robot)
    mesh, guard = prepare(robot).mesh, robot.guard
    corners = np.array(robot.frame.corners_m)

    def limb_names(mask: int) -> list[str]:
        return [limb.name for i, limb in enumerate(robot.limbs) if mask >> i & 1]

    return {
        "id": robot.id,
        "title": robot.title,
        "sha256": robot.sha256.hex(),
        "limbs": [
            {
                "index": i,
                "name": limb.name,
                "corner": limb.corner,
                "root_m": list(robot.frame.corners_m[limb.corner]),
                "direction_rad": limb.direction_rad,
                "length_m": limb.length_m,
                "rest_curvature_per_m": limb.rest_curvature_per_m,
                "actions": [a.name for a in robot.actions if (a.first_mask | a.second_mask) >> i & 1],
            }
            for i, limb in enumerate(robot.limbs)
        ],
        "actions": [
            {"name": a.name, "first": limb_names(a.first_mask), "second": limb_names(a.second_mask)}
            for a in robot.actions
        ],
        "nodes": len(mesh.rest_m),
        "mass_kg": robot.mass_kg,
        "sizes": {
            "length_m": float(np.ptp(mesh.rest_m[:, 0])),
            "width_m": float(np.ptp(mesh.rest_m[:, 1])),
            "frame_length_m": float(np.ptp(corners[:, 0])),
            "frame_width_m": float(np.ptp(corners[:, 1])),
            "segment_min_m": float(mesh.edge_length_m.min()),
            "segment_max_m": float(mesh.edge_length_m.max()),
            "mass_with_water_kg": float(mesh.mass_kg.sum()),
            "centre_m": (corners[0] - mesh.rest_m[0]).tolist(),
        },
        "limits": {
            name: getattr(guard, name)
            for name in ("pulse_max_s", "rest_min_s", "duty_max", "duty_window_s", "limbs_at_once_max")
        },
        "period_s": robot.period_s,
        "pulse_s": robot.pulse_s,
        "warnings": (*robot_warnings(robot), *_refused_by_firmware(robot)),
    }


def _refused_by_firmware(robot: Robot) -> tuple[str, ...]:
    """A warning if the robot can be simulated, but its limits fit no firmware."""
    try:
        require_limits(robot)
    except InputError as error:
        return (f"{error}; until then it can be simulated, but no firmware built and no run",)
    return ()


def write_new_robot(file: Path, base: Robot | str = "frog2022", limbs: int | None = None) -> Robot:
    """Write a robot file to start from, with all keys of another robot and a comment on each, and read it.

    The file must not exist; its name without the ending is the robot's id. With another number of
    ``limbs`` than that of ``base`` they are laid out anew, in mirrored pairs and an odd one as a tail, with
    actions of their own. Effects are not taken over.
    """
    require_writable(file)
    if file.exists():
        raise InputError(f"{str(file)!r} exists already: name a new file, or remove that one")
    text = new_robot_text(load_robot(base), file.stem, limbs)
    robot = parse_robot(text, f"{str(file)!r}, whose name becomes the robot's id", file.parent)
    write_text(file, text)
    return robot


@dataclass(frozen=True, eq=False)
class FittedStrokes:
    """Measured strokes, and the profile that was fitted to each."""

    strokes: Sequence[MeasuredStroke]
    profiles: Sequence[Profile]

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``robot fit-stroke``: the fit of each stroke and its error."""
        return {
            "profiles": [
                {
                    "file": stroke.name,
                    "egain_percent": profile.egain_percent,
                    "frequency_hz": profile.frequency_hz,
                    "duration_s": profile.duration_s,
                    "rest_curvature_per_m": profile.rest_curvature_per_m,
                    "drop_per_m": float(stroke.curvature_per_m[0] - stroke.curvature_per_m.min()),
                    "rms_per_m": profile.rms_per_m,
                }
                for stroke, profile in zip(self.strokes, self.profiles, strict=True)
            ]
        }

    def plot(self) -> Figure:
        """Return a matplotlib figure of each measured stroke and its fit."""
        from frogkick.report.robot_figure import stroke_figure

        return stroke_figure(self.strokes, self.profiles)

    def save(self, file: Path | str) -> None:
        """Write the profiles as a TOML file for the key ``profiles_file`` of a robot."""
        write_profiles(list(self.profiles), file, ", ".join(stroke.name for stroke in self.strokes))


def fit_strokes(
    files: Sequence[Path | str],
    *,
    egain_percent: float = 0.0,
    frequency_hz: Sequence[float] | None = None,
    length_m: float | None = None,
) -> FittedStrokes:
    """Fit limb profiles to measured strokes, a CSV file for each frequency.

    The arguments are the options of the command ``robot fit-stroke``.
    """
    strokes = [read_stroke(file, length_m) for file in files]
    known_hz: Sequence[float | None] = frequency_hz or [None] * len(strokes)
    if len(known_hz) != len(strokes):
        raise InputError(
            f"{len(strokes)} stroke files and {len(known_hz)} frequencies: give --frequency-hz once for each "
            "file, in their order, or leave it out"
        )
    profiles = [fit_stroke(stroke, egain_percent, hz) for stroke, hz in zip(strokes, known_hz, strict=True)]
    order = sorted(range(len(strokes)), key=lambda index: profiles[index].frequency_hz)
    for one, other in itertools.pairwise(order):
        if profiles[one].frequency_hz == profiles[other].frequency_hz:
            raise InputError(
                f"stroke files {strokes[one].name!r} and {strokes[other].name!r} are both at "
                f"{profiles[one].frequency_hz:g} Hz: give one file for each frequency"
            )
    return FittedStrokes([strokes[k] for k in order], [profiles[k] for k in order])
