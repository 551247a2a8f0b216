"""What a robot is, in numbers: its limbs, actions, sizes and limits, and what is doubtful about them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.der import Rods, prepare
from frogkick.errors import InputError
from frogkick.files import require_writable, write_text
from frogkick.robot import Robot, load_robot, parse_robot, robot_warnings
from frogkick.robot.template import new_robot_text

__all__ = ["Description", "describe", "write_new_robot"]


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
    described = robot if isinstance(robot, Robot) else load_robot(robot)
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
    text = new_robot_text(base if isinstance(base, Robot) else load_robot(base), file.stem, limbs)
    robot = parse_robot(text, str(file), file.parent)
    write_text(file, text)
    return robot
