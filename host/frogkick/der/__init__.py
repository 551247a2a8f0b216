"""Planar discrete elastic rods in water: mesh, forces, solver, integrator, swimmers.

Functions raise InputError for values that are not finite or out of range, and for a limb profile outside the
measured ones; a simulation that fails raises ConvergenceError, or gives a Failure where others go on.
"""

from frogkick.der.batch import WIDTH, Batch, Checkpoint, Failure
from frogkick.der.mesh import Rods, prepare
from frogkick.der.schedule import STEP_S
from frogkick.der.strokes import Motions, Track, program_of, simulate_many
from frogkick.der.swimmer import Swimmer
from frogkick.der.trajectory import Gait, Trajectory, simulate_actions, simulate_gait_tracks, simulate_gaits
from frogkick.der.water import STILL, Water

__all__ = [
    "STEP_S",
    "STILL",
    "WIDTH",
    "Batch",
    "Checkpoint",
    "Failure",
    "Gait",
    "Motions",
    "Rods",
    "Swimmer",
    "Track",
    "Trajectory",
    "Water",
    "prepare",
    "program_of",
    "simulate_actions",
    "simulate_gait_tracks",
    "simulate_gaits",
    "simulate_many",
]
