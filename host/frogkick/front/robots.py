"""A real robot, or a virtual one, to talk to: its table, its state, a run with it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from frogkick.core.errors import FrogkickError, InputError, nearest_name
from frogkick.core.progress import Progress, shown
from frogkick.front.places import robot_of_table, simulated_robot
from frogkick.front.running import Run, run
from frogkick.front.tables import Table
from frogkick.link.auth import default_key_file
from frogkick.link.frames import DELIMITER
from frogkick.link.layout import link_layout
from frogkick.link.opening import opened, require_wire
from frogkick.link.wire import Wire, is_target, parse_target
from frogkick.paths import Path as SwimPath
from frogkick.runs.lab_session import LabSession, lab_session
from frogkick.runs.pushing import Pushed, own, push, roll_back
from frogkick.runs.session import Session
from frogkick.tables.image import read_image

__all__ = [
    "VIRTUAL",
    "Camera",
    "Connection",
    "Pushed",
    "RobotHeard",
    "connect",
    "default_key_file",
    "push_table",
    "require_target",
    "scan",
    "session_at",
]

VIRTUAL = "virtual"


@dataclass(frozen=True)
class Camera:
    """A calibrated camera over the pool, as a source of position fixes.

    Attributes:
        calibration: the file that ``frogkick camera calibrate`` wrote (.toml).
        source: camera number, video file or folder of pictures.
    """

    calibration: Path | str
    source: str = "0"


@dataclass(frozen=True, repr=False)
class Connection:
    """A robot at the other end of a radio or a line, see ``connect``.

    Attributes:
        target: ``ble:NAME``, ``ble:ADDRESS`` or ``serial:PORT[:BAUD]``.
        wire: to it, open.
        key: file of the owner's key, for a robot that has one; None: the user's own.
    """

    target: str
    wire: Wire
    key: Path | None = None

    def _session(self) -> LabSession:
        return lab_session(self.wire, self.key)

    def status(self) -> dict[str, Any]:
        """What the robot says of itself: the fields of HELLO and STATUS in the link's documentation.

        Raises:
            LinkError: no answer.
        """
        session = self._session()
        return {**session.meet(), **session.request("STATUS")}

    def push(self, table: Table | Path | str, progress: Progress = False) -> Pushed:
        """Give the robot another table. It is disarmed for it, and keeps the table before.

        Raises:
            TableError: the table is another robot's.
            LinkError: no answer.
            UploadError: it does not take the table.
        """
        image = table.tables if isinstance(table, Table) else read_image(table)
        with shown(progress, "bytes sent") as tell:
            return push(self._session(), image, None, tell)

    def roll_back(self) -> Pushed:
        """Back to the table before.

        Raises:
            LinkError: it keeps none, or does not answer.
        """
        return roll_back(self._session())

    def own(self, release: bool = False) -> None:
        """Let the robot take commands from its owner alone: who has the key. It is disarmed for it.

        The key is that of ``connect``, or the user's own. Where its file is not there yet, one is made; keep
        a copy of it. DISARM and STOP never need it.

        Args:
            release: instead, let anybody command it again.

        Raises:
            InputError: the key's file cannot be read or written.
            LinkError: the robot has another key, or cannot have one, or does not answer.
        """
        own(self._session(), release)

    def follow(
        self,
        path: SwimPath | str,
        fixes: Camera | str,
        table: Table | Path | str | None = None,
        **options: Any,
    ) -> Run:
        """Follow a path with the robot. It is armed once all checks passed.

        However the run ends, the robot is disarmed first.

        Args:
            path: where to swim, world frame, or a shape's name or a path file.
            fixes: a camera, or as for ``run``.
            table: the robot's own; None: its default one.
            options: of ``run``: operator, plan, depth, begin, battery_v, time_limit_s, out and others.

        Raises:
            FrogkickError: see ``run``.
        """
        if isinstance(fixes, Camera):
            options |= {"fixes": str(fixes.calibration), "source": fixes.source}
        else:
            options["fixes"] = fixes
        return run(table, path, robot=self.target, wire=self.wire, key=self.key, **options)

    def __repr__(self) -> str:
        return f"Connection({self.target!r})"


@contextmanager
def connect(target: str, key: Path | str | None = None) -> Iterator[Connection]:
    """Open the link to a robot, and close it at the end of the ``with`` block.

    Args:
        target: ``ble:NAME``, ``ble:ADDRESS`` or ``serial:PORT[:BAUD]``.
        key: file of the owner's key, for a robot that has one; None: ``frogkick/owner.key`` among the user's
            settings.

    Raises:
        InputError: no such kind of place.
        WireError: the robot cannot be reached.
    """
    require_target(target)
    with opened(parse_target(target), DELIMITER) as wire:
        yield Connection(target, wire, None if key is None else Path(key))


@dataclass(frozen=True)
class RobotHeard:
    """A robot in range.

    Attributes:
        target: what ``connect`` and ``run`` take: ``ble:NAME``, or its address where two have one name.
        address: as this computer's Bluetooth has it.
        signal_dbm: how strong it is heard.
        robot: the id of the robot that its firmware is for; None where it did not answer.
        table_crc: CRC-32 of its table.
        state: DISARMED, ARMED, RUNNING or FAULT.
        owned: it takes commands from its owner alone.
        error: why it did not answer; "" where it did.
    """

    target: str
    address: str
    signal_dbm: int
    robot: str | None = None
    table_crc: int | None = None
    state: str | None = None
    owned: bool | None = None
    error: str = ""

    def as_json(self) -> dict[str, Any]:
        """One of ``robots`` of the command ``scan``."""
        return asdict(self)


def scan(seconds: float = 4.0) -> list[RobotHeard]:
    """Robots that advertise by Bluetooth, the strongest first, and what each says of itself.

    Each is connected to for a moment; none is armed, disarmed or moved. A robot that is connected with
    another computer is not heard.

    Args:
        seconds: how long to listen.

    Raises:
        InputError: not 0.5 to 60 s, or the package for Bluetooth is not installed.
        WireError: no adapter, or no permission.
    """
    if not 0.5 <= seconds <= 60.0:
        raise InputError(f"listening for {seconds:g} s: give 0.5 to 60")
    require_wire(parse_target("ble:any"))
    from frogkick.link.ble import listen

    heard = listen(seconds)
    names = [one.name for one in heard]
    found = []
    for one in heard:
        alone = one.name and names.count(one.name) == 1
        seen = RobotHeard(f"ble:{one.name if alone else one.address}", one.address, one.signal_dbm)
        found.append(_with_what_it_says(seen))
    return found


def _with_what_it_says(heard: RobotHeard) -> RobotHeard:
    layout = link_layout()
    states = {number: name for name, number in layout.state.items()}
    try:
        with connect(f"ble:{heard.address}") as bot:
            told = bot.status()
    except FrogkickError as error:
        return replace(heard, error=str(error))
    return replace(
        heard,
        robot=str(told["robot_id"]),
        table_crc=int(told["table_crc"]),
        state=states.get(int(told["state"]), str(told["state"])),
        owned=told["owner"] != layout.owner["OPEN"],
    )


def require_target(target: str, others: tuple[str, ...] = ()) -> None:
    """Refuse a place where no robot takes tables.

    Args:
        target: where the robot is.
        others: what is possible besides ``ble:NAME`` and ``serial:PORT``.

    Raises:
        InputError: none of these, or one that needs a package which is not installed.
    """
    if target in others:
        return
    if not is_target(target):
        raise InputError(
            f"robot {target!r}{nearest_name(target, ('ble', 'serial', *others))} is no robot to talk to: "
            f"choose {', '.join(('ble:NAME', 'serial:PORT', *others))}"
        )
    require_wire(parse_target(target))


@contextmanager
def session_at(target: str, carried: Path | None, key: Path | None = None) -> Iterator[Session]:
    """A session with a robot.

    Args:
        target: as of ``require_target``.
        carried: table that a virtual robot is switched on with; others know their own.
        key: file of the owner's key.

    Raises:
        WireError: it cannot be reached.
    """
    if target != VIRTUAL:
        with opened(parse_target(target)) as wire:
            yield lab_session(wire, key)
        return
    assert carried is not None
    with simulated_robot(VIRTUAL, carried, robot_of_table(carried, None)) as port:
        yield Session(port)


def push_table(
    target: str,
    table: Table | Path | str,
    carried: Path | None = None,
    progress: Progress = False,
    key: Path | None = None,
) -> Pushed:
    """Send a table to a robot.

    Args:
        target: where the robot is.
        table: to send, or its file.
        carried: what it must carry now, if that matters; a virtual robot is switched on with it.
        progress: of the bytes sent.
        key: file of the owner's key.

    Raises:
        FrogkickError: see ``Connection.push``.
    """
    image = table.tables if isinstance(table, Table) else read_image(table)
    before = None if carried is None else read_image(carried)
    with session_at(target, carried, key) as session, shown(progress, "bytes sent") as tell:
        return push(session, image, before, tell)
