"""Planar discrete elastic rods in water: mesh, forces, solver, integrator, swimmers."""

from frogkick.der.batch import WIDTH, Batch, Failure
from frogkick.der.gaits import Gait, simulate_gait, simulate_gaits
from frogkick.der.strokes import Motions, program_of, simulate_action, simulate_many
from frogkick.der.swimmer import STEP_S, Rods, Swimmer, prepare
from frogkick.der.trajectory import Trajectory, simulate_actions

__all__ = [
    "STEP_S",
    "WIDTH",
    "Batch",
    "Failure",
    "Gait",
    "Motions",
    "Rods",
    "Swimmer",
    "Trajectory",
    "prepare",
    "program_of",
    "simulate_action",
    "simulate_actions",
    "simulate_gait",
    "simulate_gaits",
    "simulate_many",
]
