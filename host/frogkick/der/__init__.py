"""Planar discrete elastic rods in water: mesh, forces, solver, integrator, swimmers."""

from frogkick.der.batch import WIDTH, Batch, Checkpoint, Failure
from frogkick.der.gaits import Gait, GaitTrack, simulate_gait_tracks, simulate_gaits
from frogkick.der.strokes import Motions, program_of, simulate_many
from frogkick.der.swimmer import STEP_S, Rods, Swimmer, prepare
from frogkick.der.trajectory import Trajectory, simulate_actions
from frogkick.der.water import STILL, Water

__all__ = [
    "STEP_S",
    "STILL",
    "WIDTH",
    "Batch",
    "Checkpoint",
    "Failure",
    "Gait",
    "GaitTrack",
    "Motions",
    "Rods",
    "Swimmer",
    "Trajectory",
    "Water",
    "prepare",
    "program_of",
    "simulate_actions",
    "simulate_gait_tracks",
    "simulate_gaits",
    "simulate_many",
]
