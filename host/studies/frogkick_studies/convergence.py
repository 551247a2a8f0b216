"""Error of the rod simulation against its time step: the order, and the error at the default step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64
from frogkick.core.errors import ConvergenceError
from frogkick.core.progress import shown
from frogkick.der import STEP_S, prepare
from frogkick.effects.acting import program_of
from frogkick.effects.swims import Gait, Trajectory, simulate_gaits, simulate_many
from frogkick.report import style
from frogkick.robot import Robot, load_robot
from frogkick_studies import StudyResult
from frogkick_studies.configs import Convergence

STEPS_S = (0.0064, 0.0032, 0.0016, 0.0008, 0.0004)
REFERENCE_STEP_S = 0.0001
ERROR_LIMIT = 0.002  # of the distance, at the default step
GAIT_CYCLES = 8  # the speed counts from cycle 5 to 8
PHASES = (0.0, 0.25, 0.5, 0.75)


@dataclass(frozen=True, eq=False)
class Curve:
    """Errors of one kind of simulation.

    Attributes:
        name: "strokes" (one period of each action, from rest and from cruising) or "gaits" (speed).
        step_s: (n,) finest steps, longest first.
        error: (n,) root-mean-square relative error of distance or speed against the reference step.
        worst: (n,) largest relative error.
    """

    name: str
    step_s: Float64
    error: Float64
    worst: Float64

    @property
    def order(self) -> float:
        """Slope of log(error) over log(step), by least squares."""
        return float(np.polyfit(np.log(self.step_s), np.log(self.error), 1)[0])

    @property
    def at_default(self) -> float:
        """Root mean square error at the default step, interpolated along the curve."""
        order = np.argsort(self.step_s)
        logs = np.log(self.step_s[order]), np.log(self.error[order])
        return float(np.exp(np.interp(np.log(STEP_S), *logs)))


def convergence(
    robot: Robot, progress: Callable[[int, int], None] = lambda _done, _all: None, every: int = 1
) -> list[Curve]:
    """Simulate strokes and gaits at several steps, and compare them with a fine step.

    Args:
        progress: called with (simulations done, all); a simulation is one step length of one kind.
        every: use each n-th gait of all, which are each measured profile at four phases.

    Returns:
        The curve of the strokes and the curve of the gaits.
    """
    robot = replace(robot, effects=())  # the error of the rods alone
    gait_speeds = partial(_gait_speeds, _gaits(robot)[::every])
    done, whole = 0, 2 * (len(STEPS_S) + 1)
    curves = []
    for name, measure in (("strokes", _stroke_distances), ("gaits", gait_speeds)):
        reference = measure(robot, REFERENCE_STEP_S)
        rows = []
        progress(done := done + 1, whole)
        for step_s in STEPS_S:
            rows.append(np.abs(measure(robot, step_s) / reference - 1.0))
            progress(done := done + 1, whole)
        errors = np.array(rows)
        curves.append(Curve(name, np.array(STEPS_S), np.sqrt((errors**2).mean(axis=1)), errors.max(axis=1)))
    return curves


def _stroke_distances(robot: Robot, step_s: float) -> Float64:
    """Return distances (m) over one period of each action, from rest and from the middle of the box."""
    box = robot.library_box
    cruising = [sum(ends) / 2.0 for ends in (box.forward_mps, box.left_mps, box.omega_rad_s)]
    programs = [program for action in robot.actions if (program := program_of(robot, action))]
    velocities = np.array([[0.0, 0.0, 0.0]] * len(programs) + [cruising] * len(programs))
    motions = simulate_many(prepare(robot), velocities, programs * 2, [robot.period_s], step_s=step_s)
    _no_failures(motions.failures.values())
    return np.hypot(motions.pose_world[:, -1, 0], motions.pose_world[:, -1, 1])


def _gait_speeds(gaits: Sequence[Gait], robot: Robot, step_s: float) -> Float64:
    swum = simulate_gaits(robot, gaits, GAIT_CYCLES, step_s=step_s)
    _no_failures(result for result in swum if not isinstance(result, Trajectory))
    return np.array([result.speed_mps for result in swum if isinstance(result, Trajectory)])


def _no_failures(failures: Iterable[object]) -> None:
    for failure in failures:
        raise ConvergenceError(f"a simulation of the convergence study failed: {failure}")


def _gaits(robot: Robot) -> Sequence[Gait]:
    """Return each measured profile at four phases, lowest frequency first."""
    profiles = sorted(robot.profiles, key=lambda profile: profile.frequency_hz)
    return [Gait(p.egain_percent, p.frequency_hz, phase) for p in profiles for phase in PHASES]


@dataclass(frozen=True, eq=False)
class ConvergenceStudy(StudyResult):
    """The curves of ``convergence``: strokes and gaits."""

    curves: Sequence[Curve]

    @property
    def passed(self) -> bool:
        """Whether the error of the default step is within its limit."""
        return not any(curve.worst[curve.step_s == STEP_S].max() > ERROR_LIMIT for curve in self.curves)

    def plot(self) -> Figure:
        """Draw the errors with a second-order slope, the default step and the limit."""
        with style.new_figure(6.4, 4.6) as figure:
            axes = figure.subplots()
            for curve, colour, marker in zip(self.curves, (style.TRUE, style.MEASURED), "os", strict=False):
                step_ms = 1e3 * curve.step_s
                axes.loglog(
                    step_ms,
                    100 * curve.error,
                    marker + "-",
                    color=colour,
                    label=f"{curve.name}: RMS, order {curve.order:.2f}",
                )
                axes.loglog(
                    step_ms, 100 * curve.worst, marker + ":", color=colour, label=f"{curve.name}: worst"
                )
            first = self.curves[0]
            guide = first.error[-1] * (first.step_s / first.step_s[-1]) ** 2
            axes.loglog(1e3 * first.step_s, 50 * guide, "--", color=style.DESIRED, label="slope 2")
            axes.axvline(1e3 * STEP_S, color=style.ESTIMATED, linewidth=1)
            axes.axhline(100 * ERROR_LIMIT, color=style.ALARM, linewidth=1)
            axes.text(1e3 * STEP_S, axes.get_ylim()[0] * 1.3, " default", color=style.ESTIMATED)
            axes.text(
                1e3 * first.step_s.max(),
                85 * ERROR_LIMIT,
                "limit at the default step",
                color=style.ALARM,
                ha="right",
                va="top",
            )
            axes.set_xticks(1e3 * np.sort(first.step_s), [f"{ms:g}" for ms in 1e3 * np.sort(first.step_s)])
            axes.minorticks_off()
            axes.set_xlabel("finest time step (ms)")
            axes.set_ylabel("error of distance or speed (%)")
            axes.set_title("Error of the rod simulation against its time step")
            axes.legend(loc="upper left")
        return figure

    def as_json(self) -> dict[str, Any]:
        return {
            "default_step_s": STEP_S,
            "limit": ERROR_LIMIT,
            "order": {curve.name: round(curve.order, 3) for curve in self.curves},
            "error_at_default": {curve.name: curve.at_default for curve in self.curves},
            **{
                key: {
                    curve.name: dict(zip(curve.step_s.tolist(), getattr(curve, name).tolist(), strict=True))
                    for curve in self.curves
                }
                for key, name in (("worst", "worst"), ("rms", "error"))
            },
        }


def run(config: Convergence) -> ConvergenceStudy:
    with shown(True, "convergence") as tell:
        return ConvergenceStudy(convergence(load_robot(config.robot), tell, config.every))
