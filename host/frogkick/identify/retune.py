"""A worn robot's last logs in, tables that know its wear out; or its old ones, where these are as good.

What makes tables, looks them up and builds firmware is handed in: identification knows runs and robots, no
libraries.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from frogkick.effects import Effect, Fix
from frogkick.errors import InputError
from frogkick.files import write_bytes
from frogkick.identify.outcome import Outcome, identify, write_robot
from frogkick.identify.predict import Track
from frogkick.identify.swim import Swim
from frogkick.identify.verdict import NOTHING, TOO_LITTLE, Error, error_of
from frogkick.paths import wrap_angle
from frogkick.robot import Robot, load_robot

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

BETTER = 0.98
"""New tables must err at most so many times as much as the old ones, in position or in heading."""

HELD_LEAST = 5
"""Held-out periods with a measured end, to judge by."""

HELD_SHARE = 1.0 / 3.0
"""Of a single run's periods, its last: held out."""

EARLIER = 8
"""How many earlier actions a look-up is told."""

RESTED = -1
"""In place of an earlier action: there was none, as libraries have it."""

PERIOD_OFF = 0.1
"""A run's period may differ by such a share from the one that tables are made for."""

ROBOT, LIBRARY, TABLES = "robot.toml", "library.h5", "tables.fkt"
BEFORE, REFUSED, FIRMWARE = "before.fkt", "refused.fkt", "firmware"

_CHANCE = np.random.default_rng(0)

Stage = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Begins a stage of the work by its title; what it yields is called with (done, all)."""


class Tools(Protocol):
    """What is done with robots and tables that is no identification."""

    def tables(self, robot: Robot, library: Path, stage: Stage) -> bytes:
        """Simulate a robot's library into a file, and make the table image of it."""

    def states(self, image: bytes) -> int:
        """How many states a table image has."""

    def looked_up(self, image: bytes, velocity_body: FloatArray, previous: IntArray) -> FloatArray:
        """(n, a, 6) transitions in a table image from (n, 3) velocities after (n, EARLIER) actions."""

    def firmware(self, tables: Path, robot: Robot, out: Path) -> Mapping[str, Any]:
        """Build the robot's image around a table file into a folder; its sizes."""


@dataclass(frozen=True, eq=False)
class Retuned:
    """What came of it.

    Attributes:
        outcome: of the identification.
        before, after: of the old and the new tables, a period ahead on held-out periods; NaN where none were
            made.
        better: the new tables are; else the old ones stay.
        reason: why they stay; "" where they do not.
        held_out: what was held out, in words.
        tables: path, bytes and states of the new tables, refused ones too; None where none were made.
        firmware: sizes of the image; None where none was made.
    """

    outcome: Outcome
    before: Error
    after: Error
    better: bool
    reason: str
    held_out: str
    tables: Mapping[str, Any] | None = None
    firmware: Mapping[str, Any] | None = None

    @property
    def done(self) -> bool:
        """Whether the robot swims with the right tables now: new ones, or old ones that lack nothing."""
        return self.better or self.outcome.verdict == NOTHING

    def as_json(self) -> dict[str, Any]:
        """The keys of the command."""
        found = self.outcome.as_json()
        return {
            "verdict": self.outcome.verdict,
            "effects": found["effects"],
            "before": {**self.before.as_json(), "periods": self.before.count},
            "after": {**self.after.as_json(), "periods": self.after.count},
            "rods": found["test"],
            "held_out": self.held_out,
            "better": self.better,
            "reason": self.reason,
            "tables": self.tables,
            "firmware": self.firmware,
            "bytes_sent": 0,
        }


def retune(
    swims: Sequence[Swim], robot: Robot, out: Path, tools: Tools, stage: Stage, old: bytes | None = None
) -> Retuned:
    """Find what a robot lacks, make tables that know it, keep them if they predict held-out periods better.

    Args:
        swims: runs of the robot, in the order they were swum; the last one is held out, of a single one its
            last third.
        robot: as its tables know it so far.
        out: folder for the results, new or empty: ``robot.toml``, ``library.h5``, ``before.fkt`` (the old
            tables), and ``tables.fkt`` with ``firmware``, or ``refused.fkt`` where these are no better. It is
            not made where no tables are, and is there with all that belongs in it or not at all.
        tools: see Tools.
        stage: see Stage.
        old: image of the tables that the robot carries; None: it is made as the new one is, without effects.

    Raises:
        InputError: ``out`` holds something, a run has another period than the robot, or see identify.
    """
    require_new(out)
    _check_periods(swims, robot)
    train, test, held_out = split(swims)
    with steps(stage) as tell:
        outcome = identify(train, test, robot, progress=tell)
    unknown = Error(math.nan, math.nan)
    reason = _needless(outcome, len(swims) == 1)
    if reason:
        return Retuned(outcome, unknown, unknown, False, reason, held_out)
    with _folder(out) as made:
        write_robot(made / ROBOT, outcome)
        worn = load_robot(made / ROBOT)
        new = tools.tables(worn, made / LIBRARY, lambda title: stage(f"new {title}"))
        if old is None:
            old = tools.tables(robot, made / f"before-{LIBRARY}", lambda title: stage(f"old {title}"))
            (made / f"before-{LIBRARY}").unlink()
        write_bytes(made / BEFORE, old)
        before, after = (table_error(tools, image, outcome) for image in (old, new))
        better = is_better(before, after)
        name = TABLES if better else REFUSED
        write_bytes(made / name, new)
        firmware = None
        if better:
            with stage("firmware") as progress:
                firmware = tools.firmware(made / name, worn, made / FIRMWARE)
                progress(1, 1)
    tables = {"file": str(out / name), "bytes": len(new), "states": tools.states(new)}
    reason = "" if better else _no_better(before, after)
    return Retuned(outcome, before, after, better, reason, held_out, tables, firmware)


