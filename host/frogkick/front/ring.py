"""The whole loop once: library, table, firmware, paths on the virtual chip, and a worn limb identified."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frogkick.core.files import require_writable
from frogkick.core.progress import Progress, Tell, shown
from frogkick.front.places import plan_config
from frogkick.robot import Robot, load_robot
from frogkick_codegen.firmware import require_tools

if TYPE_CHECKING:
    from frogkick.ring import Closing, Ring

__all__ = ["Demonstration", "demonstrate"]


@dataclass(frozen=True, eq=False, repr=False)
class Demonstration:
    """The result of one pass through the loop.

    Attributes:
        ring: runs, table, firmware, its test, and the time of each stage.
        closing: the result for the worn limb.
        report: the page that shows everything.
    """

    ring: Ring
    closing: Closing
    report: Path

    @property
    def paths(self) -> dict[str, dict[str, Any]]:
        """Path -> its tracking values, and the number of decisions in which chip and Python twin differ."""
        return {
            run.log.path.name: {**run.tracking.as_json(), "mismatches": run.mismatches}
            for run in self.ring.runs
            if run.log.path is not None
        }

    @property
    def passed(self) -> bool:
        """Whether chip and twin agreed, no limit was broken, and the firmware passed its test."""
        broken = any(run.mismatches or run.tracking.limit_violations for run in self.ring.runs)
        return self.ring.chip.passed and not broken

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``demo``."""
        return {
            "mean_distance_m": self.ring.mean_distance_m,
            "paths": self.paths,
            **self.closing.as_json(),  # before and after: see Closing
            "table_missed": {**self.ring.missed.as_json(), "periods": self.ring.missed.count},
            "chip_checks_passed": self.ring.chip.passed,
            "report": str(self.report),
        }

    def __repr__(self) -> str:
        return (
            f"Demonstration({len(self.ring.runs)} paths, {1e3 * self.ring.mean_distance_m:.1f} mm from them; "
            f"{self.closing.outcome.verdict})"
        )


def demonstrate(
    out: Path | str,
    robot: Robot | str = "frog2022",
    *,
    states: int = 300,
    depth: int | None = None,
    seed: int = 0,
    progress: Progress = False,
) -> Demonstration:
    """Simulate, make tables, build the firmware and swim on the virtual chip; then identify a worn limb.

    Args:
        out: folder for all results: library, tables, C, firmware, logs and two pages.
        robot: the robot, its name or its TOML file.
        states: number of initial velocities of the library, 10 to 2000.
        depth: periods to look ahead, 1 to 4; None: the robot's own.
        seed: seed of the sampling, of the camera's noise, and of the limb that is worn.
        progress: of each stage: True for bars, or a function of (done, all).

    Raises:
        InputError: an unknown robot, a folder that cannot be written, or an extra that is not installed.
        FrogkickError: an error of a stage.
    """
    described = load_robot(robot)
    folder = Path(out)
    require_writable(folder, folder=True)
    require_tools("bench")
    # The modules below cannot be loaded without the extra.
    from frogkick.report.identify_page import write_identify_page
    from frogkick.report.ring_page import write_ring_report
    from frogkick.ring import close, go_round

    def bar(title: str) -> AbstractContextManager[Tell]:
        return shown(progress, title)

    levels = plan_config(described, "robot", depth).depth
    ring = go_round(described, folder, states, levels, seed, bar)
    close(ring, folder, seed, bar)
    assert ring.closing is not None
    report = folder / "report.html"
    write_identify_page(folder / "identify.html", ring.closing.outcome)
    write_ring_report(report, ring)
    return Demonstration(ring, ring.closing, report)
