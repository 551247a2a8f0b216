"""Terms that a model may lack: physical effects with named parameters that have bounds and units."""

from frogkick.core.poses import Fix
from frogkick.effects.acting import Acting, body_at, body_effects, changed_robot, rods_of
from frogkick.effects.base import Body, Effect, History, Parameter, Stroke, parameter
from frogkick.effects.body import (
    CentreMass,
    Hull,
    LimbFatigue,
    LimbMount,
    LimbPlate,
    MunkMoment,
    OffCentreMass,
)
from frogkick.effects.camera import CameraScale, ClockDrift, FixLatency, TagOffset
from frogkick.effects.law import Law
from frogkick.effects.limbs import BatterySag, GroupGain, GroupLoss, LimbMemory, LimbWear, WarmUp
from frogkick.effects.registry import BUILT_IN, World, effects_of, make_effect, make_effects, read_world
from frogkick.effects.water import (
    DragScale,
    MassScale,
    ShearCurrent,
    SteadyCurrent,
    SteadyWrench,
    Vortex,
    Wall,
    YawDrag,
)

__all__ = [
    "BUILT_IN", "Acting", "BatterySag", "Body", "CameraScale", "CentreMass", "ClockDrift", "DragScale",
    "Effect", "Fix", "FixLatency", "GroupGain", "GroupLoss", "History", "Hull", "Law", "LimbFatigue",
    "LimbMemory", "LimbMount", "LimbPlate", "LimbWear", "MassScale", "MunkMoment", "OffCentreMass",
    "Parameter", "ShearCurrent", "SteadyCurrent", "SteadyWrench", "Stroke", "TagOffset", "Vortex", "Wall",
    "WarmUp", "World", "YawDrag", "body_at", "body_effects", "changed_robot", "effects_of", "make_effect",
    "make_effects", "parameter", "read_world", "rods_of",
]  # fmt: skip
