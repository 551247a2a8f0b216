"""The connection to a real or virtual robot: its table, its state, and a run with it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from frogkick.core.arguments import typed
from frogkick.core.errors import FrogkickError, InputError, nearest_name
from frogkick.core.progress import Progress, shown
from frogkick.front.logs import Run
from frogkick.front.places import simulated_robot
from frogkick.front.running import run
from frogkick.front.tables import Table, robot_of_table
from frogkick.link.auth import default_key_file, read_keys
from frogkick.link.frames import DELIMITER
from frogkick.link.layout import link_layout
from frogkick.link.opening import opened, require_wire
from frogkick.link.wire import FORMS, KINDS, Wire, is_target, parse_target
from frogkick.paths import Path as SwimPath
from frogkick.runs.lab_session import LabSession, lab_session
from frogkick.runs.pushing import Pushed, own, push, roll_back
from frogkick.runs.session import Session
from frogkick.tables.image import read_image

__all__ = ["Camera", "Connection", "Pushed", "connect", "default_key_file", "push_table", "scan"]

VIRTUAL = "virtual"


@typed
@dataclass(frozen=True)
class Camera:
    """A calibrated camera over the pool, as a source of position fixes.

    Attributes:
        calibration: the file that ``frogkick camera calibrate`` wrote (.toml), which is checked at once.
        source: camera number, network camera's address, video file or folder of pictures.

    Raises:
        InputError: a calibration that does not exist or cannot be used.
    """

    calibration: Path | str
    source: str = "0"

    def __post_init__(self) -> None:
        from frogkick.vision.calibration import read_calibration

        read_calibration(self.calibration)
        if not isinstance(self.source, str):
            raise InputError(f"source is {self.source!r}: give a text, as '0' for the first camera")


@typed
@dataclass(frozen=True, repr=False)
class Connection:
    """A robot that is connected by Bluetooth or a serial line, see ``connect``.

    Each method raises a ``LinkError`` if the robot refuses or does not answer.

    Attributes:
        target: ``ble:NAME``, ``ble:ADDRESS`` or ``serial:PORT[:BAUD]``.
        wire: the open link to it.
        key: key file of a robot that has an owner; None: the user's own.
    """

    target: str
    wire: Wire
    key: Path | None = None

    def session(self) -> LabSession:
        """Begin a session: questions of the link's protocol, and their answers."""
        return lab_session(self.wire, self.key)

    def status(self) -> dict[str, Any]:
        """Return the fields of HELLO and STATUS, which the link's documentation describes."""
        session = self.session()
        return {**session.hello(), **session.request("STATUS")}

    def push(self, table: Table | Path | str, progress: Progress = False) -> Pushed:
        """Send the robot another table. It is disarmed and keeps the previous table.

        Raises:
            TableError: the table is for another robot.
            UploadError: the robot does not accept the table.
        """
        image = table.tables if isinstance(table, Table) else read_image(table)
        with shown(progress, "bytes sent") as tell:
            return push(self.session(), image, None, tell)

    def roll_back(self) -> Pushed:
        """Return to the previous table."""
        return roll_back(self.session())

    def own(self, release: bool = False, again: bool = False) -> None:
        """Restrict the robot to the commands of its owner, who has the key. It is disarmed.

        The robot gets a key of its own, which is added to the key file of ``connect``, or the user's own. A
        missing key file is made; keep a copy of it. DISARM and STOP never need the key.

        Args:
            release: let anybody command the robot again.
            again: give a new key to a robot that has lost the one which the file holds for it.

        Raises:
            InputError: both are given, or the key's file cannot be read or written.
        """
        if release and again:
            raise InputError("--release removes a key and --again gives one: give one of the two")
        own(self.session(), release, again)

    def follow(
        self,
        path: SwimPath | str,
        fixes: Camera | str,
        table: Table | Path | str | None = None,
        **options: Any,
    ) -> Run:
        """Follow a path with the robot, which is armed once all checks have passed.

        The robot is disarmed however the run ends.

        Args:
            path: the desired path in the world frame, a shape's name or a path file.
            fixes: a camera, or as for ``run``.
            table: the robot's own table; None: its default table.
            options: those of ``run``, which says what it raises: operator, plan, depth, begin, battery_v,
                time_limit_s, out and others.
        """
        if isinstance(fixes, Camera):
            options |= {"fixes": str(fixes.calibration), "source": fixes.source}
        else:
            options["fixes"] = fixes
        return run(table, path, robot=self.target, wire=self.wire, key=self.key, **options)

    def __repr__(self) -> str:
        return f"Connection({self.target!r})"