def require_new(out: Path) -> None:
    """Refuse a folder that holds something: old tables must stay what they are.

    Raises:
        InputError: it does, or is no folder.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"--out {str(out)!r} is not empty: name a new folder")


def split(swims: Sequence[Swim]) -> tuple[list[Swim], list[Swim], str]:
    """Runs to learn from, runs to judge by, and in words which.

    Of a single run the last third is judged. It is followed from its first fix, for what a robot did earlier
    acts on; only its ends count from there on. Nothing learned from has seen a fix of it.
    """
    if len(swims) > 1:
        return list(swims[:-1]), [swims[-1]], f"run {swims[-1].name!r}"
    (swim,) = swims
    first = len(swim.start_s) - round(HELD_SHARE * len(swim.start_s))
    if first == 0:
        return [swim], [swim], "nothing"
    cut_s = float(swim.end_s[first - 1])
    seen = swim.arrival_s <= cut_s
    learned = replace(
        swim,
        time_s=swim.time_s[seen],
        arrival_s=swim.arrival_s[seen],
        pose=swim.pose[seen],
        strokes=tuple(stroke for stroke in swim.strokes if stroke[0] < cut_s),
        start_s=swim.start_s[:first],
        action=swim.action[:first],
        end_s=swim.end_s[:first],
    )
    kept = _Later(**{name: getattr(swim, name) for name in Swim.__dataclass_fields__}, judged_from=first)
    return [learned], [kept], f"periods {first + 1} to {len(swim.start_s)} of the only run {swim.name!r}"


@dataclass(frozen=True, eq=False)
class _Later(Swim):
    """A run of which only later periods are judged."""

    judged_from: int = 0

    @cached_property
    def measured(self) -> FloatArray:
        """(m, 3) as Swim has it; NaN for the periods before."""
        ends = [self.pose_at(float(end)) for end in self.end_s]
        return np.array([np.full(3, np.nan)] * self.judged_from + ends[self.judged_from :]).reshape(-1, 3)


def table_error(tools: Tools, image: bytes, outcome: Outcome) -> Error:
    """How far a table errs a period ahead on the test runs: one look-up from where each period began.

    Old and new tables begin from the same states, the best that are known of the robot: those of the rods
    with what was found. Their poses are taken as the camera shows them, as the robot will be told them.

    Args:
        tools: look it up.
        image: of the table.
        outcome: knows runs, starts and effects.
    """
    effects = [term.effect() for term in outcome.terms]
    gaps = [_gaps(tools, image, *pair, effects) for pair in zip(outcome.test, outcome.tracks, strict=True)]
    return error_of(np.concatenate(gaps))


def _gaps(tools: Tools, image: bytes, swim: Swim, track: Track, effects: Sequence[Effect]) -> FloatArray:
    """(m, 3) measured minus looked-up pose at each period's end; NaN where one is not known."""
    gap = np.full((len(swim.start_s), 3), np.nan)
    known = np.isfinite(track.start).all(axis=1) & (swim.action >= 0)
    # What a table does not know of is not held against it: a period that was cut short or lengthened.
    known &= np.abs((swim.end_s - swim.start_s) / swim.period_s - 1.0) < PERIOD_OFF
    if not known.any():
        return gap
    found = tools.looked_up(image, track.start[known, 3:], earlier_actions(swim)[known])
    moved = found[np.arange(len(found)), swim.action[known], :3]
    shown = np.array(
        [
            _shown(effects, float(at_s), pose)
            for at_s, pose in zip(swim.start_s[known], track.start[known, :3], strict=True)
        ]
    )
    c, s = np.cos(shown[:, 2]), np.sin(shown[:, 2])
    ends = shown + np.column_stack(
        [c * moved[:, 0] - s * moved[:, 1], s * moved[:, 0] + c * moved[:, 1], moved[:, 2]]
    )
    gap[known] = swim.measured[known] - ends
    gap[:, 2] = wrap_angle(gap[:, 2])
    return gap


