"""A new table for a worn robot, made from its last runs and sent to it if it is better."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.errors import FrogkickError, InputError
from frogkick.core.files import UnwritableError, require_writable, save_result, write_bytes
from frogkick.core.poses import PredictionError
from frogkick.core.progress import Progress, Stage, in_stages, shown
from frogkick.front.identifying import Given, LeftOut, logs_of, require_held_out
from frogkick.front.logs import robot_of
from frogkick.front.retune_tables import (
    PERIOD_OFF,
    SHAPES_SUIT_M,
    Lost,
    TableMaker,
    Tracked,
    error_on_runs,
    longest_stroke_m,
    paths_of,
    swims_of,
    table_error,
    table_horizons,
)
from frogkick.front.retune_verdict import HELD_OUT_MIN, no_better, worse_in_loop
from frogkick.front.robots import VIRTUAL, Pushed, push_table, require_target
from frogkick.front.tables import Table, load_table
from frogkick.identification.horizons import Horizon
from frogkick.identification.outcome import Outcome, found_toml, identify, write_robot
from frogkick.identification.segments import Segments, reliable, segments_of
from frogkick.identification.terms import Term
from frogkick.identification.verdict import NOTHING, TOO_LITTLE
from frogkick.report.style import page_of
from frogkick.robot import Robot, load_robot, parse_robot
from frogkick_codegen.firmware import require_tools

__all__ = ["BEFORE", "STATES", "TABLES", "Pushed", "Retuning", "retune"]

STATES = 800

HELD_SHARE = 1.0 / 3.0  # share of a single run's periods, its last ones, that is held out

ROBOT, LIBRARY, TABLES = "robot.toml", "library.h5", "tables.fkt"
BEFORE, REFUSED, FIRMWARE = "before.fkt", "refused.fkt", "firmware"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Retuning:
    """The result of retuning a robot.

    Attributes:
        outcome: the identification: its verdict and its effects.
        before, after: prediction errors of the old and the new table one period ahead on held-out periods;
            NaN if no table was made.
        better: whether the new table predicts better and follows paths no worse; otherwise the robot keeps
            its old one.
        reason: why the robot keeps its old table; "" if it does not.
        held_out: what was held out, in words.
        out: folder of the results; see ``retune``.
        tables: path, bytes and states of the new table, also of a refused one; None if none was made.
        firmware: sizes of the image; None if none was made.
        loop: the old and the new table in closed loop, in a pool with the identified effects; None without a
            new table.
        on_runs: what the old and the new table err against the rods with the identified effects, on the
            states of all runs as they occurred; None without a new table.
        horizons: errors of the old and the new table by horizon.
        lost: identified effects that no table can contain, and their cost; None if there are none.
        left_out: runs that were not used: ``run`` and ``reason`` of each.
        pushed: the robot's tables after sending, if the new one was sent.
        not_pushed: the error that prevented sending, or None.
    """

    outcome: Outcome
    before: PredictionError = field(default_factory=PredictionError)
    after: PredictionError = field(default_factory=PredictionError)
    better: bool = False
    reason: str
    held_out: str
    out: Path
    tables: Mapping[str, Any] | None = None
    firmware: Mapping[str, Any] | None = None
    loop: tuple[Tracked, Tracked] | None = None
    on_runs: tuple[PredictionError, PredictionError] | None = None
    horizons: Sequence[Horizon] = ()
    lost: Lost | None = None
    left_out: Sequence[Mapping[str, str]] = ()
    pushed: Pushed | None = None
    not_pushed: FrogkickError | None = None

    @property
    def done(self) -> bool:
        """Whether the robot now has a good table: a better new one, or an old one that lacks nothing."""
        return self.better or self.outcome.verdict == NOTHING

    @property
    def robot(self) -> Robot:
        """The robot with the identified effects, as in ``out``.

        Raises:
            InputError: no table was made.
        """
        return load_robot(self.out / ROBOT)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``retune``."""
        sides = ("before", "after")
        loop = None if self.loop is None else [asdict(each) for each in self.loop]
        on_runs = [{**each.as_json(), "periods": each.count} for each in self.on_runs or ()]
        return {
            "verdict": self.outcome.verdict,
            "effects": self.outcome.effects_as_json(),
            "before": {**self.before.as_json(), "periods": self.before.count},
            "after": {**self.after.as_json(), "periods": self.after.count},
            "horizons": [each.as_json() for each in self.horizons],
            "on_runs": dict(zip(sides, on_runs, strict=True)) if on_runs else None,
            "closed_loop": None if loop is None else dict(zip(sides, loop, strict=True)),
            "lost": None if self.lost is None else self.lost.as_json(),
            "rods": self.outcome.tested_as_json(),
            "held_out": self.held_out,
            "better": self.better,
            "reason": self.reason,
            "tables": self.tables,
            "firmware": self.firmware,
            "bytes_sent": 0 if self.pushed is None else self.pushed.bytes_sent,
            "out": str(self.out) if self.tables else None,
            "pushed": None if self.pushed is None else self.pushed.as_json(),
            "left_out": list(self.left_out),
        }

    def __repr__(self) -> str:
        names = ", ".join(term.title for term in self.outcome.terms) or "no effect"
        errors = " / ".join(f"{1e3 * error.position_rmse_m:.2f}" for error in (self.before, self.after))
        kept = "new table" if self.better else "the old table is kept"
        return f"Retuning({self.outcome.verdict}: {names}; {kept}; old / new {errors} mm)"

    def _repr_html_(self) -> str:
        return page_of(repr(self), {"verdict": self.outcome.verdict, "out": self.out, "reason": self.reason})


