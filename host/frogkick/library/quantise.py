"""From a library to a table image for the robot's planner."""

from __future__ import annotations

from frogkick.core.errors import InputError
from frogkick.library.store import Library
from frogkick.robot import Robot
from frogkick.tables.packing import pack_nearest
from frogkick.tables.sealing import Metadata


def table_metadata(robot: Robot, provenance: bytes) -> Metadata:
    """Metadata of a robot's table image."""
    return Metadata(
        robot_id=robot.id,
        provenance=provenance,
        period_us=round(robot.period_s * 1e6),
        pulse_us=round(robot.pulse_s * 1e6),
        second_delay_us=round(robot.second_delay_s * 1e6),
        limbs=len(robot.limbs),
        action_rows=[
            (code, action.first_mask, action.second_mask)
            for code, action in zip(robot.action_codes, robot.actions, strict=True)
        ],
        velocity_resolution=robot.velocity_resolution,
    )


def quantise(library: Library) -> bytes:
    """Round a library's transitions to the codes of a table image of kind ``nearest``.

    States in which an action could not be simulated are left out.

    Returns:
        The image; equal libraries give equal bytes.

    Raises:
        InputError: a value out of the codes' range, with its row and column; or no complete state.
    """
    robot = library.robot()
    whole = library.whole_states()
    if not whole.any():
        raise InputError(
            f"{len(library.failed)} transitions of the library failed, and no state has all of its actions: "
            "build it again"
        )
    return pack_nearest(
        table_metadata(robot, library.content_sha256()),
        velocities=library.initial_velocity_body[whole],
        displacements=library.displacement_body[whole],
        velocities_end=library.velocity_body_end[whole],
        limb_wear=library.limb_wear,
    )
