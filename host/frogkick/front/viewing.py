"""A run in progress, shown to its operator: messages in the terminal, and the drawing in the browser."""

from __future__ import annotations

import math
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from frogkick.core.errors import FrogkickError, InputError
from frogkick.core.poses import Fix
from frogkick.core.progress import Tell, tell_line
from frogkick.pool.pool import Pool
from frogkick.report.live_page import served
from frogkick.robot import load_robot, parse_robot
from frogkick.runs.decision import lost_text
from frogkick.runs.live_log import CUT_OFF, part_of
from frogkick.runs.live_view import FIXES_SHOWN, LiveView
from frogkick.runs.record import CANNOT_FOLLOW, Recording
from frogkick.runs.runlog import RunLog, Tracking
from frogkick.runs.runlog_file import write_run
from frogkick.runs.summary import bends_of
from frogkick.runs.tracked_fixes import CameraFixes, CameraView

EVERY_S = 0.1
LINGER_S = 0.5
"""Time after the end, so that the page reads the last state."""


@contextmanager
def viewed(
    wanted: bool,
    recording: Recording,
    camera: CameraFixes | None = None,
    stop: Callable[[], None] | None = None,
) -> Iterator[Callable[[Recording], None]]:
    """Yield the function that shows a growing recording; a simulated pool is slowed to real time.

    Unless it is ``wanted``, there is no page, and nothing is slowed. With a camera its pictures are shown,
    else the pool is drawn. ``stop`` is called from another thread when the page's button is pressed; None:
    there is no button.
    """
    if not wanted:
        yield lambda _recording: None
        return
    view = LiveView(recording.robot.frame.corners_m, None if camera is None else CameraView(camera))
    with _drawn(view, "the run", partial(view.show, recording), recording.pool, stop) as keep:
        yield lambda _recording: keep()


def played(run: RunLog, speed: float = 1.0) -> None:
    """Play a log, see ``Run.play``."""
    if not 0.0 < speed < math.inf:
        raise InputError(f"a log cannot be played at speed {speed:g}: give more than 0")
    times_s = np.concatenate([run.fixes.time_s, run.decisions.time_s])
    if not len(times_s):
        raise InputError(f"run {run.source!r} has neither fixes nor decisions: nothing to play")
    first_s, last_s = float(times_s.min()), float(times_s.max())
    looked, stopped = threading.Event(), threading.Event()
    view = LiveView(_outline_of(run))
    view.show_log(run, first_s)

    def text() -> str:
        looked.set()
        return view.text

    with served(text, None, stopped.set) as address, suppress(KeyboardInterrupt):
        tell_line(f"frogkick: the run is played at {address}")
        if sys.stderr.isatty():
            webbrowser.open(address)
        while not looked.wait(EVERY_S):
            pass
        begin_s, now_s = time.monotonic(), first_s
        while now_s < last_s and not stopped.wait(EVERY_S):
            now_s = first_s + speed * (time.monotonic() - begin_s)
            view.show_log(run, now_s)
        time.sleep(LINGER_S)


def _outline_of(run: RunLog) -> Sequence[tuple[float, float]]:
    """Return the frame's corners of a log's robot, from its own TOML text or by its name; else none."""
    try:
        text = run.made.get("robot_toml")
        return (load_robot(run.robot_id) if text is None else parse_robot(text, run.robot_id)).frame.corners_m
    except FrogkickError:
        return ()


@contextmanager
def camera_viewed(wanted: bool, camera: CameraFixes) -> Iterator[Callable[[Sequence[Fix]], None]]:
    """Yield the function that takes a camera's new fixes; they are shown in its pictures with the tag."""
    if not wanted:
        yield lambda _fixes: None
        return
    half_m = camera.calibration.tag.size_m / 2.0
    tag = [(half_m, half_m), (half_m, -half_m), (-half_m, -half_m), (-half_m, half_m)]
    view, seen = LiveView(tag, CameraView(camera)), list[Fix]()

    def take(fixes: Sequence[Fix]) -> None:
        nonlocal seen
        seen = [*seen, *fixes][-FIXES_SHOWN:]

    with _drawn(view, "what the camera sees", lambda: view.show_fixes(seen)):
        yield take


@contextmanager
def _drawn(
    view: LiveView,
    name: str,
    draw: Callable[[], None],
    pool: Pool | None = None,
    stop: Callable[[], None] | None = None,
) -> Iterator[Callable[[], None]]:
    """Yield the function that is called after each step; without a simulated pool a thread draws."""
    begin_s, shown_s = time.monotonic(), 0.0

    def keep() -> None:
        nonlocal shown_s
        if pool is not None:
            time.sleep(max(0.0, begin_s + pool.time_s - time.monotonic()))
        if pool is not None and time.monotonic() - shown_s >= EVERY_S:
            draw()
            shown_s = time.monotonic()

    over = threading.Event()

    def draw_on() -> None:
        # A real robot's fixes do not wait for a picture.
        while not over.wait(EVERY_S):
            draw()

    drawing = threading.Thread(target=draw_on, name="view", daemon=True)
    with served(lambda: view.text, None if view.camera is None else view.camera.picture, stop) as address:
        tell_line(f"frogkick: {name} is drawn at {address}")
        if sys.stderr.isatty():
            webbrowser.open(address)
        if pool is None:
            drawing.start()
        try:
            yield keep
        finally:
            over.set()
            if pool is None:
                drawing.join()
            draw()
            time.sleep(LINGER_S)


SLOW_S = 2.0
FAR_M = 0.01
"""Mean distance from the path from which on a path that bends too sharply is reported."""


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
        f"moves in a period, but the robot turned by {turned_deg:.0f} degrees in a period at most: it cannot "
        f"follow such a path; make the path about {larger:.1f} times as large"
    )


@contextmanager
def noted_if_slow(note: Callable[[], None]) -> Iterator[None]:
    """Call ``note`` if what is done in the context takes long."""
    slow = threading.Timer(SLOW_S, note)
    slow.daemon = True
    slow.start()
    try:
        yield
    finally:
        slow.cancel()


def run_progress(tell: Tell, recording: Recording) -> Callable[[float, int], None]:
    """Return what tells progress along the path after a decision: its action, cost and distance as well."""

    def progress(_time_s: float, index: int) -> None:
        check = recording.options.check
        path = recording.then[-1].path if recording.then else recording.path
        limbs = [limb.name for limb in recording.robot.limbs]
        lost = lost_text(recording.decisions[-1].lost, limbs) if recording.decisions else ""
        notes = [_newest_plan(recording), lost, "" if check is None else check.text]
        tell(index + 1, len(path), ", ".join(note for note in notes if note))

    return progress


def _newest_plan(recording: Recording) -> str:
    if not recording.decisions:
        return ""
    newest, actions = recording.decisions[-1], recording.tables.actions
    if newest.status != 0 or newest.action >= len(actions):
        return "no plan"
    cost, off_mm = float(newest.cost), 1e3 * float(newest.distance_m)
    return f"{actions[newest.action].name} cost {cost:.1f}, {off_mm:.0f} mm off"


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
