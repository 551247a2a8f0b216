"""What a robot is: TOML to frozen dataclasses, actions, actuation profiles.

Functions raise InputError, in one line, for a file, a key, a geometry or a profile that cannot be used.
"""

from frogkick.robot.geometry import Mirror, mirror_of, robot_warnings
from frogkick.robot.load import built_in_robots, load_robot, parse_robot
from frogkick.robot.model import Action, Robot, in_a_row, limb_points
from frogkick.robot.profile import Actuation, Profile, fit_profile
from frogkick.robot.schema import Frame, Guard, Limb, PlannerDefaults, VelocityBox

__all__ = [
    "Action", "Actuation", "Frame", "Guard", "Limb", "Mirror", "PlannerDefaults", "Profile", "Robot",
    "VelocityBox", "built_in_robots", "fit_profile", "in_a_row", "limb_points", "load_robot", "mirror_of",
    "parse_robot", "robot_warnings",
]  # fmt: skip
