"""Whether a sweep finds the winners that the paper names, and what is behind its figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from frogkick.der import prepare
from frogkick.study.gaits import GaitSwim, swim_gaits
from frogkick.study.sweep import Design, Point, Rank, Sweep, by_cost, by_speed, rank_designs

PAPER_PHASE = 0.5


@dataclass(frozen=True)
class PaperWinner:
    """A design that the paper names as one of its two best at phase 0.5, with the paper's figure."""

    design: Design
    speed_mps: float | None = None
    cost_of_transport: float | None = None


# Huang 2022, simulated, at phase offset 0.5.
PAPER_ROBOT = "frog2022"
PAPER_WINNERS = (
    PaperWinner(Design(30.0, 1.3), speed_mps=0.047),
    PaperWinner(Design(30.0, 1.4), speed_mps=0.048),
    PaperWinner(Design(10.0, 0.4), cost_of_transport=158.0),
    PaperWinner(Design(10.0, 0.5), cost_of_transport=165.0),
)
PAPER_CYCLES = 24
"""The authors' exported runs of these two speeds end after this many cycles, and their mean over all of it,
from rest, is the paper's figure: 46.94 and 48.03 mm/s. Over cycles 5 to 8 they give 49.40 and 50.54."""
PAPER_ENERGY_M = 9.9
"""E / (m g) of a cycle that gives the paper's 158 and 165 from speeds rounded to 25 and 30 mm/s; with those
in the authors' files, 24.70 and 30.29 mm/s over cycles 5 to 8, it gives 160 and 163."""


@dataclass(frozen=True)
class Verdict:
    """A winner of the paper in this sweep.

    Attributes:
        ours: the same gait here.
        rank: of its design at the paper's phase, counted from 1.
        rank_all_phases: of its design when every design has its listed phase.
        best: its design at the phase that is fastest to the last digit.
        mean_speed_mps: of the same gait over PAPER_CYCLES cycles from rest, as the paper's figure for speed.
        ahead: the designs before it at the paper's phase.
    """

    winner: PaperWinner
    ours: Point
    rank: int
    rank_all_phases: int
    best: Point
    mean_speed_mps: float
    ahead: tuple[Point, ...]

    @property
    def agrees(self) -> bool:
        """Whether it is one of the two best here, too."""
        return self.rank <= 2


def paper_verdicts(sweep: Sweep) -> list[Verdict]:
    """What this sweep says of the paper's winners; empty for another robot or without them in the sweep."""
    robot = sweep.plan.robot
    if robot.id != PAPER_ROBOT or PAPER_PHASE not in sweep.plan.phases:
        return []
    verdicts: list[Verdict] = []
    for winner in PAPER_WINNERS:
        order: Rank = by_cost if winner.speed_mps is None else by_speed
        at_phase, at_any = rank_designs(sweep, order, PAPER_PHASE), rank_designs(sweep, order)
        rank, rank_any = _place(at_phase, winner.design), _place(at_any, winner.design)
        if rank is None or rank_any is None:
            continue
        ours = at_phase[rank]
        (swum,) = swim_gaits(prepare(robot), robot.profiles, [ours.gait], PAPER_CYCLES)
        mean = swum.forward_m[-1] / swum.time_s[-1] if isinstance(swum, GaitSwim) else math.nan
        best = min(sweep.of_design(winner.design), key=order)
        verdicts.append(
            Verdict(winner, ours, rank + 1, rank_any + 1, best, float(mean), tuple(at_phase[:rank]))
        )
    return verdicts


def _place(ranked: Sequence[Point], design: Design) -> int | None:
    for index, point in enumerate(ranked):
        if (point.gait.egain_percent, point.gait.frequency_hz) == (design.egain_percent, design.frequency_hz):
            return index
    return None
