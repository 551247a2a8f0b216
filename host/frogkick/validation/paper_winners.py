"""The paper's best designs compared with those of a sweep, and the reasons of differences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from frogkick.der import prepare
from frogkick.validation.gaits import CYCLES, FIRST_CYCLE, GaitSwim, swim_gaits
from frogkick.validation.sweep import Design, Point, Rank, Sweep, by_cost, by_speed, rank_designs

PAPER_PHASE = 0.5


@dataclass(frozen=True)
class PaperWinner:
    """A design that the paper names as one of its two best, simulated at phase 0.5.

    Attributes:
        authors_mps: speed over cycles 5 to 8 of the authors' published run.
        speed_mps, cost_of_transport: the paper's figure, one of the two.
        authors_mean_mps: mean speed over all PAPER_CYCLES cycles of that run from rest; only for the two
            fastest.
    """

    design: Design
    authors_mps: float
    speed_mps: float | None = None
    cost_of_transport: float | None = None
    authors_mean_mps: float | None = None


# Huang 2022; the last decimals from the runs published with it.
PAPER_ROBOT = "frog2022"
PAPER_CYCLES = 24
PAPER_WINNERS = (
    PaperWinner(Design(30.0, 1.3), 0.04940, speed_mps=0.047, authors_mean_mps=0.04694),
    PaperWinner(Design(30.0, 1.4), 0.05054, speed_mps=0.048, authors_mean_mps=0.04803),
    PaperWinner(Design(10.0, 0.4), 0.02470, cost_of_transport=158.0),
    PaperWinner(Design(10.0, 0.5), 0.03029, cost_of_transport=165.0),
)


@dataclass(frozen=True)
class Verdict:
    """A winner of the paper in this sweep.

    Attributes:
        ours: the same gait here.
        rank: rank of its design at the paper's phase, from 1.
        rank_all_phases: rank of its design if each design has its listed phase.
        best: its design at its fastest phase.
        mean_speed_mps: mean speed of the same gait over PAPER_CYCLES cycles from rest, like the paper's
            figure.
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
        """Whether it is one of the two best here as well."""
        return self.rank <= 2

    @property
    def why(self) -> str:
        """The difference from the paper's figure and its reason, in measured values."""
        return _explain(self)


def paper_verdicts(sweep: Sweep) -> list[Verdict]:
    """Compare the paper's winners with a sweep; empty for another robot, or if the sweep lacks their
    phase."""
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


def _explain(verdict: Verdict) -> str:
    winner, ours = verdict.winner, verdict.ours
    if winner.speed_mps is not None and winner.authors_mean_mps is not None:
        return (
            f"The paper's {1e3 * winner.speed_mps:.0f} mm/s agrees with the mean of the authors' published "
            f"run over all its {PAPER_CYCLES} cycles from rest ({1e3 * winner.authors_mean_mps:.1f}); the "
            f"same mean here is {1e3 * verdict.mean_speed_mps:.1f}. Over cycles {FIRST_CYCLE} to {CYCLES}, "
            f"as the ranking counts, that run swims {1e3 * winner.authors_mps:.1f} and this model "
            f"{1e3 * ours.speed_mps:.1f} mm/s."
        )
    hz, cost = ours.gait.frequency_hz, ours.cost_of_transport
    same = cost * ours.speed_mps / winner.authors_mps
    rounded = cost * ours.speed_mps / round(winner.authors_mps, 3)
    return (
        f"The pulse energy is matched to the paper. With it the authors' published run, "
        f"{1e3 * winner.authors_mps:.1f} mm/s at {hz:g} Hz, costs {same:.0f}, and with that speed rounded to "
        f"a whole mm/s {rounded:.0f}; this model swims {1e3 * ours.speed_mps:.1f} mm/s and costs {cost:.0f}."
    )
