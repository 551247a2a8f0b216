"""Messages of a run in the terminal: progress, causes of a large distance, the log after an abort."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from frogkick.core.progress import Tell, tell_line
from frogkick.runs.decision import lost_text
from frogkick.runs.live_log import CUT_OFF, part_of
from frogkick.runs.record import CANNOT_FOLLOW, Recording
from frogkick.runs.runlog import RunLog, Tracking
from frogkick.runs.runlog_file import write_run
from frogkick.runs.summary import bends_of

SLOW_S = 2.0
FAR_M = 0.01
"""The cause is explained from this mean distance on."""


def lost_limb_advice(ended: str) -> str:
    """Advice if a run ended because a limb was lost; "" if it did not."""
    if not ended.startswith(CANNOT_FOLLOW):
        return ""
    return f"the robot {ended}: repair the limb, or give a path that turns the other way"


def tight_path_advice(log: RunLog, tracked: Tracking) -> str:
    """Return a sentence on a path that bends more sharply than the robot turned; "" if it does not."""
    bends = bends_of(log, tracked.progress_mps)
    if bends is None or tracked.mean_distance_m < FAR_M or not bends.too_tight:
        return ""
    asked_deg, turned_deg = math.degrees(bends.asked_rad), math.degrees(bends.turned_rad)
    larger = asked_deg / max(turned_deg, 1e-3)
    return (
        f"the path bends by up to {asked_deg:.0f} degrees in the {1e3 * bends.step_m:.0f} mm that the robot "
        f"moves in a period, and it turned by {turned_deg:.0f} degrees at most: it cannot follow such a "
        f"path; make it about {larger:.1f} times as large"
    )


class RunProgress:
    """Shows progress along the path, the action, the cost of its plan, and the distance to the path."""

    def __init__(self, tell: Tell, recording: Recording) -> None:
        """Show it with ``tell``, of a run that is to begin."""
        self._tell, self._recording, self._points = tell, recording, len(recording.path)

    @contextmanager
    def preparing(self) -> Iterator[None]:
        """Show a note while the simulation and the core are compiled, which takes long and is done once."""
        what = "preparing the simulation and the robot's core (compiled on first use)"
        slow = threading.Timer(SLOW_S, lambda: self._tell(0, self._points, what))
        slow.daemon = True
        slow.start()
        try:
            yield
        finally:
            slow.cancel()

    def progress(self, _time_s: float, index: int) -> None:
        """Show the state after a decision at the nearest path point."""
        recording, check = self._recording, self._recording.options.check
        if recording.then:
            self._points = len(recording.then[-1].path)
        limbs = [limb.name for limb in recording.robot.limbs]
        lost = lost_text(recording.decisions[-1].lost, limbs) if recording.decisions else ""
        notes = [self._plan(), lost, "" if check is None else check.text]
        self._tell(index + 1, self._points, ", ".join(note for note in notes if note))

    def _plan(self) -> str:
        if not self._recording.decisions:
            return ""
        newest, actions = self._recording.decisions[-1], self._recording.tables.actions
        if newest.status != 0 or newest.action >= len(actions):
            return "no plan"
        name = actions[newest.action].name
        return f"{name} cost {float(newest.cost):.1f}, {1e3 * float(newest.distance_m):.0f} mm off"


@contextmanager
def keeps_partial_log(out: Path | None, recording: Recording) -> Iterator[None]:
    """If a run breaks off, print where its log so far is; that of a simulated run is written only then."""
    try:
        yield
    except BaseException:
        if out is not None:
            is_new = recording.pool is not None and recording.end_s > 0.0
            if is_new:
                write_run(part_of(out), replace(recording.log(), notes=CUT_OFF))
            if is_new or (recording.pool is None and part_of(out).exists()):
                tell_line(f"frogkick: the recording so far is in {str(part_of(out))!r}")
        raise
