"""What a robot is, in numbers, and what is doubtful about it; a file for a new one; its limbs' strokes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.files import require_writable, write_text
from frogkick.der import Rods, prepare
from frogkick.robot import Robot, load_robot, parse_robot, robot_warnings
from frogkick.robot.profile import Profile
from frogkick.robot.profile_files import Stroke, fit_stroke, read_stroke, write_profiles
from frogkick.robot.template import new_robot_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Description", "FittedStrokes", "describe", "fit_strokes", "write_new_robot"]


@dataclass(frozen=True, eq=False, repr=False)
class Description:
    """A robot as it is simulated.

    Attributes:
        robot: it.
        rods: its frame and limbs at rest, as nodes and edges.
        warnings: doubts about its geometry or its limits.
    """

    robot: Robot
    rods: Rods
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``robot show``; lengths are those at rest."""
        robot, mesh = self.robot, self.rods.mesh
        corners = np.array(robot.frame.corners_m)
        guard = robot.guard
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
                {
                    "name": a.name,
                    "first": self._limb_names(a.first_mask),
                    "second": self._limb_names(a.second_mask),
                }
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
                "pulse_max_s": guard.pulse_max_s,
                "rest_min_s": guard.rest_min_s,
                "duty_max": guard.duty_max,
                "duty_window_s": guard.duty_window_s,
                "limbs_at_once_max": guard.limbs_at_once_max,
            },
            "period_s": robot.period_s,
            "pulse_s": robot.pulse_s,
        }

    def _limb_names(self, mask: int) -> list[str]:
        return [limb.name for i, limb in enumerate(self.robot.limbs) if mask >> i & 1]

    def __repr__(self) -> str:
        return (
            f"Description({self.robot.id!r}: {len(self.rods.mesh.rest_m)} nodes, "
            f"{len(self.warnings)} warnings)"
        )


def describe(robot: Robot | str) -> Description:
    """Say what a robot is.

    Args:
        robot: it, or its name or TOML file.

    Raises:
        InputError: no such robot, or one that cannot be simulated.
    """
    described = load_robot(robot)
    return Description(described, prepare(described), tuple(robot_warnings(described)))


def write_new_robot(file: Path, base: Robot | str = "frog2022", limbs: int | None = None) -> Robot:
    """Write a robot file to begin with: all keys of another robot, a comment on each; and read it.

    Args:
        file: TOML file to write, not one that is there; its name without ending is the robot's id.
        base: the robot to begin from, or its name or TOML file. Its effects do not come along.
        limbs: the first so many of its limbs, and the actions that these can do; None: all.

    Raises:
        InputError: no such base, not so many limbs, a name that is no id, or the file cannot be written.
    """
    require_writable(file)
    if file.exists():
        raise InputError(f"{str(file)!r} is there already: name a new file, or take that one away")
    text = new_robot_text(load_robot(base), file.stem, limbs)
    robot = parse_robot(text, str(file), file.parent)
    write_text(file, text)
    return robot


@dataclass(frozen=True, eq=False, repr=False)
class FittedStrokes:
    """Measured strokes and the profiles that were fitted to them.

    Attributes:
        strokes: as measured.
        profiles: of each.
    """

    strokes: Sequence[Stroke]
    profiles: Sequence[Profile]

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``robot fit-stroke``: of each stroke its fit and what that misses."""
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
        """A matplotlib figure: each stroke as measured, and its fit."""
        from frogkick.report.stroke_figure import stroke_figure

        return stroke_figure(self.strokes, self.profiles)

    def save(self, file: Path | str) -> None:
        """Write them as the TOML file that a robot's ``profiles_file`` names.

        Raises:
            InputError: the file cannot be written.
        """
        write_profiles(list(self.profiles), file, ", ".join(stroke.name for stroke in self.strokes))


def fit_strokes(
    files: Sequence[Path | str],
    *,
    egain_percent: float = 0.0,
    frequency_hz: float | None = None,
    length_m: float | None = None,
) -> FittedStrokes:
    """Fit limb profiles to measured strokes, a CSV file for each frequency.

    Args:
        files: columns ``time_s,curvature_per_m``, or ``time_s,tip_x_m,tip_y_m`` of the tip seen from the
            root, x along the limb's tangent there; one cycle from the pulse's beginning on.
        egain_percent: of the limb's alloy.
        frequency_hz: strokes a second; None: of each file one over its last time.
        length_m: of the limb, where the tip was tracked.

    Raises:
        InputError: a file that holds no stroke, or two of one frequency.
    """
    strokes = [read_stroke(file, length_m) for file in files]
    profiles = [fit_stroke(stroke, egain_percent, frequency_hz) for stroke in strokes]
    order = sorted(range(len(strokes)), key=lambda index: profiles[index].frequency_hz)
    for one, other in itertools.pairwise(order):
        if profiles[one].frequency_hz == profiles[other].frequency_hz:
            raise InputError(
                f"stroke files {strokes[one].name!r} and {strokes[other].name!r} are both at "
                f"{profiles[one].frequency_hz:g} Hz: give one file for each frequency"
            )
    return FittedStrokes([strokes[k] for k in order], [profiles[k] for k in order])