def _shown(effects: Sequence[Effect], time_s: float, pose: FloatArray) -> tuple[float, float, float]:
    """A pose as the camera shows it."""
    seen = Fix(time_s, 0.0, *(float(value) for value in pose))
    for effect in effects:
        seen = effect.fix(seen, _CHANCE) or seen
    return seen.x_m, seen.y_m, seen.heading_rad


def earlier_actions(swim: Swim) -> IntArray:
    """(m, EARLIER) actions of the periods before each one, newest first, RESTED beyond a gap or the start."""
    previous = np.full((len(swim.start_s), EARLIER), RESTED, dtype=np.int64)
    for period in range(1, len(previous)):
        apart_s = float(swim.start_s[period] - swim.start_s[period - 1])
        if swim.action[period - 1] >= 0 and apart_s < 1.5 * swim.period_s:
            previous[period] = [swim.action[period - 1], *previous[period - 1, :-1]]
    return previous


def is_better(before: Error, after: Error) -> bool:
    """Neither position nor heading is worse, and one of them is better by more than chance would have it."""
    pairs = (
        (before.position_rmse_m, after.position_rmse_m),
        (before.heading_rmse_rad, after.heading_rmse_rad),
    )
    return (
        after.count >= HELD_LEAST
        and all(now <= then for then, now in pairs)
        and any(now < BETTER * then for then, now in pairs)
    )


def _needless(outcome: Outcome, single: bool) -> str:
    """Why no tables are to be made; "" where they are."""
    if outcome.verdict == TOO_LITTLE:
        return outcome.reason + (", a third of a single run is held out" if single else "")
    if outcome.verdict == NOTHING:
        return "the tables' robot explains these runs: the old tables stay"
    if not outcome.terms:
        return "no known effect explains what these runs show: the old tables stay (see identify --report)"
    judged = sum(int(np.isfinite(swim.measured).all(axis=1).sum()) for swim in outcome.test)
    if judged < HELD_LEAST:
        return f"{judged} held-out periods with fixes, needed are {HELD_LEAST}: record a longer last run"
    if not any(_swims(term.effect()) for term in outcome.terms):
        names = ", ".join(term.title for term in outcome.terms)
        return f"what was found ({names}) is in the camera or the water, tables cannot know it: the old stay"
    return ""


def _swims(effect: Effect) -> bool:
    """Whether an effect goes with the robot's body, as tables do."""
    hooks = ("robot", "stroke", "wrench")
    return any(getattr(type(effect), hook) is not getattr(Effect, hook) for hook in hooks)


def _no_better(before: Error, after: Error) -> str:
    if after.count < HELD_LEAST:
        return f"the tables could be judged on {after.count} held-out periods, needed are {HELD_LEAST}"
    return (
        f"the new tables are no better on held-out periods: {_text(after)} after {_text(before)}; "
        "the old ones stay"
    )


def _text(error: Error) -> str:
    return f"{1e3 * error.position_rmse_m:.2f} mm, {math.degrees(error.heading_rmse_rad):.2f} deg"


def _check_periods(swims: Sequence[Swim], robot: Robot) -> None:
    """Refuse runs with another period than the tables will have.

    Raises:
        InputError: no runs, one without a whole period, or another period.
    """
    if not swims:
        raise InputError("no runs: give the robot's last logs")
    for swim in swims:
        if abs(swim.period_s / robot.period_s - 1.0) > PERIOD_OFF:
            raise InputError(
                f"run {swim.name!r} has a period of {swim.period_s:.3f} s, robot {robot.id!r} "
                f"{robot.period_s:.3f} s: give a --robot with the run's period"
            )
    if not len(swims[-1].start_s):
        raise InputError(f"run {swims[-1].name!r} has no whole period with fixes: give a longer run")


@contextmanager
def steps(stage: Stage) -> Iterator[Callable[[str, int, int], None]]:
    """A function of (what, done, all) that begins a stage with each new ``what``."""
    with ExitStack() as begun:
        shown: dict[str, Callable[[int, int], None]] = {}

        def tell(what: str, done: int, whole: int) -> None:
            if what not in shown:
                begun.close()
                shown.clear()
                shown[what] = begun.enter_context(stage(f"identify: {what}"))
            shown[what](done, whole)

        yield tell


@contextmanager
def _folder(out: Path) -> Iterator[Path]:
    """A folder beside ``out`` that becomes it on success and is removed on any error.

    Raises:
        InputError: it cannot be made there.
    """
    out = out.resolve()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as error:
        raise InputError(f"cannot write {str(out)!r}: {error.strerror}; choose another --out") from error
    try:
        yield made
        made.chmod(0o755)
        if out.is_dir():
            out.rmdir()  # an empty one; another one's files since then stop it
        os.replace(made, out)
    finally:
        shutil.rmtree(made, ignore_errors=True)