@typed
@contextmanager
def connect(target: str, key: Path | str | None = None) -> Iterator[Connection]:
    """Open the link to a robot, and close it at the end of the ``with`` block.

    Args:
        target: ``ble:NAME``, ``ble:ADDRESS`` or ``serial:PORT[:BAUD]``.
        key: key file of a robot that has an owner; None: ``frogkick/owner.key`` among the user's
            settings.

    Raises:
        InputError: an unknown kind of target.
        WireError: the robot cannot be reached.
    """
    require_target(target)
    if key is not None and Path(key).exists():  # 'own' makes a missing one
        read_keys(Path(key))
    with opened(parse_target(target), DELIMITER) as wire:
        yield Connection(target, wire, None if key is None else Path(key))


@dataclass(frozen=True)
class RobotHeard:
    """A robot in Bluetooth range.

    Attributes:
        target: target for ``connect`` and ``run``: ``ble:NAME``, or the address if two robots have one name.
        address: its address in this computer's Bluetooth.
        signal_dbm: strength of its signal.
        robot: the id of the robot that its firmware is for; None if it did not answer.
        table_crc: CRC-32 of its table.
        state: DISARMED, ARMED, RUNNING or FAULT.
        owned: whether it accepts commands only from its owner.
        error: the reason why it did not answer; "" if it did.
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


@typed
def scan(seconds: float = 4.0) -> list[RobotHeard]:
    """Return the robots in Bluetooth range with their state, the strongest signal first.

    Each robot is connected to for a moment. None is armed, disarmed or moved. A robot that is connected to
    another computer is not found.

    Args:
        seconds: time to listen.

    Raises:
        InputError: a time that is not 0.5 to 60 s, or the package for Bluetooth is not installed.
        WireError: no adapter is found, or its use is not permitted.
    """
    if not 0.5 <= seconds <= 60.0:
        raise InputError(f"the time to listen is {seconds:g} s: give 0.5 to 60")
    require_wire(parse_target("ble:any"))
    from frogkick.link.ble import listen

    heard = listen(seconds)
    names = [one.name for one in heard]
    layout, found = link_layout(), []
    states = {number: name for name, number in layout.state.items()}
    for one in heard:
        alone = one.name and names.count(one.name) == 1
        seen = RobotHeard(f"ble:{one.name if alone else one.address}", one.address, one.signal_dbm)
        try:
            with connect(f"ble:{one.address}") as bot:
                status = bot.status()
        except FrogkickError as error:
            found.append(replace(seen, error=str(error)))
            continue
        seen = replace(
            seen,
            robot=str(status["robot_id"]),
            table_crc=int(status["table_crc"]),
            state=states.get(int(status["state"]), str(status["state"])),
            owned=status["owner"] != layout.owner["OPEN"],
        )
        found.append(seen)
    return found


def require_target(target: str, others: tuple[str, ...] = ()) -> None:
    """Raise InputError for a target that is no robot, or that needs a package which is not installed."""
    if target in others:
        return
    if not is_target(target):
        raise InputError(
            f"robot {target!r}{nearest_name(target, (*KINDS, *others))} is not the target of a robot: choose "
            f"{', '.join((*FORMS, *others))}"
        )
    require_wire(parse_target(target))


def push_table(
    target: str,
    table: Path,
    carried: Path | None = None,
    progress: Progress = False,
    key: Path | None = None,
) -> Pushed:
    """Send a table to a robot, real or virtual.

    If ``carried`` is given, the robot must have that table now; a virtual robot starts with it.
    """
    image, before = read_image(table), None if carried is None else read_image(carried)
    with ExitStack() as stack:
        if target == VIRTUAL and carried is not None:
            virtual = simulated_robot(VIRTUAL, carried, robot_of_table(carried))
            session = Session(stack.enter_context(virtual))
        else:
            if key is not None:
                read_keys(key)  # a missing one is an error here
            session = stack.enter_context(connect(target, key)).session()
        tell = stack.enter_context(shown(progress, "bytes sent"))
        return push(session, image, before, tell)
