"""The state of a run for the viewer: path, fixes, track, and the planner's search tree."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from frogkick.core.arrays import AnyArray, Float32, Float64
from frogkick.core.poses import Fix, compose, rotation
from frogkick.paths import Path
from frogkick.planner import lookup
from frogkick.planner.plan import PlanConfig, PlanError, plan
from frogkick.robot import in_a_row
from frogkick.runs.decision import Decision, lost_text
from frogkick.runs.record import Recording
from frogkick.runs.runlog import RunLog
from frogkick.runs.tracked_fixes import CameraView
from frogkick.tables.image import Tables
from frogkick.tables.layout import LIMBS_MAX

FIXES_SHOWN, TRACK_SHOWN, DECISIONS_SHOWN = 600, 2400, 60
"""The largest number of fixes, true poses and decisions that are drawn: the newest ones."""


def fan_of(tables: Tables, state: Float32, limb_use: tuple[int, ...]) -> Float64:
    """(actions, 3) predicted world poses after each action from a state."""
    arrays = lookup.arrays_of(tables)
    dynamics = np.zeros(lookup.DYNAMICS, dtype=np.int64)
    for axis in range(3):
        per_velocity = np.float32(1) / tables.velocity_scale[axis]
        dynamics[axis] = lookup.velocity_code(np.float32(state[3 + axis]), per_velocity)
    dynamics[3:] = limb_use
    row = lookup.find_row(arrays, dynamics)
    motions = np.zeros((len(tables.actions), 3), dtype=np.float32)
    for action, motion in enumerate(motions):
        lookup.motion_of(arrays, row, dynamics, action, motion)
    return compose(np.asarray(state[:3], dtype=np.float64), motions.astype(np.float64))


@dataclass(frozen=True)
class Tree:
    """The search tree along the chosen branch."""

    branch: list[list[float]]  # poses from the estimate on, one more than the branch has actions
    fans: list[Float64]  # for each pose but the last, (actions, 3) predicted poses after every action
    names: str  # of the branch's actions


def tree_of(tables: Tables, path: Path, config: PlanConfig, decision: Decision) -> Tree:
    """Search tree of a decision. Each further action is planned again with the remaining depth."""
    branch = [decision.estimate[:3].tolist(), decision.predicted[:3].tolist()]
    fans = [fan_of(tables, decision.estimate, decision.limb_use)]
    names = [tables.actions[decision.action].name]
    state: Float32 = decision.predicted
    use: AnyArray = np.zeros(LIMBS_MAX, dtype=np.int64)
    before = np.array(decision.limb_use, dtype=np.int64)
    lookup.limb_use_after(lookup.arrays_of(tables), before, decision.action, use)
    for depth in range(config.depth - 1, 0, -1):
        try:
            made = plan(tables, path, replace(config, depth=depth), state, limb_use=use)
        except PlanError:
            break
        branch.append(made.predicted[:3].tolist())
        fans.append(fan_of(tables, state, tuple(int(count) for count in use)))
        names.append(tables.actions[made.action].name)
        state, use = made.predicted, made.predicted_limb_use
    return Tree(branch, fans, in_a_row(names))


@dataclass
class LiveView:
    """The state of a run as JSON; another thread serves ``text`` to a page."""

    outline_m: Sequence[tuple[float, float]]  # (n)(2) outline of the robot, body frame
    camera: CameraView | None = None  # where its pictures are shown; the state is given in their pixels too
    text: str = "{}"  # the newest state
    path: Path | None = None  # the path that is followed now
    _decisions: int = -1
    _drawn: dict[str, Sequence[Any]] = field(default_factory=dict)
    _labels: dict[str, Any] = field(default_factory=dict)

    def show(self, recording: Recording) -> None:
        """Show a run so far."""
        if len(recording.decisions) != self._decisions:
            self._decisions = len(recording.decisions)
            self.path = recording.then[-1].path if recording.then else recording.path
            self._plan(recording, self.path)
        truth = [] if recording.pool is None else recording.pool.truth.pose_world[-TRACK_SHOWN:]
        self.show_fixes(recording.fixes, np.array(truth).reshape(-1, 3), recording.ended)

    def show_fixes(self, fixes: Sequence[Fix], track: Float64 | None = None, ended: str = "") -> None:
        """Show fixes, the (n, 3) true poses of a simulated pool, and why a run ended."""
        poses = np.array([fix.pose_world for fix in fixes[-FIXES_SHOWN:]]).reshape(-1, 3)
        self._write(
            poses, np.zeros((0, 3)) if track is None else track, fixes[-1].delay_s if fixes else None, ended
        )

    def show_log(self, run: RunLog, time_s: float) -> None:
        """Show a log up to a time."""
        followed = [path for from_s, path in run.paths if from_s <= time_s]
        self.path = followed[-1] if followed else None
        seen = run.fixes.usable & (run.fixes.time_s <= time_s)
        fixes = run.fixes.pose_world[seen]
        ages_s = (run.fixes.time_s - run.fixes.capture_time_s)[seen]
        track = np.zeros((0, 3)) if run.truth is None else run.truth.pose_world[run.truth.time_s <= time_s]
        decisions, made = run.decisions, int((run.decisions.time_s <= time_s).sum())
        some = np.arange(max(0, made - DECISIONS_SHOWN), made)
        # A decision is drawn at its estimate, or without one at the newest fix; NaN where there is none.
        newest = np.searchsorted(run.fixes.time_s[seen], decisions.time_s[some], "right") - 1
        places = np.vstack([fixes, np.full(3, np.nan)])[newest]
        if decisions.estimate is not None:
            places = decisions.estimate[some, :3]
        known = np.isfinite(places).all(axis=1)
        ends = [rows[some[-1:], :3] for rows in (decisions.estimate, decisions.predicted) if rows is not None]
        branch = ends if len(ends) == 2 and np.isfinite(ends).all() else []
        names = run.decided()[:made]
        self._drawn = {"decisions": places[known].tolist(), "fan": [], "branch": branch}
        self._labels = {"letters": [names[k] for k in some[known]], "actions": names[-1] if names else ""}
        if made and decisions.cost is not None and np.isfinite(decisions.cost[made - 1]):
            self._labels["cost"] = round(float(decisions.cost[made - 1]), 3)
        is_over = time_s >= max(run.fixes.time_s.max(initial=0.0), decisions.time_s.max(initial=0.0))
        age_s = float(ages_s[-1]) if len(ages_s) and np.isfinite(ages_s[-1]) else None
        self._write(fixes, track, age_s, (run.notes or "so far was recorded") if is_over else "")

    def _write(self, fixes: Float64, track: Float64, age_s: float | None, ended: str) -> None:
        """Write the state with (n, 3) fixes and (m, 3) true poses."""
        fixes, track = fixes[-FIXES_SHOWN:], track[-TRACK_SHOWN:]
        state = {
            "path": np.zeros((0, 2)) if self.path is None else self.path.points_m,
            "fixes": fixes,
            "track": track,
            "robot": self._outline(track if len(track) else fixes),
            **{name: np.array(rows, dtype=np.float64).reshape(-1, 3) for name, rows in self._drawn.items()},
        }
        values: dict[str, Any] = {
            **{name: np.round(rows, 4).tolist() for name, rows in state.items()},
            "camera": None,
            "fix_age_s": None if age_s is None else round(age_s, 3),
            "ended": ended,
            **self._labels,
        }
        if self.camera is not None:
            seen = {name: self.camera.pixels(rows[:, :2]) for name, rows in state.items()}
            pixels = {name: np.round(rows, 1).tolist() for name, rows in seen.items()}
            values["camera"] = {"size": self.camera.size_px, **pixels}
        self.text = json.dumps(values)

    def _outline(self, poses: Float64) -> Float64:
        """(n + 2, 2) outline, centre and foremost point of the robot at the last of (m, 3) poses."""
        if not len(poses) or not len(self.outline_m):
            return np.zeros((0, 2))
        corners = np.array(self.outline_m, dtype=np.float64)
        ends = np.vstack([corners, [[0.0, 0.0], [corners[:, 0].max(), 0.0]]])
        return np.asarray(poses[-1, :2] + ends @ rotation(poses[-1, 2]).T)

    def _plan(self, recording: Recording, path: Path) -> None:
        tables = recording.tables
        self._drawn = {"decisions": [], "fan": [], "branch": []}
        self._labels = {"letters": [], "actions": ""}
        last = [decision for decision in recording.decisions if decision.status == 0][-DECISIONS_SHOWN:]
        self._drawn["decisions"] = [decision.estimate[:3].tolist() for decision in last]
        self._labels["letters"] = [tables.actions[decision.action].name for decision in last]
        if not last or last[-1].action >= len(tables.actions):
            return
        newest = last[-1]
        tree = tree_of(tables.worn(newest.lost), path, recording.options.config, newest)
        self._drawn |= {"fan": np.vstack(tree.fans).tolist(), "branch": tree.branch}
        self._labels |= {
            "actions": tree.names,
            "cost": round(float(newest.cost), 3),
            "distance_mm": round(1e3 * float(newest.distance_m), 1),
            "plan_ms": round(1e-3 * newest.plan_us, 2),
            "lost": lost_text(newest.lost, [limb.name for limb in recording.robot.limbs]),
        }
