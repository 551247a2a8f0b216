"""Planar discrete elastic rods in water: mesh, forces, solver, integrator, batches of robots.

A limb profile outside the measured ones raises InputError; a simulation that fails gives a Failure.
"""

from frogkick.der.batch import WIDTH, Batch, Checkpoint, Failure
from frogkick.der.body import cubic, interpolate
from frogkick.der.mesh import Rods, prepare
from frogkick.der.schedule import STEP_S
from frogkick.der.water import STILL, Water

__all__ = [
    "STEP_S", "STILL", "WIDTH", "Batch", "Checkpoint", "Failure", "Rods", "Water", "cubic", "interpolate",
    "prepare",
]  # fmt: skip
