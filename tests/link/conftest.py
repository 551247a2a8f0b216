"""What every test over a link needs beforehand."""

from __future__ import annotations

import pytest
from tests.runs import rig

from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.decision import warm_up


@pytest.fixture(scope="session", autouse=True)
def compiled() -> None:
    """Compile estimator and planner, as ``front.bench`` does before a run.

    Robots here swim in real time: in a fresh clone a run on the host compiles for a second and more, while
    its fixes age.
    """
    warm_up(rig.tables(), shape("line"), PlanConfig())
