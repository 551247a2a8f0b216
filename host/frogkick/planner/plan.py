"""Plan on the host with the bits of the robot: one decision, or many for comparison."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from frogkick.errors import FrogkickError, InputError
from frogkick.planner import kernel
from frogkick.planner.image import Tables

Float32 = npt.NDArray[np.float32]

PLAN_ROW = np.dtype(
    [
        ("status", "<i4"),
        ("action", "<i4"),
        ("nearest_state", "<i4"),
        ("path_index", "<i4"),
        ("cost", "<f4"),
        ("predicted", "<f4", (6,)),
    ]
)
"""One decision: status (0 or a negative fk_error_t), then fk_plan_t; all zero where the status is not 0."""

STATUS_TEXT = {
    kernel.ERROR_NOT_FINITE: "the state holds NaN or infinity: check the position fixes",
    kernel.ERROR_RANGE: "the state is beyond +-1000 m or +-1000 rad: check the position fixes",
    kernel.ERROR_DEPTH: "the depth is not 1 to 4: choose --depth 1 to 4",
    kernel.ERROR_WEIGHT: "a cost weight is not 0 to 1e6: correct the robot's planner section",
    kernel.ERROR_PATH_COUNT: "the path has not 2 to 100 points: resample it",
    kernel.ERROR_PATH_POINT: "a path point is not within +-1000 m, or a tangent within 1000 rad: mend it",
}


class PlanError(FrogkickError):
    """No decision is possible; ``status`` is the negative fk_error_t that the robot gives likewise."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class PathLike(Protocol):
    """A path, world frame: three float32 arrays of one length (frogkick.paths.Path is one)."""

    @property
    def x_m(self) -> Float32: ...
    @property
    def y_m(self) -> Float32: ...
    @property
    def tangent_rad(self) -> Float32: ...


@dataclass(frozen=True)
class PlanConfig:
    """Cost weights and depth; the defaults are the paper's.

    Attributes:
        distance_weight_per_m: times the distance to the nearest path point, 0 to 1e6.
        angle_weight_per_rad: times the angle between heading and the tangent there, 0 to 1e6.
        progress_weight: times the part of the path that is left there, 0 to 1e6.
        level_weight: a level's cost is multiplied by 1 + level_weight * levels below it, 0 to 1e6.
        depth: levels to look ahead, 1 to 4.
    """

    distance_weight_per_m: float = 500.0
    angle_weight_per_rad: float = 50.0
    progress_weight: float = 300.0
    level_weight: float = 0.3
    depth: int = 1

    def weights(self) -> Float32:
        """Return the four weights as float32, in the order of the fields."""
        return np.array(
            [self.distance_weight_per_m, self.angle_weight_per_rad, self.progress_weight, self.level_weight],
            dtype=np.float32,
        )


@dataclass(frozen=True)
class Plan:
    """A decision.

    Attributes:
        action: index into the table's actions.
        nearest_state: row of the table nearest to the state's velocity.
        path_index: path point nearest to the state's position.
        cost: float32 sum over the best branch.
        predicted: (6,) float32 state after the first action: pose world, velocity body.
    """

    action: int
    nearest_state: int
    path_index: int
    cost: np.float32
    predicted: Float32


def plan(tables: Tables, path: PathLike, config: PlanConfig, state: npt.ArrayLike) -> Plan:
    """Choose the next action (the paper's Algorithm 1 with a fixed per-axis metric).

    Args:
        tables: an opened table image.
        path: 2 to 100 points, world frame.
        config: weights and depth.
        state: (6,) x m, y m, heading rad (world), vx m/s, vy m/s, omega rad/s (body); used as float32.

    Raises:
        PlanError: the state, path or configuration allows no decision; it carries the robot's status.

    Source: Huang et al. 2022, Algorithm 1, Eq. 19.
    """
    query = _float32(state).reshape(-1)
    row = plan_batch(tables, path, config, query[np.newaxis, :], np.array([config.depth]))[0]
    status = int(row["status"])
    if status != kernel.OK:
        raise PlanError(
            status, f"no plan from state {query.tolist()} (status {status}): {STATUS_TEXT[status]}"
        )
    return Plan(
        action=int(row["action"]),
        nearest_state=int(row["nearest_state"]),
        path_index=int(row["path_index"]),
        cost=np.float32(row["cost"]),
        predicted=np.array(row["predicted"], dtype=np.float32),
    )


def plan_batch(
    tables: Tables,
    path: PathLike,
    config: PlanConfig,
    states: npt.ArrayLike,
    depths: npt.ArrayLike | None = None,
) -> npt.NDArray[Any]:
    """Plan from many states.

    Args:
        tables, path, config: as for ``plan``.
        states: (k, 6) states.
        depths: (k,) depth of each; ``config.depth`` for all where it is None.

    Returns:
        (k,) array of ``PLAN_ROW``; a state without a decision has its status there.

    Raises:
        InputError: the arrays' shapes do not fit each other.
    """
    queries = _float32(states)
    if queries.ndim != 2 or queries.shape[1] != 6:
        raise InputError(f"states have shape {queries.shape}, needed is (k, 6): pass one row for each state")
    many = np.full(len(queries), config.depth) if depths is None else np.asarray(depths)
    if many.shape != (len(queries),):
        raise InputError(
            f"depths have shape {many.shape}, needed is ({len(queries)},): pass one for each state"
        )
    numbers = np.zeros((len(queries), 4), dtype=np.int32)
    values = np.zeros((len(queries), 7), dtype=np.float32)
    kernel.plan_many(
        tables.states,
        tables.transitions,
        tables.velocity_scale,
        tables.motion_scale,
        path_rows(path),
        config.weights(),
        many.astype(np.int64),
        queries,
        numbers,
        values,
    )
    rows = np.zeros(len(queries), dtype=PLAN_ROW)
    for column, name in enumerate(("status", "action", "nearest_state", "path_index")):
        rows[name] = numbers[:, column]
    rows["cost"] = values[:, 0]
    rows["predicted"] = values[:, 1:]
    return rows


def path_rows(path: PathLike) -> Float32:
    """Return a path as one (3, n) float32 array: x m, y m, tangent rad.

    Raises:
        InputError: the three arrays have different lengths.
    """
    columns = [_float32(column).reshape(-1) for column in (path.x_m, path.y_m, path.tangent_rad)]
    if len({len(column) for column in columns}) != 1:
        lengths = [len(column) for column in columns]
        raise InputError(f"path has {lengths} x, y and tangent values: give one of each for every point")
    return np.ascontiguousarray(np.stack(columns))


def _float32(values: npt.ArrayLike) -> Float32:
    with np.errstate(over="ignore"):  # a value beyond float32 becomes infinite, and that has its own status
        return np.ascontiguousarray(values, dtype=np.float32)
