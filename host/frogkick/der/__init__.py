"""Planar discrete elastic rods in water: mesh, forces, solver, integrator, swimmer."""

from frogkick.der.strokes import Trajectory, simulate_action, simulate_actions, simulate_gait
from frogkick.der.swimmer import STEP_S, Rods, Swimmer, prepare

__all__ = [
    "STEP_S",
    "Rods",
    "Swimmer",
    "Trajectory",
    "prepare",
    "simulate_action",
    "simulate_actions",
    "simulate_gait",
]
