"""Planning over the link: PLAN frames to a robot, as one of the places that parity compares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from frogkick.link.layout import Value
from frogkick.loop.closed_loop import parameters
from frogkick.loop.decision import STATE_FIELDS
from frogkick.loop.session import Session
from frogkick.paths import Path
from frogkick.planner.image import Tables
from frogkick.planner.plan import PLAN_ROW, PlanConfig
from frogkick.pool.port import RobotPort


def plan_over_link(
    port: RobotPort,
    tables: Tables,
    path: Path,
    config: PlanConfig,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Callable[[npt.NDArray[np.float32], npt.NDArray[np.int32]], npt.NDArray[Any]]:
    """A function that lets a robot plan for each state.

    Args:
        port: the robot.
        tables: its tables.
        path, config: what it plans with.
        progress: called with states done and to do.

    Returns:
        states (k, 6) float32, depths (k,) int32 -> (k,) rows of ``PLAN_ROW``.

    Raises:
        LinkError: the robot refuses path or parameters, or does not answer.
    """
    session = Session(port)
    session.greet(tables)
    session.set_parameters(parameters(config))
    session.send_path(path)

    def place(states: npt.NDArray[np.float32], depths: npt.NDArray[np.int32]) -> npt.NDArray[Any]:
        rows = np.zeros(len(states), dtype=PLAN_ROW)
        for index, (state, depth) in enumerate(zip(states, depths, strict=True)):
            values: dict[str, Value] = {"depth": int(depth)}
            values |= {name: float(value) for name, value in zip(STATE_FIELDS, state, strict=True)}
            answer = session.ask("PLAN", values)
            rows[index]["status"] = answer["status"]
            if answer["status"] == 0:
                for name in ("action", "nearest_state", "path_index", "cost"):
                    rows[index][name] = answer[name]
                rows[index]["predicted"] = [answer[name] for name in STATE_FIELDS]
            progress(index + 1, len(states))
        return rows

    return place
