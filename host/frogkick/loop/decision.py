"""A decision: what the robot on board reports, and the same made on the host by the twins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frogkick.link.layout import Value, link_layout
from frogkick.paths import Path
from frogkick.planner.estimator import LOST_US, Estimator
from frogkick.planner.image import Tables
from frogkick.planner.plan import PlanConfig, PlanError, plan

STATE_FIELDS = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_rad_s")
STALE = link_layout().status["STALE"]


@dataclass(frozen=True, eq=False)
class Decision:
    """One decision, the same fields wherever it was made.

    Attributes:
        status: 0, or why the action is the resting one (``frames.toml``).
        action: index in the table's actions.
        scheduled_us: decision time on the robot's clock.
        fix_sequence, fixes: newest fix in the estimate and number of fixes in it.
        path_index: nearest path point of the estimate.
        nearest_state: row of the table.
        cost: float32 of the best branch.
        estimate, predicted: (6,) float32; pose world, velocity body; now and after the action.
        plan_us: computing time, where it was measured.
    """

    status: int
    action: int
    scheduled_us: int
    fix_sequence: int
    fixes: int
    path_index: int
    nearest_state: int
    cost: np.float32
    estimate: npt.NDArray[np.float32]
    predicted: npt.NDArray[np.float32]
    plan_us: int = 0

    def differences(self, other: Decision) -> list[str]:
        """Names of the fields that differ in any bit; computing time does not count."""
        names = [
            "status", "action", "scheduled_us", "fix_sequence", "fixes", "path_index", "nearest_state",
        ]  # fmt: skip
        differing = [name for name in names if getattr(self, name) != getattr(other, name)]
        for name in ("cost", "estimate", "predicted"):
            mine, theirs = np.float32(getattr(self, name)), np.float32(getattr(other, name))
            if mine.tobytes() != theirs.tobytes():
                differing.append(name)
        return differing


@dataclass(frozen=True)
class RobotEvent:
    """What the robot met, in its order: a fix it took (with its pose), or a decision (without).

    Attributes:
        time_us: capture time or decision time, robot's clock.
        pose_world: (3,) float32 of a fix, None for a decision.
        sequence: number of the fix.
    """

    time_us: int
    pose_world: npt.NDArray[np.float32] | None = None
    sequence: int = 0


def decision_of_event(values: dict[str, Value]) -> Decision:
    """The decision that a DECISION event carries."""

    def state(prefix: str) -> npt.NDArray[np.float32]:
        return np.array([values[prefix + name] for name in STATE_FIELDS], dtype=np.float32)

    return Decision(
        status=int(values["status"]),
        action=int(values["action"]),
        scheduled_us=int(values["scheduled_us"]),
        fix_sequence=int(values["fix_sequence"]),
        fixes=int(values["fixes_in_estimate"]),
        path_index=int(values["path_index"]),
        nearest_state=int(values["nearest_state"]),
        cost=np.float32(values["cost"]),
        estimate=state(""),
        predicted=state("predicted_"),
        plan_us=int(values["plan_us"]),
    )


class DecisionTwin:
    """Estimator and planner on the host, deciding as the robot on board would."""

    def __init__(self, tables: Tables, path: Path, config: PlanConfig) -> None:
        self._tables = tables
        self._path = path
        self._config = config
        self._estimator = Estimator()
        resting = (i for i, row in enumerate(tables.actions) if not row.first_mask and not row.second_mask)
        self._resting_action = next(resting, len(tables.actions))

    def add_fix(self, capture_us: int, pose_world: npt.NDArray[np.float32], sequence: int) -> bool:
        """Take a fix; False where it is refused (see ``Estimator.add``)."""
        return self._estimator.add(capture_us, pose_world, sequence)

    def is_lost(self, at_us: int) -> bool:
        """No fix for so long that the robot on board would disarm."""
        newest_us = self._estimator.newest_capture_us
        return newest_us is None or at_us - newest_us > LOST_US

    def is_completed(self, decision: Decision) -> bool:
        """The estimate has the path's last point as its nearest one."""
        return decision.status == 0 and decision.path_index + 1 >= len(self._path)

    def decide(self, at_us: int) -> Decision:
        """Estimate and plan for a time on the clock of the fixes."""
        nowhere = np.zeros(6, dtype=np.float32)
        estimate = self._estimator.at(at_us)
        if estimate is None:
            return Decision(STALE, self._resting_action, at_us, 0, 0, 0, 0, np.float32(0.0), nowhere, nowhere)
        try:
            made = plan(self._tables, self._path, self._config, estimate.state)
        except PlanError as error:
            return Decision(
                error.status, self._resting_action, at_us, estimate.fix_sequence, estimate.fixes, 0, 0,
                np.float32(0.0), estimate.state, nowhere,
            )  # fmt: skip
        return Decision(
            status=0,
            action=made.action,
            scheduled_us=at_us,
            fix_sequence=estimate.fix_sequence,
            fixes=estimate.fixes,
            path_index=made.path_index,
            nearest_state=made.nearest_state,
            cost=made.cost,
            estimate=estimate.state,
            predicted=made.predicted,
        )