@typed
def retune(
    runs: Given | Sequence[Given],
    *,
    out: Path | str,
    robot: Robot | str | None = None,
    table: Table | Path | str | None = None,
    states: int = STATES,
    workers: int | None = None,
    push: str | None = None,
    key: Path | str | None = None,
    seed: int = 0,
    left_out: LeftOut = lambda _rows: None,
    progress: Progress = False,
    laws: bool = True,
) -> Retuning:
    """Identify what a model lacks, make a table with it, and keep the table if it is better.

    It is better if it predicts the held-out periods better, and if the robot follows paths no worse with it
    in a simulated pool with the identified effects: those of the runs.

    Args:
        runs: the robot's last runs in the order of their dates, or one. The last run is the test run; of a
            single run the last third is.
        robot: the robot that its table was made from, its name or its TOML file; None: the one in the logs of
            the runs, or the built-in one of their id.
        out: folder, new or empty, for ``robot.toml``, ``library.h5``, ``before.fkt`` (the old table), and
            ``tables.fkt`` with ``firmware``, or ``refused.fkt`` if the new table is no better. The folder is
            made only if a table is made.
        table: the table that the robot carries, or its file, to compare with; None: made like the new one,
            without effects.
        states: number of states of the simulated libraries, 46 to 65535.
        workers: number of processes; None: one for each core.
        push: ``ble:NAME``, ``serial:PORT`` or ``virtual``, where a better table is sent; None: nowhere.
        key: key file of that robot's owner, if it has one; None: the user's own, see ``connect``.
        seed: seed of the libraries' sampling.
        left_out: called before the work with the runs that are not used.
        progress: True for bars on stderr, or a function of (done, all) of each stage.
        laws: search formulas as well, see ``identify``. Those that depend on position, heading or time cannot
            go into a table; ``lost`` names them and their cost.

    Raises:
        InputError: runs of several robots or of another period, a folder ``out`` that is not empty, tables of
            another robot, or a number of states or a seed that is out of range.
        ToolchainError: no compiler for the firmware is found.
    """
    if push is not None:
        require_target(push, (VIRTUAL,))
    require_tools("bench")
    folder = Path(out)
    require_writable(folder, folder=True)
    require_new(folder)
    every = [runs] if isinstance(runs, Given) else runs
    logs = logs_of(every)
    described = robot_of(logs, robot)
    swims, unused = reliable([segments_of(*each, described) for each in logs])
    left_out(unused)
    require_held_out(swims[:-1], swims[-1:])
    old = None if table is None else _carried(table, described)
    stroke_m = longest_stroke_m(swims)
    tools = TableMaker(
        states,
        seed,
        workers or os.cpu_count() or 1,
        swims_of(swims),
        paths_of([log for log, _name in logs]),
        SHAPES_SUIT_M if math.isnan(stroke_m) else stroke_m,
    )
    found = retuned(swims, described, folder, tools, partial(shown, progress), old, laws)
    sent = failed = None
    if push is not None and found.better:
        try:
            owner = None if key is None else Path(key)
            sent = push_table(push, folder / TABLES, folder / BEFORE, progress, owner)
        except FrogkickError as error:  # the results stay
            failed = error
    return replace(found, left_out=unused, pushed=sent, not_pushed=failed)


def _carried(table: Table | Path | str, robot: Robot) -> bytes:
    """Return the image that a robot carries."""
    used = load_table(table, robot)
    opened = used.tables
    opened.require_robot(robot.id)
    if opened.period_us != round(robot.period_s * 1e6):
        raise InputError(
            f"table {used.name!r} has a period of {opened.period_us * 1e-6:.3f} s, but robot "
            f"{robot.id!r} has {robot.period_s:.3f} s: give the robot's own table"
        )
    return opened.image


