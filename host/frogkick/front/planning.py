"""The planner on the host, which decides bit for bit as the robot does, one decision at a time."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from frogkick.core.arguments import typed
from frogkick.core.errors import InputError
from frogkick.front.places import plan_config, swim_path
from frogkick.front.tables import Table, load_table
from frogkick.paths import Path as SwimPath
from frogkick.planner.kernel import LIMB_USE_MAX
from frogkick.planner.plan import PlanError, plan
from frogkick.tables.layout import LIMBS_MAX

HEADING_MAX_RAD = 4.0 * np.pi


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """A decision and what may follow it.

    Attributes:
        action: name of the action to do now.
        cost: cost of the branch, as the robot computes it (float32).
        actions: ``action``, then what the planner chooses from each predicted pose with the depth that is
            left.
        predicted_pose: (depth, 3) x, y (m), heading (rad), world frame, after each of these actions.
        distance_m: distance of the state from the path.
        along_points: position of the state along the path, in points; pass it to the next call.
    """

    action: str
    cost: float
    actions: tuple[str, ...]
    predicted_pose: NDArray[np.float32]
    distance_m: float
    along_points: float

    def __repr__(self) -> str:
        return f"Plan({self.action}: {' '.join(self.actions)}, cost {self.cost:.2f})"


@typed
class Planner:
    """Receding-horizon planner over a table, with the same bits as the C code on the robot.

    The search is a depth-limited branch and bound; with the route cost, depths 3 and 4 are a beam search that
    looks four periods further.

    Source: Huang et al. 2022, Algorithm 1.
    """

    def __init__(self, table: Table | Path | str, depth: int | None = None, planner: str = "robot") -> None:
        """Prepare to plan.

        Args:
            table: the robot's table or its file.
            depth: of the planner's search, 1 to 4; None: the planner's own.
            planner: planner whose weights are used: "robot" (its TOML file) or "paper".

        Raises:
            InputError: the depth is not 1 to 4.
        """
        self.table = load_table(table)
        self.config = plan_config(self.table.robot, planner, depth)

    def plan(
        self,
        state: ArrayLike,
        path: SwimPath | str,
        *,
        limb_use: ArrayLike | None = None,
        along_points: float = 0.0,
    ) -> Plan:
        """Choose the next action.

        Args:
            state: (6,) x, y (m), heading (rad) in the world frame; forward, left (m/s), turn rate (rad/s) in
                the body frame.
            path: the desired path in the world frame, a shape's name or a path file.
            limb_use: (8,) recent use of each limb, 0 = rested to 32767; None: all rested.
            along_points: last position of the robot along the path, in points; 0 at the start.

        Raises:
            InputError: a state of other than six numbers, or limb uses or a position that cannot be.
            PlanError: the state allows no decision.
        """
        if np.shape(state) != (6,) or np.iscomplexobj(state):
            raise InputError(
                f"state is {state!r}: give six numbers, x, y (m), heading (rad), forward, left (m/s), "
                "turn rate (rad/s)"
            )
        heading = np.asarray(state)[2]  # other than a number it is refused below
        heading_rad = float(heading) if isinstance(heading, np.number) else 0.0
        if HEADING_MAX_RAD < abs(heading_rad) < np.inf:
            raise InputError(
                f"the heading of the state is {heading_rad:g} rad, which is more than two turns: give "
                "radians, not degrees"
            )
        course = swim_path(path)
        _require_place(along_points, len(course.x_m) - 1)
        _require_limb_use(limb_use)
        tables = self.table.tables
        first = plan(tables, course, self.config, state, limb_use, along_points)
        names, poses = [tables.actions[first.action].name], [first.predicted[:3]]
        last = first
        # Each further level is the choice from there with the remaining depth.
        for depth in range(self.config.depth - 1, 0, -1):
            config = dataclasses.replace(self.config, depth=depth)
            try:
                last = plan(
                    tables, course, config, last.predicted, last.predicted_limb_use, float(last.along_points)
                )
            except PlanError:
                break
            names.append(tables.actions[last.action].name)
            poses.append(last.predicted[:3])
        return Plan(
            names[0],
            float(first.cost),
            tuple(names),
            np.array(poses, dtype=np.float32),
            float(first.distance_m),
            float(first.along_points),
        )

    def __repr__(self) -> str:
        return f"Planner(depth {self.config.depth}, {self.table!r})"


def _require_place(along_points: float, last: int) -> None:
    """Raise InputError for a position along a path that is none of its points or between two of them."""
    is_number = isinstance(along_points, int | float | np.integer | np.floating)
    if not is_number or not 0.0 <= float(along_points) <= last:
        raise InputError(
            f"along_points is {along_points!r}: give 0 to {last}, the points of the path counted from 0"
        )


def _require_limb_use(limb_use: ArrayLike | None) -> None:
    """Raise InputError for other than a use of each limb."""
    if limb_use is None:
        return
    if np.shape(limb_use) == (LIMBS_MAX,):
        given = np.asarray(limb_use)
        if given.dtype.kind in "iuf" and np.all((given >= 0) & (given <= LIMB_USE_MAX) & (given % 1 == 0)):
            return
    raise InputError(
        f"limb_use is {limb_use!r}: give {LIMBS_MAX} whole numbers, 0 (rested) to {LIMB_USE_MAX}, also for "
        "a robot of fewer limbs"
    )
