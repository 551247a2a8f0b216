"""A robot's decisions made again on the host while the run goes on, and compared bit by bit.

The twin is fed with what the robot says that it met, in the robot's order and on its clock, so that the two
must agree whatever the radio did. Where something that the robot said may have been lost, the twin knows no
longer what the robot knows: from there on nothing is compared, and that is told.
"""

from __future__ import annotations

from collections.abc import Sequence

from frogkick.core.errors import CheckError
from frogkick.paths import Path
from frogkick.planner.plan import PlanConfig
from frogkick.runs.decision import Decision, DecisionTwin, RobotEvent
from frogkick.tables.image import Tables


class LiveCheck:
    """The comparison of one run.

    Attributes:
        agreed: decisions that the host made the same.
        unchecked: decisions after something that the robot said may have been lost.
    """

    def __init__(self) -> None:
        """Compare nothing yet."""
        self.agreed = 0
        self.unchecked = 0
        self._twin: DecisionTwin | None = None
        self._names: list[str] = []

    def begin(self, tables: Tables, path: Path, config: PlanConfig) -> None:
        """Begin with a run's tables, path as it was placed, and weights."""
        self.agreed = self.unchecked = 0
        self._twin = DecisionTwin(tables, path, config)
        self._names = [row.name for row in tables.actions]

    def compare(self, events: Sequence[RobotEvent], decision: Decision | None, gaps: int) -> None:
        """Live through what one frame told.

        Args:
            events: of the frame.
            decision: that the frame told, or None.
            gaps: how often something that the robot said may have been lost so far.

        Raises:
            CheckError: the host decides otherwise.
        """
        if self._twin is None or gaps or self.unchecked:
            self.unchecked += decision is not None
            return
        ours = None
        for event in events:
            ours = self._twin.apply(event) or ours
        if decision is None:
            return
        assert ours is not None
        differing = decision.differences(ours)
        if differing:
            theirs, mine = (self._name(one) for one in (decision, ours))
            raise CheckError(
                f"decision {self.agreed + 1} is {theirs} on the robot and {mine} on the host (different: "
                f"{', '.join(differing)}), where every bit must be the same: the run is ended; send "
                "the robot its table again ('frogkick push') or flash it"
            )
        self.agreed += 1

    @property
    def said(self) -> str:
        """For people, beside the progress."""
        told = f"host agrees with {self.agreed} decisions"
        return f"{told}, {self.unchecked} not compared after a gap" if self.unchecked else told

    def as_json(self) -> dict[str, int]:
        """Keys beside those of the run; a mismatch would have ended it."""
        return {"decisions_checked": self.agreed, "decisions_unchecked": self.unchecked, "mismatches": 0}

    def _name(self, decision: Decision) -> str:
        return self._names[decision.action] if decision.action < len(self._names) else "no action"
