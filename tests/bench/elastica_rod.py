"""One plain rod, free in vacuum, let go from straight a little off its natural arc: here and in PyElastica.

Its material, weight and segments are a limb's (3 MPa, 0.0312 kg/m, 4 mm), its 128 nodes as many as the
robot has. The deflection after half a second tells that both solve the same problem.
"""

from __future__ import annotations

import contextlib
import io
import math
import time
from typing import Any

import numpy as np
from tests.der.rig import STILL, straight_rod

from frogkick.der import Batch, Rods
from frogkick.der.schedule import COARSEST_AT_REST
from frogkick.robot import load_robot

NODES = 128
LENGTH_M = 0.5
MODULUS_PA = 3.0e6
RADIUS_M = 2.09e-3
DENSITY_KG_PER_M3 = 2275.0
NATURAL_PER_M = 0.5
SIMULATED_S = 0.5
FROGKICK_STEP_S = 0.002
ELASTICA_STEP_S = 5.0e-5
"""Half of the shortest that was seen to blow up: explicit steps must resolve sound in a segment."""

AREA_M2 = math.pi * RADIUS_M**2
BENDING_N_M2 = MODULUS_PA * math.pi * RADIUS_M**4 / 4.0


def frogkick_rod(runs: int, width: int) -> tuple[float, float]:
    """Seconds of computing for a simulated second of each of ``width`` rods, and the deflection, m."""
    mesh, plan = straight_rod(
        NODES,
        LENGTH_M,
        mass_per_length=DENSITY_KG_PER_M3 * AREA_M2,
        bending_n_m2=BENDING_N_M2,
        stretching_n=MODULUS_PA * AREA_M2,
        natural_per_m=NATURAL_PER_M,
    )
    rods = Rods(load_robot("frog2022"), mesh, plan, (STILL,) * 4)
    found, deflection = [], 0.0
    for run in range(runs + 1):  # the first one compiles
        still = np.zeros((width, 3))
        batch = Batch([rods] * width, still, still, 0.0, FROGKICK_STEP_S / COARSEST_AT_REST, width)
        began = time.process_time()
        batch.advance(SIMULATED_S)
        if run:
            found.append((time.process_time() - began) / SIMULATED_S / width)
        y = batch.nodes_world()[0, :, 1]
        deflection = float(y[NODES // 2] - 0.5 * (y[0] + y[-1]))
    return min(found), deflection


def elastica_rod(runs: int) -> tuple[float, float]:
    """The same in PyElastica, which must be installed."""
    import elastica

    found, deflection = [], 0.0
    for run in range(runs + 1):
        rod: Any = elastica.CosseratRod.straight_rod(
            NODES - 1,
            np.zeros(3),
            np.array([1.0, 0.0, 0.0]),
            np.array([0.0, 1.0, 0.0]),
            LENGTH_M,
            RADIUS_M,
            DENSITY_KG_PER_M3,
            youngs_modulus=MODULUS_PA,
            shear_modulus=MODULUS_PA / 3.0,
        )
        rod.rest_kappa[1, :] = NATURAL_PER_M  # about the axis out of the plane
        rods: Any = elastica.BaseSystemCollection()
        rods.append(rod)
        rods.finalize()
        began = time.process_time()
        with contextlib.redirect_stdout(io.StringIO()):  # it tells the time that it reached
            elastica.integrate(
                elastica.PositionVerlet(),
                rods,
                SIMULATED_S,
                round(SIMULATED_S / ELASTICA_STEP_S),
                progress_bar=False,
            )
        if run:
            found.append((time.process_time() - began) / SIMULATED_S)
        y = rod.position_collection[1]
        deflection = float(y[NODES // 2] - 0.5 * (y[0] + y[-1]))
    return min(found), deflection