def retuned(
    swims: Sequence[Segments],
    robot: Robot,
    out: Path,
    tools: TableMaker,
    stage: Stage,
    old: bytes | None = None,
    laws: bool = False,
) -> Retuning:
    """Retune from runs that have been read. The folder ``out`` is made with all its files or not at all."""
    _check_periods(swims, robot)
    train, test, held_out = split(swims)
    with in_stages(stage, "identify") as tell:
        outcome = identify(train, test, robot, progress=tell, laws=laws)
    reason = _why_no_tables(outcome, len(swims) == 1)
    if reason:
        lost = _lost(outcome, robot, tools, stage, old)
        return Retuning(outcome=outcome, reason=reason, held_out=held_out, out=out, lost=lost)
    with _folder(out, outcome) as made:
        write_robot(made / ROBOT, outcome)
        worn = load_robot(made / ROBOT)
        new = tools.tables(worn, made / LIBRARY, lambda title: stage(f"new {title}"))
        if old is None:
            old = tools.tables(robot, made / f"before-{LIBRARY}", lambda title: stage(f"old {title}"))
            (made / f"before-{LIBRARY}").unlink()
        write_bytes(made / BEFORE, old)
        before, after = (table_error(tools, image, outcome) for image in (old, new))
        on_runs = error_on_runs(tools, old, outcome), error_on_runs(tools, new, outcome)
        horizons = table_horizons(tools, old, new, outcome)
        write_bytes(made / TABLES, new)
        loop = []
        for file, which in ((made / BEFORE, "old"), (made / TABLES, "new")):
            with stage(
                f"paths followed with the {which} table, in a pool with the identified effects"
            ) as progress:
                loop.append(tools.tracked(file, worn, progress))
        reason = no_better(before, after, outcome.tested.noise_floor, worse_in_loop(*loop))
        better = not reason
        name = TABLES if better else REFUSED
        if not better:
            (made / TABLES).rename(made / REFUSED)
        lost = _lost(outcome, worn, tools, stage, new if better else old, loop[1 if better else 0])
        firmware = None
        if better:
            with stage("firmware") as progress:
                firmware = tools.firmware(made / name, worn, made / FIRMWARE)
                progress(1, 1)
    return Retuning(
        outcome=outcome,
        before=before,
        after=after,
        better=better,
        reason=reason,
        held_out=held_out,
        out=out,
        tables={"file": str(out / name), "bytes": len(new), "states": tools.states(new)},
        firmware=firmware,
        loop=(loop[0], loop[1]),
        on_runs=on_runs,
        horizons=horizons,
        lost=lost,
    )


def _lost(
    outcome: Outcome,
    robot: Robot,
    tools: TableMaker,
    stage: Stage,
    image: bytes | None,
    all_in: Tracked | None = None,
) -> Lost | None:
    """The identified effects that no table can contain, and their cost with the robot's next table.

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
    """Refuse a folder that is not empty, because tables in it must not be overwritten."""
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
    strokes = tuple(stroke for stroke in swim.strokes if stroke[0] < cut_s)
    learned = replace(swim.first_periods(first).with_fixes(swim.arrival_s <= cut_s), strokes=strokes)
    kept = replace(swim, judged_from=first)
    return [learned], [kept], f"periods {first + 1} to {len(swim.start_s)} of the only run {swim.name!r}"


def _why_no_tables(outcome: Outcome, single: bool) -> str:
    """Why no table is made; "" if one is."""
    if outcome.verdict == TOO_LITTLE:
        return outcome.reason + (", a third of a single run is held out" if single else "")
    if outcome.verdict == NOTHING:
        return "the robot's model explains these runs: the robot keeps its old table"
    if not outcome.terms:
        return "no known effect explains these runs: the robot keeps its old table (see identify --report)"
    judged = sum(int(np.isfinite(swim.measured).all(axis=1).sum()) for swim in outcome.test)
    if judged < HELD_OUT_MIN:
        return f"{judged} held-out periods have fixes, {HELD_OUT_MIN} are needed: record a longer last run"
    if not any(term.effect().in_tables for term in outcome.terms):
        names = ", ".join(term.title for term in outcome.terms)
        return (
            f"no table can contain what was found ({names}), as it is in the camera or the water or depends "
            "on position, heading or time: the robot keeps its old table"
        )
    return ""


def _check_periods(swims: Sequence[Segments], robot: Robot) -> None:
    """Refuse no runs, a last run without a whole period, and a period other than the new table's."""
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
def _folder(out: Path, outcome: Outcome) -> Iterator[Path]:
    """A folder beside ``out`` that becomes it on success and is removed on any error.

    If it cannot be written any more, for example on a full disk, what is in it is kept under another name; if
    it is gone, the robot of the identification is written elsewhere.
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
    except OSError as error:
        why = f"cannot write {str(out)!r}: {error.strerror or error}"
        raise _kept(made, out, outcome, why) from error
    except UnwritableError as error:
        raise _kept(made, out, outcome, str(error)) from error
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _kept(made: Path, out: Path, outcome: Outcome, why: str) -> InputError:
    """Keep what was made so far; return the error that says where it is."""
    kept = made.with_name(f"{out.name}.unfinished{made.suffix}")
    if (made / ROBOT).exists():
        with suppress(OSError):  # its folder has become read-only
            made.rename(kept)
            kept.chmod(0o755)
            return InputError(f"{why}; what was made so far, with {ROBOT}, is in {str(kept)!r}")
    alone = kept.with_suffix(".toml")
    try:
        save_result(lambda file: write_robot(file, outcome), alone)
    except UnwritableError as error:
        return InputError(f"{why}; the identified robot: {error}")
    return InputError(f"{why}; the identified robot is in {str(alone)!r}")
