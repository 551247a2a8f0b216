"""A sweep over EGaIn fraction, frequency and phase offset, ranked by speed and by cost of transport.

A chunk is one EGaIn fraction and frequency with all phases. Its file names what it was made from, and a
finished chunk is not made again. So an interrupted sweep resumes, and its results have the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from frogkick.core.chunks import code_stamp
from frogkick.core.errors import InputError
from frogkick.core.files import write_text
from frogkick.der import WIDTH
from frogkick.effects import rods_of
from frogkick.effects.registry import own_code
from frogkick.effects.swims import Gait
from frogkick.robot import Robot
from frogkick.robot.profile import actuation
from frogkick.validation.gaits import CYCLES, FIRST_CYCLE, GaitSwim, swim_chunks, swim_gaits
from frogkick.validation.measured import Skipped

PHASE_TIE_MPS = 0.5e-3
"""Two phases of a design whose speeds differ by less are equal to this model, whose error over phase is
limited to this (``frogkick validate``)."""
_FORMAT = "frogkick sweep chunk"


@dataclass(frozen=True, order=True)
class Design:
    """EGaIn fraction (%) and frequency (Hz)."""

    egain_percent: float
    frequency_hz: float

    @property
    def name(self) -> str:
        """Name in files and texts."""
        return f"{self.egain_percent:g}pct_{self.frequency_hz:g}Hz"


@dataclass(frozen=True)
class SweepPlan:
    """The gaits of a sweep."""

    robot: Robot
    designs: tuple[Design, ...]
    phases: tuple[float, ...]  # of each design, ascending
    interpolated: frozenset[Design]  # whose limb profile lies between measured ones
    skipped: tuple[Skipped, ...]  # requested designs outside the measured ones

    @property
    def gaits(self) -> int:
        """Number of gaits."""
        return len(self.designs) * len(self.phases)


@dataclass(frozen=True)
class Point:
    """The result of one gait; ``failure`` is the reason if it has none."""

    gait: Gait
    speed_mps: float
    cost_of_transport: float
    failure: str = ""

    @property
    def cost_text(self) -> str:
        """Return its cost of transport in words."""
        cost = self.cost_of_transport
        return "cost of transport unknown" if math.isnan(cost) else f"cost of transport {cost:.0f}"

    @property
    def design(self) -> Design:
        """Return the design that swims it."""
        return Design(self.gait.egain_percent, self.gait.frequency_hz)


@dataclass(frozen=True)
class Sweep:
    """A finished sweep; points by design, then by phase."""

    plan: SweepPlan
    points: tuple[Point, ...]

    def of_design(self, design: Design) -> list[Point]:
        """Return the points of a design that have a result, by phase."""
        return [point for point in self.points if point.design == design and not point.failure]


def plan_sweep(
    robot: Robot,
    frequencies_hz: Sequence[float] | None = None,
    phases: int = 10,
    egain_percent: Sequence[float] | None = None,
) -> SweepPlan:
    """List the designs of a sweep.

    Args:
        frequencies_hz: frequencies of each fraction; None: those measured for it (for a fraction between
            measured ones, those of a neighbour).
        phases: number of phases, evenly spaced from 0.
        egain_percent: fractions; None: the measured ones.

    Raises:
        InputError: a count or value out of range, or no design within the measured profiles.
    """
    if not 1 <= phases <= 1000:
        raise InputError(f"phases is {phases}: give 1 to 1000")
    measured = {(p.egain_percent, p.frequency_hz) for p in robot.profiles}
    fractions = sorted({e for e, _ in measured} if egain_percent is None else set(egain_percent))
    known_hz = sorted({hz for _, hz in measured})
    designs: list[Design] = []
    interpolated: set[Design] = set()
    skipped: list[Skipped] = []
    for fraction in fractions:
        own_hz = [hz for e, hz in sorted(measured) if e == fraction]
        for hz in sorted(set(frequencies_hz)) if frequencies_hz is not None else own_hz or known_hz:
            design = Design(fraction, hz)
            try:
                if not (math.isfinite(fraction) and 0.0 < hz < math.inf):
                    raise InputError(
                        f"{fraction:g} % EGaIn at {hz:g} Hz is no gait: give a finite fraction and a "
                        "positive frequency"
                    )
                actuation(robot.profiles, fraction, hz)
            except InputError as error:
                skipped.append(Skipped(design.name, str(error)))
                continue
            designs.append(design)
            if (fraction, hz) not in measured:
                interpolated.add(design)
    if not designs:
        raise InputError(
            f"nothing to sweep: {skipped[0].reason}" if skipped else "nothing to sweep: name a fraction"
        )
    steps = tuple(round(k / phases, 12) for k in range(phases))
    return SweepPlan(robot, tuple(designs), steps, frozenset(interpolated), tuple(skipped))


def run_sweep(
    plan: SweepPlan,
    out: Path,
    workers: int,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    cluster: str | None = None,
) -> Sweep:
    """Simulate the gaits that ``out/chunks`` does not contain yet, and return all.

    Args:
        out: folder; each finished chunk is written to ``chunks/<design>.json``.
        cluster: address of a Dask scheduler to simulate on; the files are written here.

    Raises:
        InputError: workers out of range, no cluster at the address, or a folder that cannot be written.
        FrogkickError: a worker died, or the cluster failed.
    """
    key = _key(plan)
    found = {design: _read_chunk(_chunk_file(out, design), key, plan, design) for design in plan.designs}
    missing = [design for design in plan.designs if found[design] is None]
    done = len(plan.designs) - len(missing)
    progress(done * len(plan.phases), plan.gaits)
    # A task is as many designs as fill the lanes of the simulation; each is a chunk file of its own.
    together = WIDTH // math.gcd(WIDTH, len(plan.phases))
    tasks = [missing[first : first + together] for first in range(0, len(missing), together)]
    gaits = [[gait for design in task for gait in _gaits(plan, design)] for task in tasks]
    for index, swum in swim_chunks(plan.robot, plan.robot.profiles, gaits, workers, cluster):
        points = [
            Point(gait, math.nan, math.nan, result)
            if isinstance(result, str)
            else Point(gait, result.speed_mps, result.cost_of_transport)
            for gait, result in zip(gaits[index], swum, strict=True)
        ]
        for place, design in enumerate(tasks[index]):
            own = points[place * len(plan.phases) : (place + 1) * len(plan.phases)]
            write_text(_chunk_file(out, design), _chunk_text(key, own))
            found[design] = own
        done += len(tasks[index])
        progress(done * len(plan.phases), plan.gaits)
    return Sweep(plan, tuple(point for design in plan.designs for point in found[design] or ()))


def _gaits(plan: SweepPlan, design: Design) -> list[Gait]:
    return [Gait(design.egain_percent, design.frequency_hz, phase) for phase in plan.phases]


def _chunk_file(out: Path, design: Design) -> Path:
    return out / "chunks" / f"{design.name}.json"


def _key(plan: SweepPlan) -> str:
    """Return a hash of all that a chunk depends on: robot, phases, code of frogkick and of effects."""
    digest = hashlib.sha256(plan.robot.sha256)
    digest.update(repr((code_stamp(), plan.phases)).encode("ascii"))
    digest.update(own_code(plan.robot))
    return digest.hexdigest()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def point_row(point: Point) -> dict[str, float | str | None]:
    """Return a point as JSON values; non-finite numbers become null."""
    row: dict[str, float | str | None] = {
        "egain_percent": point.gait.egain_percent,
        "frequency_hz": point.gait.frequency_hz,
        "phase": point.gait.phase,
        "speed_mps": _finite(point.speed_mps),
        "cost_of_transport": _finite(point.cost_of_transport),
    }
    return {**row, "failure": point.failure} if point.failure else row


def _chunk_text(key: str, points: Sequence[Point]) -> str:
    chunk = {"format": _FORMAT, "made_from": key, "points": [point_row(point) for point in points]}
    return json.dumps(chunk, indent=1, allow_nan=False) + "\n"


def _read_chunk(file: Path, key: str, plan: SweepPlan, design: Design) -> list[Point] | None:
    """Return the points of a chunk file; None if it is missing, incomplete, or of other origin."""
    try:
        chunk = json.loads(file.read_text(encoding="utf-8"))
        if chunk["format"] != _FORMAT or chunk["made_from"] != key:
            return None
        points = [_point_of(row, plan.robot) for row in chunk["points"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return points if [point.gait for point in points] == _gaits(plan, design) else None


def _point_of(row: dict[str, float | str | None], robot: Robot) -> Point:
    gait = Gait(*(float(row[name] or 0.0) for name in ("egain_percent", "frequency_hz", "phase")))
    failure = str(row.get("failure", ""))
    # Without forward motion the cost is infinite.
    missing = math.nan if failure or robot.cost_unknown else math.inf
    speed, cost = row["speed_mps"], row["cost_of_transport"]
    return Point(
        gait, math.nan if speed is None else float(speed), missing if cost is None else float(cost), failure
    )


Rank = Callable[[Point], float]


def by_speed(point: Point) -> float:
    """Fastest first."""
    return -point.speed_mps


def by_cost(point: Point) -> float:
    """Most efficient first."""
    return point.cost_of_transport


def listed_phase(points: Sequence[Point]) -> Point:
    """Return the point at the phase that is listed for a design.

    Of the phases within PHASE_TIE_MPS of the fastest it is the one nearest to half a cycle. There the two
    groups of limbs fire farthest apart and draw the least current at once.
    """
    fastest = max(point.speed_mps for point in points)
    tied = [point for point in points if point.speed_mps >= fastest - PHASE_TIE_MPS]
    return min(tied, key=lambda point: (abs(point.gait.phase - 0.5), point.gait.phase))


def rank_designs(sweep: Sweep, order: Rank, phase: float | None = None) -> list[Point]:
    """Return each design at its listed phase, or at the given one, best first; ties in the sweep's order."""
    ranked: list[Point] = []
    for design in sweep.plan.designs:
        points = [p for p in sweep.of_design(design) if phase is None or p.gait.phase == phase]
        if points:
            ranked.append(listed_phase(points))
    return sorted((point for point in ranked if not math.isnan(order(point))), key=order)


