"""Terms that a model may lack: each physical, with named, bounded, united parameters."""

from frogkick.effects.acting import Acting, ActingLanes, body_effects, changed_robot, rods_of
from frogkick.effects.base import Body, Effect, Fix, History, Parameter, Stroke
from frogkick.effects.registry import BUILT_IN, effects_of, make_effect, make_effects
from frogkick.effects.world import World, read_world

__all__ = [
    "BUILT_IN",
    "Acting",
    "ActingLanes",
    "Body",
    "Effect",
    "Fix",
    "History",
    "Parameter",
    "Stroke",
    "World",
    "body_effects",
    "changed_robot",
    "effects_of",
    "make_effect",
    "make_effects",
    "read_world",
    "rods_of",
]
