"""``frogkick run``: follow a path in closed loop. Enter arms a real robot, and any key stops the run."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, TextIO

if sys.platform == "win32":
    import msvcrt
else:
    import select
    import termios
    import tty

import frogkick as fk
from frogkick.cli import options as opt
from frogkick.cli.common import Result
from frogkick.core.progress import tell_line


@contextmanager
def _terminal(stdin_is_taken: bool) -> Iterator[TextIO | None]:
    """Yield the stream that keys come from: standard input, or the terminal itself if input is piped.

    The stream is None if there is no terminal, or if this program runs in its background and may not read.
    """
    if not stdin_is_taken or sys.platform == "win32":  # piped input is no terminal, so nothing is asked
        yield sys.stdin
        return
    try:
        number = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY)
    except OSError:
        yield None
        return
    with os.fdopen(number, closefd=True) as stream:
        yield stream if os.tcgetpgrp(number) == os.getpgrp() else None


class Keys:
    """The operator of a real robot: single keys, read without waiting and without Enter; Ctrl-C interrupts.

    If ``stream`` is no terminal, nothing is asked and no key is ever pressed.
    """

    def __init__(self, stream: TextIO | None, ask: bool = True) -> None:
        """``ask``: ask for Enter before the robot is armed."""
        self._stream = stream
        self._ask = ask
        self.is_terminal = stream is not None and stream.isatty()

    def __enter__(self) -> Keys:
        if self._stream is not None and self.is_terminal and sys.platform != "win32":
            self._number = self._stream.fileno()
            self._before = termios.tcgetattr(self._number)
            tty.setcbreak(self._number)
        return self

    def __exit__(self, *_error: object) -> None:
        if self.is_terminal and sys.platform != "win32":
            termios.tcsetattr(self._number, termios.TCSADRAIN, self._before)

    def wait_to_arm(self) -> None:
        """Ask for Enter and wait for it; keys that were pressed before do not count."""
        if not (self.is_terminal and self._ask):
            return
        while self._read():
            pass
        tell_line("press Enter to arm the robot or Ctrl-C to leave; any key stops the run")
        while not {b"\r", b"\n"} & set(self._read(wait=True)):
            pass

    def pressed(self) -> bool:
        """Return whether a key has been pressed since the last call."""
        return self.is_terminal and bool(self._read())

    def _read(self, wait: bool = False) -> list[bytes]:
        """Return the bytes that are waiting; with ``wait``, at least one."""
        if sys.platform == "win32":
            found = [msvcrt.getch()] if wait else []
            while msvcrt.kbhit():
                found.append(msvcrt.getch())
            return found
        if not select.select([self._number], [], [], None if wait else 0.0)[0]:
            return []
        read = os.read(self._number, 64)
        if not read:
            raise KeyboardInterrupt  # the terminal is closed
        return [bytes([one]) for one in read]


def run(
    robot: Annotated[
        str,
        "virtual: firmware on the virtual chip; pool: C core on this computer; ble:NAME or serial:PORT: a "
        "real robot.",
    ] = "virtual",
    plan: Annotated[
        opt.PlanWhere,
        "Who decides: the robot (onboard), the host, or the robot while the host checks it (both).",
    ] = opt.PlanWhere.onboard,
    path: Annotated[
        str,
        "line, sine, ellipse, circle, bends, eight, or a CSV file with the columns x, y in m (and dx, dy or "
        "tangent_rad), 100 points (more are resampled) and at most 50 m of length.",
    ] = "line",
    then: Annotated[
        list[str] | None,
        "A path that takes over without a stop: PATH@SECONDS, seconds after the first decision. The robot "
        "continues at the nearest point of the new path. With @here behind it the path begins at the robot. "
        "May be given several times.",
    ] = None,
    hold: Annotated[
        bool,
        "Circle the end of the path, within 100 mm if the robot turns tightly enough, until a path of "
        "--then takes over, --simulated-time is over, or the run is stopped.",
    ] = False,
    planner: opt.Planner = opt.PlannerName.robot,
    depth: opt.Depth = None,
    learn: Annotated[
        bool,
        "Estimate the wear of each limb during the run, and plan with it. A robot continues from its "
        "earlier estimate; a run without --learn makes it forget.",
    ] = False,
    inside: Annotated[
        str | None,
        "Walls to keep off: X,Y,X,Y in m of two opposite corners of the pool, or pool: those of the "
        "calibration that --fixes gives.",
    ] = None,
    tables: opt.Tables = None,
    model: opt.Swimmer = None,
    simulated_time: Annotated[
        float, "Time limit of the run in pool time, s; for a real robot in real time."
    ] = 120.0,
    fix_rate: Annotated[float, "Position fixes per second of the simulated camera."] = 15.0,
    fixes: Annotated[
        str | None,
        "Source of a real robot's fixes. camera.toml of 'camera calibrate'; stdin: a tracker's lines 'x_m "
        "y_m heading_rad [age_s]'; pool: simulated, for a kit without limbs.",
    ] = None,
    source: Annotated[
        str,
        "Camera of --fixes camera.toml: a number, a network camera's address (http:, rtsp:), a video or a "
        "folder of pictures.",
    ] = "0",
    begin: Annotated[str | None, "Where a real robot's path begins: X,Y,DEG (m, degrees), or 'here'."] = None,
    dialect: Annotated[
        str, "Protocol of a real robot: frogkick, or frog2022 (the text of the authors' firmware)."
    ] = "frogkick",
    world: opt.World = None,
    seed: opt.Seed = 0,
    out: Annotated[Path | None, "Log file to write (HDF5)."] = None,
    view: Annotated[
        bool,
        "Draw the run in the browser, over the camera's picture if there is one. A simulated run is drawn "
        "in real time.",
    ] = False,
    video: Annotated[bool, "Record the camera's pictures beside --out, as .avi and .frames.csv."] = False,
    battery_v: Annotated[
        float | None,
        "Voltage of a real robot's lowest battery, measured at rest with a meter. A voltage that is too low "
        "is refused.",
    ] = None,
    key: opt.Key = None,
    yes: Annotated[bool, "Arm a real robot without asking for Enter."] = False,
) -> Result:
    """Follow a path in closed loop: position fixes come in, and strokes go out.

    At a terminal, Enter arms a real robot and any key stops the run. The robot is disarmed however the run
    ends. The exit code is 1 if a limit of the guard was broken, if robot and host decided differently (--plan
    both), if the robot made no progress along its path, if it could not follow it because a limb is lost
    (with --learn), or if the run was cut short: position fixes were lost, the robot's supply fell too low, it
    disarmed itself, the connection was lost, or the robot ended it and the reason was lost.
    """

    @contextmanager
    def operator(stdin_is_taken: bool) -> Iterator[Keys]:
        with _terminal(stdin_is_taken) as stream, Keys(stream, ask=not yes) as keys:
            yield keys

    found = opt.call(
        fk.run,
        locals(),
        table=tables,
        then=then or (),
        time_limit_s=simulated_time,
        fix_rate_hz=fix_rate,
        operator=operator,
        progress=True,
    )
    values, remarks = found.as_json(), []
    if found.tracking.stood:
        remarks.append(
            f"the robot made no progress along the path in {found.tracking.decisions} decisions, and was "
            f"{1e3 * found.tracking.mean_distance_m:.0f} mm from it on average: check that the path begins "
            "where the robot is, and that it leads where the robot can go"
        )
    from frogkick.front.bench import why_unfinished
    from frogkick.front.mission import hold_report, missed_paths_report
    from frogkick.front.viewing import lost_limb_advice, tight_path_advice

    cut_short = why_unfinished(found)
    lacks = lost_limb_advice(found.ended)
    remarks += [
        lacks or ("" if cut_short else tight_path_advice(found, found.tracking)),
        hold_report(values["hold"], hold),
        missed_paths_report(len(then or ()), found.log),
        cut_short and f"the path was not completed, as {cut_short}",
    ]
    failed = found.tracking.limit_violations or found.tracking.stood or lacks or cut_short
    return Result(values, passed=not failed, remarks=remarks)
