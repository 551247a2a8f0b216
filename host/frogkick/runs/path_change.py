"""Paths that take over during a run: when each is sent to the robot, and from which decision on it counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from frogkick.core.poses import Fix
from frogkick.link.frames import Frame, path_frames
from frogkick.link.layout import link_layout
from frogkick.paths import Path
from frogkick.runs.decision import STALE, Decision
from frogkick.runs.holding import Holding
from frogkick.runs.runlog import PathChange
from frogkick.runs.session import LinkError, Session

TRIES = 3


@dataclass(frozen=True, eq=False)
class NextPath:
    """A path that takes over during a run.

    Attributes:
        path: where to swim then, world frame.
        at_s: when, since the first decision.
        here: the path is moved, so that it begins where the robot then is, and leads where it points.
    """

    path: Path
    at_s: float
    here: bool = False


class PathSender:
    """Sends a running robot a path, part by part, while its other frames are handled in their order."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._path: Path | None = None
        self._sent = self._tries = 0
        self._sequence = -1

    def begin(self, path: Path) -> None:
        """Send the first part; one that is still on its way is given up."""
        self._path = path
        columns = (path.x_m.tolist(), path.y_m.tolist(), path.tangent_rad.tolist())
        self._parts = list(path_frames(list(zip(*columns, strict=True))))
        self._sent = self._tries = 0
        self._send()

    def _send(self) -> None:
        values, rows = self._parts[self._sent]
        self._sequence = self._session.post("PATH", values, rows)
        self._sent += 1

    def answered(self, frame: Frame) -> Path | None:
        """Take an answer to PATH and send the next part; return the path where it has all arrived.

        Raises:
            LinkError: the robot refuses it again and again.
        """
        if self._path is None or frame.sequence != self._sequence:
            return None
        status = int(frame.values["status"])
        if status != 0:
            self._tries += 1
            if self._tries >= TRIES:
                raise LinkError(
                    f"the robot refuses the path {self._path.name!r} that was to take over: "
                    f"{link_layout().status_name(status)}; run again"
                )
            self._sent = 0
        if self._sent < len(self._parts):
            self._send()
            return None
        path, self._path = self._path, None
        return path


@dataclass
class PathChanges:
    """The paths that follow a run's first one.

    Attributes:
        planned: in the order of their times.
        made: those that are followed already.
        holding: holds at the end of whatever path is followed; None: the run ends there.
    """

    planned: Sequence[NextPath]
    made: list[PathChange] = field(default_factory=list)
    holding: Holding | None = None
    _begun: int = 0
    _arrived: Path | None = None

    def due(self, since_s: float, fixes: Sequence[Fix], decisions: Sequence[Decision]) -> Path | None:
        """Return the path to send now, or None.

        Args:
            since_s: time since the first decision.
            fixes: so far, of which the newest says where the robot is.
            decisions: so far, of which the last says how far along its path the robot is.
        """
        if self._begun < len(self.planned) and since_s >= self.planned[self._begun].at_s:
            following = self.planned[self._begun]
            if not following.here or fixes:
                self._begun += 1
                if not following.here:
                    return following.path
                return following.path.place(following.path.motion_to(fixes[-1].pose_world.tolist()))
        return None if self.holding is None else self.holding.due(decisions)

    def arrived(self, path: Path) -> None:
        """Take note that whoever decides has a path."""
        self._arrived = path

    def decided(self, decisions: Sequence[Decision]) -> None:
        """Take note of a decision, the last one: without an estimate a path waits for the next one."""
        if self._arrived is not None and decisions[-1].status != STALE:
            hold = None if self.holding is None else self.holding.followed(self._arrived)
            self.made.append(PathChange(len(decisions) - 1, self._arrived, hold))
            self._arrived = None
        if self.holding is not None:
            self.holding.decided(decisions[-1])

    @property
    def holds(self) -> bool:
        """Whether the robot has come to circle the end of its path."""
        return self.holding is not None and self.holding.began
