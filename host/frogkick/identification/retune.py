"""Retune a worn robot: last logs in; new tables out, or the old ones where these are as good.

What makes tables, looks them up and builds firmware is passed in: identification knows runs and robots, but
no libraries.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.files import write_bytes
from frogkick.core.poses import PredictionError
from frogkick.core.progress import Tell, TellStage
from frogkick.identification.horizons import Horizon
from frogkick.identification.outcome import Outcome, found_toml, identify, write_robot
from frogkick.identification.segments import Segments
from frogkick.identification.tables import (
    PERIOD_OFF,
    Lost,
    Stage,
    Tools,
    Tracked,
    table_error,
    table_horizons,
)
from frogkick.identification.terms import Term
from frogkick.identification.verdict import NOTHING, TOO_LITTLE
from frogkick.robot import Robot, load_robot, parse_robot

BETTER = 0.98
"""The error of new tables must be at most this share of the old ones', in position or in heading."""

HELD_OUT_MIN = 5
"""Minimum of held-out periods with a measured end."""

HELD_SHARE = 1.0 / 3.0
"""Share of a single run's periods, its last ones, that is held out."""

ROBOT, LIBRARY, TABLES = "robot.toml", "library.h5", "tables.fkt"
BEFORE, REFUSED, FIRMWARE = "before.fkt", "refused.fkt", "firmware"


@dataclass(frozen=True, eq=False)
class Retuned:
    """Result of a retune.

    Attributes:
        outcome: of the identification.
        before, after: errors of the old and the new tables, a period ahead on held-out periods; NaN where
            none were made.
        better: the new tables are better; else the old ones stay.
        reason: why the old tables stay; "" if they do not.
        held_out: what was held out, in words.
        tables: path, bytes and states of the new tables, refused ones too; None if none were made.
        firmware: sizes of the image; None if none was made.
        loop: the old and the new tables in closed loop, in a pool with what was found; None if none were
            made.
        horizons: errors of the old and the new tables by horizon.
        lost: effects that were found and that no table can hold, and what that costs; None if there are
            none.
    """

    outcome: Outcome
    before: PredictionError
    after: PredictionError
    better: bool
    reason: str
    held_out: str
    tables: Mapping[str, Any] | None = None
    firmware: Mapping[str, Any] | None = None
    loop: tuple[Tracked, Tracked] | None = None
    horizons: Sequence[Horizon] = ()
    lost: Lost | None = None

    @property
    def done(self) -> bool:
        """Whether the robot now has the right tables: new ones, or old ones that lack nothing."""
        return self.better or self.outcome.verdict == NOTHING

    def as_json(self) -> dict[str, Any]:
        """The keys of the command."""
        return {
            "verdict": self.outcome.verdict,
            "effects": self.outcome.effects_as_json(),
            "before": {**self.before.as_json(), "periods": self.before.count},
            "after": {**self.after.as_json(), "periods": self.after.count},
            "horizons": [each.as_json() for each in self.horizons],
            "closed_loop": None
            if self.loop is None
            else {"before": self.loop[0].as_json(), "after": self.loop[1].as_json()},
            "lost": None if self.lost is None else self.lost.as_json(),
            "rods": self.outcome.tested_as_json(),
            "held_out": self.held_out,
            "better": self.better,
            "reason": self.reason,
            "tables": self.tables,
            "firmware": self.firmware,
            "bytes_sent": 0,
        }


def retune(
    swims: Sequence[Segments],
    robot: Robot,
    out: Path,
    tools: Tools,
    stage: Stage,
    old: bytes | None = None,
    laws: bool = False,
) -> Retuned:
    """Find a robot's effects, make tables with them, and keep these if they predict held-out periods better.

    Args:
        swims: runs of the robot, in the order they were swum; the last one is held out, of a single one its
            last third.
        robot: the robot of its present tables.
        out: folder for the results, new or empty: ``robot.toml``, ``library.h5``, ``before.fkt`` (the old
            tables), and ``tables.fkt`` with ``firmware``, or ``refused.fkt`` where these are no better. It is
            not made where no tables are, and is there with all that belongs in it or not at all.
        tools: see Tools.
        stage: see Stage.
        old: image of the tables that the robot carries; None: it is made as the new one is, without effects.
        laws: search laws as well; see identify.

    Raises:
        InputError: ``out`` holds something, a run has another period than the robot, or see identify.
    """
    require_new(out)
    _check_periods(swims, robot)
    train, test, held_out = split(swims)
    with steps(stage) as tell:
        outcome = identify(train, test, robot, progress=tell, laws=laws)
    unknown = PredictionError()
    reason = _why_no_tables(outcome, len(swims) == 1)
    if reason:
        lost = _lost(outcome, robot, tools, stage, old)
        return Retuned(outcome, unknown, unknown, False, reason, held_out, lost=lost)
    with _folder(out) as made:
        write_robot(made / ROBOT, outcome)
        worn = load_robot(made / ROBOT)
        new = tools.tables(worn, made / LIBRARY, lambda title: stage(f"new {title}"))
        if old is None:
            old = tools.tables(robot, made / f"before-{LIBRARY}", lambda title: stage(f"old {title}"))
            (made / f"before-{LIBRARY}").unlink()
        write_bytes(made / BEFORE, old)
        before, after = (table_error(tools, image, outcome) for image in (old, new))
        horizons = table_horizons(tools, old, new, outcome)
        better = is_better(before, after)
        name = TABLES if better else REFUSED
        write_bytes(made / name, new)
        loop = []
        for file, which in ((made / BEFORE, "old"), (made / name, "new")):
            with stage(f"paths followed with the {which} tables, by a simulated robot like this") as progress:
                loop.append(tools.tracked(file, worn, progress))
        lost = _lost(outcome, worn, tools, stage, new if better else old, loop[1 if better else 0])
        firmware = None
        if better:
            with stage("firmware") as progress:
                firmware = tools.firmware(made / name, worn, made / FIRMWARE)
                progress(1, 1)
    tables = {"file": str(out / name), "bytes": len(new), "states": tools.states(new)}
    reason = "" if better else _no_better(before, after)
    return Retuned(
        outcome, before, after, better, reason, held_out, tables, firmware, (loop[0], loop[1]), horizons, lost
    )


