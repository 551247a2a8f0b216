"""What a host can tell of a run although frames from the robot were lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain

from frogkick.core.poses import Fix
from frogkick.link.frames import Frame
from frogkick.link.layout import Value, link_layout
from frogkick.link.log import LogError, fetch_log
from frogkick.runs.record import DISARMED, DROPPED, ENDED, UNHEARD
from frogkick.runs.session import Session

LATE_S = 1.0
"""Longest time from a decision's time to its event: a plan may take so long."""


@dataclass
class EventGaps:
    """Counts the events that were lost, by the numbers of those that come."""

    lost: int = 0  # so far
    just_lost: int = 0  # just before the newest event
    _newest: int | None = None

    def note(self, event: Frame) -> None:
        """Take the next event. Numbers of events go on from run to run: of the first one its own counts."""
        if self._newest is not None:
            self.just_lost = (event.sequence - self._newest - 1) & 0xFF
        elif event.name == "DECISION":
            self.just_lost = int(event.values["decision"])
        self.lost += self.just_lost
        self._newest = event.sequence


def is_answer_to(answer: Frame, fix: Fix) -> bool:
    """Whether an answer to FIX is that to a fix; a refusal may not say to which."""
    values = answer.values
    if values["status"] != 0 and not values["capture_us"]:
        return True
    return bool(values["fix_sequence"] == fix.sequence & 0xFFFF)


def why_ended(session: Session, status: Mapping[str, Value], is_back: bool) -> tuple[str, bool]:
    """Why the robot ended a run if its ENDED was lost, and whether it completed it: by its log and its state.

    Args:
        status: its answer to STATUS after the end.
        is_back: the connection was lost meanwhile, and is back.
    """
    name = _end_in_log(session)
    if name and not (is_back and name == "STALE"):
        return ENDED.get(name, name), name == "OK"
    if is_back:
        return DROPPED, False
    is_disarmed = status["state"] == link_layout().state["DISARMED"]
    return why_disarmed(status) if is_disarmed else UNHEARD, False


def why_disarmed(status: Mapping[str, Value]) -> str:
    """Why a robot disarmed itself, by its answer to STATUS."""
    return DISARMED if status["supply"] == link_layout().supply["OK"] else ENDED["SUPPLY"]


def _end_in_log(session: Session) -> str:
    """Status of the last run's ENDED in the robot's log; "" if the log has none, or there is no log."""
    try:
        log = fetch_log(session)
    except LogError:
        return ""
    end = ""
    for record in chain.from_iterable(log.records()):
        if record.name == "ENDED":
            end = link_layout().status_name(int(record.values["status"]))
        elif record.name == "BOOT" or record.command == "START":
            end = ""
    return end
