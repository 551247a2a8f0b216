"""What a viewer shows of a run while it runs: path, fixes, track, the planner's fan and its chosen branch."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frogkick.loop.closed_loop import Recording
from frogkick.loop.decision import Decision
from frogkick.paths import Path
from frogkick.planner import lookup
from frogkick.planner.image import Tables
from frogkick.planner.layout import LIMBS_MAX
from frogkick.planner.plan import PlanConfig, PlanError, plan

FloatArray = NDArray[np.float64]

FIXES_SHOWN = 600
DECISIONS_SHOWN = 60


def fan_of(tables: Tables, state: NDArray[np.float32], limb_use: tuple[int, ...]) -> FloatArray:
    """(actions, 3) poses in the world after each action from a state, as the table tells them."""
    arrays = lookup.arrays_of(tables)
    dynamics = np.zeros(lookup.DYNAMICS, dtype=np.int64)
    for axis in range(3):
        per_velocity = np.float32(1) / tables.velocity_scale[axis]
        dynamics[axis] = lookup.velocity_code(np.float32(state[3 + axis]), per_velocity)
    dynamics[3:] = limb_use
    row = lookup.find_row(arrays, dynamics)
    x, y, heading = (float(value) for value in state[:3])
    c, s = np.cos(heading), np.sin(heading)
    motion, poses = np.zeros(3, dtype=np.float32), []
    for action in range(len(tables.actions)):
        lookup.motion_of(arrays, row, dynamics, action, motion)
        forward, left, turn = (float(value) for value in motion)
        poses.append((x + c * forward - s * left, y + s * forward + c * left, heading + turn))
    return np.array(poses)


def branch_of(
    tables: Tables, path: Path, config: PlanConfig, decision: Decision
) -> tuple[list[list[float]], str]:
    """Where the chosen branch leads: its poses, and its actions' names.

    The first action is the decision's; each further one what the planner chooses from there with what is left
    of its depth.
    """
    poses = [decision.estimate[:3].tolist(), decision.predicted[:3].tolist()]
    names = [tables.actions[decision.action].name]
    state: NDArray[np.float32] = decision.predicted
    use: NDArray[Any] = _used(tables, decision)
    for depth in range(config.depth - 1, 0, -1):
        try:
            told = plan(tables, path, replace(config, depth=depth), state, limb_use=use)
        except PlanError:
            break
        poses.append(told.predicted[:3].tolist())
        names.append(tables.actions[told.action].name)
        state, use = told.predicted, told.predicted_limb_use
    return poses, "".join(names)


def _used(tables: Tables, decision: Decision) -> NDArray[np.int64]:
    after = np.zeros(LIMBS_MAX, dtype=np.int64)
    before = np.array(decision.limb_use, dtype=np.int64)
    lookup.limb_use_after(lookup.arrays_of(tables), before, decision.action, after)
    return after


@dataclass
class LiveView:
    """The run as JSON, renewed as it goes on; what a page asks for, from another thread.

    Attributes:
        tables, path, config: of the run.
        text: the newest state.
    """

    tables: Tables
    path: Path
    config: PlanConfig
    text: str = "{}"
    _decisions: int = -1
    _planned: dict[str, Any] = field(default_factory=dict)

    def show(self, recording: Recording, track: FloatArray | None = None) -> None:
        """Take what is recorded so far, and in a simulated pool (n, 3) where the robot really was."""
        if len(recording.decisions) != self._decisions:
            self._decisions = len(recording.decisions)
            self._planned = self._plan(recording)
        fixes = np.array([fix.pose_world for fix in recording.fixes[-FIXES_SHOWN:]]).reshape(-1, 3)
        newest = recording.fixes[-1] if recording.fixes else None
        self.text = json.dumps(
            {
                "path": np.round(self.path.points_m, 4).tolist(),
                "fixes": np.round(fixes, 4).tolist(),
                "track": [] if track is None else np.round(track[-4 * FIXES_SHOWN :], 4).tolist(),
                "fix_age_s": None if newest is None else round(newest.arrival_s - newest.capture_s, 3),
                "ended": recording.ended,
                **self._planned,
            }
        )

    def _plan(self, recording: Recording) -> dict[str, Any]:
        planned = [one for one in recording.decisions if one.status == 0]
        letters = [
            [*np.round(one.estimate[:2], 4).tolist(), self.tables.actions[one.action].name]
            for one in planned[-DECISIONS_SHOWN:]
        ]
        if not planned or planned[-1].action >= len(self.tables.actions):
            return {"decisions": letters, "fan": [], "branch": [], "actions": "", "cost": None}
        last = planned[-1]
        branch, names = branch_of(self.tables, self.path, self.config, last)
        fan = fan_of(self.tables, last.estimate, last.limb_use)
        return {
            "decisions": letters,
            "fan": np.round(fan, 4).tolist(),
            "branch": np.round(np.array(branch), 4).tolist(),
            "actions": names,
            "cost": round(float(last.cost), 3),
            "distance_mm": round(1e3 * float(last.distance_m), 1),
            "plan_ms": round(1e-3 * last.plan_us, 2),
        }