def rank_gaits(sweep: Sweep, order: Rank) -> list[Point]:
    """Return all gaits, best first; ties in the sweep's order."""
    known = (point for point in sweep.points if not point.failure and not math.isnan(order(point)))
    return sorted(known, key=order)


def energy_model(robot: Robot) -> str:
    """Return a paragraph on what the cost of transport includes."""
    if robot.cost_unknown:
        return f"{robot.cost_unknown[0].upper()}{robot.cost_unknown[1:]}."
    pulses = robot.gait_lead_mask.bit_count() + robot.gait_lag_mask.bit_count()
    return (
        "Cost of transport = electrical energy of a cycle / (weight in air x distance of a cycle). A cycle "
        f"is {pulses} pulses of {robot.pulse_energy_j:g} J, the same at every frequency, phase and EGaIn "
        f"fraction; the weight is that of {robot.mass_kg:.4f} kg; the distance is speed / frequency over "
        f"cycles {FIRST_CYCLE} to {CYCLES}. It includes neither the robot's electronics nor the change of a "
        "limb's heat capacity with its EGaIn fraction."
    )


PAPER_PHASE = 0.5


@dataclass(frozen=True)
class PaperWinner:
    """A design that the paper names as one of its two best, simulated at phase 0.5."""

    design: Design
    authors_mps: float  # over cycles 5 to 8 of the authors' published run
    speed_mps: float | None = None  # the paper's figure: this or the next
    cost_of_transport: float | None = None
    authors_mean_mps: float | None = None  # over all PAPER_CYCLES cycles from rest; for the two fastest


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
    """A winner of the paper in this sweep."""

    winner: PaperWinner
    ours: Point  # the same gait here
    rank: int  # rank of its design at the paper's phase, from 1
    rank_all_phases: int  # rank of its design if each design has its listed phase
    best: Point  # its design at its fastest phase
    # mean speed of the same gait over PAPER_CYCLES cycles from rest, like the paper's figure
    mean_speed_mps: float

    @property
    def agrees(self) -> bool:
        """Whether it is one of the two best here as well."""
        return self.rank <= 2

    @property
    def why(self) -> str:
        """The difference from the paper's figure and its reason, in measured values."""
        winner, ours = self.winner, self.ours
        if winner.speed_mps is not None and winner.authors_mean_mps is not None:
            return (
                f"The paper's {1e3 * winner.speed_mps:.0f} mm/s agrees with the mean of the authors' "
                f"published run over all its {PAPER_CYCLES} cycles from rest "
                f"({1e3 * winner.authors_mean_mps:.1f}); the same mean here is "
                f"{1e3 * self.mean_speed_mps:.1f}. Over cycles {FIRST_CYCLE} to {CYCLES}, as the ranking "
                f"counts, that run swims {1e3 * winner.authors_mps:.1f} and this model "
                f"{1e3 * ours.speed_mps:.1f} mm/s."
            )
        hz, cost = ours.gait.frequency_hz, ours.cost_of_transport
        same = cost * ours.speed_mps / winner.authors_mps
        rounded = cost * ours.speed_mps / round(winner.authors_mps, 3)
        return (
            f"The pulse energy is matched to the paper. With it the authors' published run, "
            f"{1e3 * winner.authors_mps:.1f} mm/s at {hz:g} Hz, costs {same:.0f}, and with that speed "
            f"rounded to a whole mm/s {rounded:.0f}; this model swims {1e3 * ours.speed_mps:.1f} mm/s and "
            f"costs {cost:.0f}."
        )


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
        ranks = [[point.design for point in ranked] for ranked in (at_phase, at_any)]
        if not all(winner.design in designs for designs in ranks):
            continue
        rank, rank_any = (designs.index(winner.design) for designs in ranks)
        ours = at_phase[rank]
        (swum,) = swim_gaits(rods_of(robot), robot.profiles, [ours.gait], PAPER_CYCLES)
        mean = swum.forward_m[-1] / swum.time_s[-1] if isinstance(swum, GaitSwim) else math.nan
        best = min(sweep.of_design(winner.design), key=order)
        verdicts.append(Verdict(winner, ours, rank + 1, rank_any + 1, best, float(mean)))
    return verdicts
