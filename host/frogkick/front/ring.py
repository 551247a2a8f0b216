"""The whole ring once: library, table, firmware, paths on the virtual chip; then a worn limb, found."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frogkick.core.files import require_writable
from frogkick.core.progress import Progress, shown
from frogkick.front.places import plan_config
from frogkick.robot import Robot, load_robot
from frogkick_codegen.firmware import require_tools

if TYPE_CHECKING:
    from frogkick.ring import Closing, Ring

__all__ = ["Demonstration", "demonstrate"]


@dataclass(frozen=True, eq=False, repr=False)
class Demonstration:
    """What going round the ring gave.

    Attributes:
        ring: runs, table, firmware, the trial of it, how long each stage took.
        closing: what came of the worn limb.
        report: the page, which shows all of it.
    """

    ring: Ring
    closing: Closing
    report: Path

    @property
    def paths(self) -> dict[str, dict[str, Any]]:
        """Path -> how well it was followed, and decisions that chip and Python twin make differently."""
        return {
            run.log.path.name: {**run.tracking.as_json(), "mismatches": run.mismatches}
            for run in self.ring.runs
            if run.log.path is not None
        }

    @property
    def passed(self) -> bool:
        """Whether chip and twin agreed, no limit was broken, and the firmware passed its trial."""
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
    """Simulate, tabulate, build firmware, swim on the virtual chip; wear a limb, find and learn it, again.

    Args:
        out: folder for everything that is made: library, tables, C, firmware, logs and two pages.
        robot: it, or its name or TOML file.
        states: initial velocities of the library, 10 to 2000.
        depth: periods to look ahead, 1 to 4; None: the robot's own.
        seed: of sampling, of the camera's noise, and of which limb wears.
        progress: of each stage: True for bars, or a function of (done, all).

    Raises:
        InputError: no such robot, a folder that cannot be written to, or an extra that is not installed.
        FrogkickError: any stage's own.
    """
    described = load_robot(robot)
    folder = Path(out)
    require_writable(folder, folder=True)
    require_tools("bench")
    # What follows cannot be loaded without the extra.
    from frogkick.report.identify_page import write_identify_page
    from frogkick.report.ring_page import write_ring_report
    from frogkick.ring import close, go_round

    def bar(title: str) -> AbstractContextManager[Callable[[int, int], None]]:
        return shown(progress, title)

    levels = plan_config(described, "robot", depth).depth
    ring = go_round(described, folder, states, levels, seed, bar)
    close(ring, folder, seed, bar)
    assert ring.closing is not None
    report = folder / "report.html"
    write_identify_page(folder / "identify.html", ring.closing.outcome)
    write_ring_report(report, ring)
    return Demonstration(ring, ring.closing, report)
