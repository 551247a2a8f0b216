"""All stages once: library, table, firmware, paths on the virtual chip, and a worn limb identified."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from frogkick.core.files import require_writable
from frogkick.core.progress import Progress, shown
from frogkick.front.places import plan_config
from frogkick.library.fitting import STATES
from frogkick.robot import Robot, load_robot
from frogkick_codegen.firmware import require_tools

if TYPE_CHECKING:
    from frogkick.ring import Adaptation, Ring

__all__ = ["Adaptation", "Ring", "demonstrate"]


def demonstrate(
    out: Path | str,
    robot: Robot | str = "frog2022",
    *,
    states: int | None = None,
    depth: int | None = None,
    seed: int = 0,
    progress: Progress = False,
) -> tuple[Ring, Path]:
    """Simulate, make tables, build the firmware and swim on the virtual chip; then identify a worn limb.

    The arguments are the options of the command ``demo``. Returned are the results, and the page that shows
    them.
    """
    described = load_robot(robot)
    folder = Path(out)
    require_writable(folder, folder=True)
    require_tools("bench")
    # The modules below cannot be loaded without the extra.
    from frogkick.report.identify_page import write_identify_page
    from frogkick.report.ring_page import write_ring_report
    from frogkick.ring import adapt, run_demo

    bar = partial(shown, progress)
    levels = plan_config(described, "robot", depth).depth
    ring = run_demo(described, folder, STATES if states is None else states, levels, seed, bar)
    adapt(ring, folder, seed, bar)
    assert ring.adaptation is not None
    report = folder / "report.html"
    write_identify_page(folder / "identify.html", ring.adaptation.outcome)
    write_ring_report(report, ring)
    return ring, report
