"""A library to the table image that the robot's planner reads."""

from __future__ import annotations

from frogkick.library.store import Library
from frogkick.planner.image import pack_nearest


def quantise(library: Library) -> bytes:
    """Round a library's transitions to the codes of a table image of kind ``nearest``.

    Returns:
        The image; equal libraries give equal bytes.

    Raises:
        InputError: a value that no code can hold; the text names its row and column.
    """
    robot = library.robot()
    return pack_nearest(
        robot_id=library.robot_id,
        provenance=library.content_sha256(),
        period_us=round(robot.period_s * 1e6),
        pulse_us=round(robot.pulse_s * 1e6),
        second_delay_us=round(robot.second_delay_s * 1e6),
        limbs=len(robot.limbs),
        action_rows=[(a.name, a.first_mask, a.second_mask) for a in robot.actions],
        velocity_scale=robot.velocity_resolution,
        velocities=library.initial_velocity_body,
        displacements=library.displacement_body,
        velocities_end=library.velocity_body_end,
    )