def _lost(
    outcome: Outcome,
    robot: Robot,
    tools: Tools,
    stage: Stage,
    image: bytes | None,
    all_in: Tracked | None = None,
) -> Lost | None:
    """What no table can hold of what was found, and what that costs the tables that the robot will have.

    Args:
        image: of the tables; None: they are made as new ones are, without effects.
        all_in: these in a pool with all that was found; None: not tried yet.
    """
    kept = [term for term in outcome.terms if term.effect().in_tables]
    names = tuple(term.title for term in outcome.terms if term not in kept)
    if not names:
        return None
    with tempfile.TemporaryDirectory() as folder:
        if image is None:
            image = tools.tables(outcome.robot, Path(folder) / LIBRARY, lambda title: stage(f"old {title}"))
        file = Path(folder) / TABLES
        write_bytes(file, image)

        def tracked(terms: Sequence[Term], which: str) -> Tracked:
            swimmer = parse_robot(found_toml(outcome, None, terms), robot.id, outcome.robot.folder)
            with stage(f"paths followed {which} what no table holds") as progress:
                return tools.tracked(file, swimmer, progress)

        return Lost(names, all_in or tracked(outcome.terms, "with"), tracked(kept, "without"))


def require_new(out: Path) -> None:
    """Refuse a folder that holds something: old tables must stay what they are.

    Raises:
        InputError: it does, or is no folder.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"--out {str(out)!r} is not empty: name a new folder")


def split(swims: Sequence[Segments]) -> tuple[list[Segments], list[Segments], str]:
    """Training runs, test runs, and the test runs in words.

    Of a single run the last third is the test. It is simulated from its first fix, because earlier actions
    still act, but only the last third is judged. The training part holds none of its fixes.
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
    kept = replace(swim, judged_from=first)
    return [learned], [kept], f"periods {first + 1} to {len(swim.start_s)} of the only run {swim.name!r}"


def is_better(before: PredictionError, after: PredictionError) -> bool:
    """Whether neither position nor heading is worse and one of them is clearly better."""
    pairs = (
        (before.position_rmse_m, after.position_rmse_m),
        (before.heading_rmse_rad, after.heading_rmse_rad),
    )
    return (
        after.count >= HELD_OUT_MIN
        and all(now <= then for then, now in pairs)
        and any(now < BETTER * then for then, now in pairs)
    )


def _why_no_tables(outcome: Outcome, single: bool) -> str:
    """Why no tables are to be made; "" if they are."""
    if outcome.verdict == TOO_LITTLE:
        return outcome.reason + (", a third of a single run is held out" if single else "")
    if outcome.verdict == NOTHING:
        return "the tables' robot explains these runs: the old tables stay"
    if not outcome.terms:
        return "no known effect explains what these runs show: the old tables stay (see identify --report)"
    judged = sum(int(np.isfinite(swim.measured).all(axis=1).sum()) for swim in outcome.test)
    if judged < HELD_OUT_MIN:
        return f"{judged} held-out periods with fixes, needed are {HELD_OUT_MIN}: record a longer last run"
    if not any(term.effect().in_tables for term in outcome.terms):
        names = ", ".join(term.title for term in outcome.terms)
        return (
            f"what was found ({names}) is in the camera or the water or hangs on place, heading or time, "
            "tables cannot know it: the old stay"
        )
    return ""


def _no_better(before: PredictionError, after: PredictionError) -> str:
    if after.count < HELD_OUT_MIN:
        return f"the tables could be judged on {after.count} held-out periods, needed are {HELD_OUT_MIN}"
    return f"the new tables are no better on held-out periods: {after} after {before}; the old ones stay"


def _check_periods(swims: Sequence[Segments], robot: Robot) -> None:
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
def steps(stage: Stage) -> Iterator[TellStage]:
    """What begins a stage of ``stage`` with each new name."""
    with ExitStack() as begun:
        shown: dict[str, Tell] = {}

        def tell(name: str, done: int, whole: int, /, note: str = "") -> None:
            if name not in shown:
                begun.close()
                shown.clear()
                shown[name] = begun.enter_context(stage(f"identify: {name}"))
            shown[name](done, whole, note)

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
