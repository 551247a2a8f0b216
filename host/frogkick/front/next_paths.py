"""``run --then``: paths that take over during a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from frogkick.core.errors import InputError
from frogkick.front.places import swim_path
from frogkick.paths import Path as SwimPath
from frogkick.runs.path_change import NextPath
from frogkick.runs.runlog import RunLog

HERE = "here"

Then = str | tuple[Any, ...]
"""A path that takes over: ``PATH@SECONDS[@here]``, (path, s) or (path, s, "here")."""


def next_paths(then: Then | Sequence[Then], time_limit_s: float) -> tuple[NextPath, ...]:
    """Return the paths that take over during a run, in the order of their times.

    Args:
        then: one or several.
        time_limit_s: of the run.

    Raises:
        InputError: no such path, no such time, times that do not grow, or one at which the run is over.
    """
    asked = [then] if isinstance(then, str | tuple) and not _is_many(then) else list(then)
    found: list[NextPath] = []
    for one in asked:
        following = _next_path(one)
        if following.at_s >= time_limit_s:
            raise InputError(
                f"--then {_text(one)}: the run ends after {time_limit_s:g} s: give an earlier time, or a "
                "longer --simulated-time"
            )
        if found and following.at_s <= found[-1].at_s:
            raise InputError(
                f"--then {_text(one)}: the path before it takes over at {found[-1].at_s:g} s: give later "
                "times in turn"
            )
        found.append(following)
    return tuple(found)


def _is_many(then: Then | Sequence[Then]) -> bool:
    return isinstance(then, tuple) and all(isinstance(one, tuple) or "@" in str(one) for one in then)


def _next_path(one: Any) -> NextPath:
    parts: list[Any] = []
    if isinstance(one, str):
        text = one.removesuffix(f"@{HERE}")
        parts = [*text.rpartition("@")[::2], *([HERE] if text != one else [])]
    elif isinstance(one, Sequence):
        parts = list(one)
    if len(parts) not in (2, 3) or parts[0] == "" or (len(parts) == 3 and parts[2] != HERE):
        raise InputError(
            f"--then is {_text(one)}: give PATH@SECONDS, and @here behind it for a path that begins "
            "where the robot then is"
        )
    try:
        at_s = float(parts[1])
    except (TypeError, ValueError):
        at_s = math.nan
    if not 0.0 <= at_s < math.inf:
        raise InputError(
            f"--then {_text(one)}: {parts[1]!r} is no time: give PATH@SECONDS, seconds since the first "
            "decision"
        )
    return NextPath(swim_path(parts[0]), at_s, len(parts) == 3)


def _text(one: Any) -> str:
    if isinstance(one, tuple):
        return "@".join(part.name if isinstance(part, SwimPath) else str(part) for part in one)
    return repr(one)


def then_json(run: RunLog) -> list[dict[str, Any]]:
    """The paths that took over, each with its first decision's time since the run's first decision.

    Those that hold at an end are left out: the host makes them.
    """
    times_s = run.decisions.time_s
    return [
        {"path": change.path.name, "from_s": round(float(times_s[change.decision] - times_s[0]), 6)}
        for change in run.then
        if change.hold is None
    ]


def not_reached(planned: int, run: RunLog) -> str:
    """A sentence on paths that a run ended before; "" where there are none."""
    made = len(then_json(run))
    if planned <= made:
        return ""
    reached = f"{made} of {planned} paths of --then took over"
    return f"{reached}: the run had ended before the others ({run.notes}); give earlier times"
