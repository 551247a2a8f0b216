"""A library to the table image that the robot's planner reads."""

from __future__ import annotations

from typing import Any

from frogkick.core.errors import InputError
from frogkick.library.store import Library
from frogkick.robot import Robot
from frogkick.tables.packing import pack_nearest


def table_fields(robot: Robot, provenance: bytes) -> dict[str, Any]:
    """What a table image of any kind says of its robot: arguments of its packing."""
    return {
        "robot_id": robot.id,
        "provenance": provenance,
        "period_us": round(robot.period_s * 1e6),
        "pulse_us": round(robot.pulse_s * 1e6),
        "second_delay_us": round(robot.second_delay_s * 1e6),
        "limbs": len(robot.limbs),
        "action_rows": [
            (code, action.first_mask, action.second_mask)
            for code, action in zip(robot.action_codes, robot.actions, strict=True)
        ],
        "velocity_scale": robot.velocity_resolution,
    }


def quantise(library: Library) -> bytes:
    """Round a library's transitions to the codes of a table image of kind ``nearest``.

    A state that could not be simulated with every action is left out: what the robot would do there is not
    known, and a neighbour's transitions are the better guess.

    Returns:
        The image; equal libraries give equal bytes.

    Raises:
        InputError: a value that no code can hold; the text names its row and column. No whole state.
    """
    robot = library.robot()
    whole = library.whole_states()
    if not whole.any():
        raise InputError(
            f"{len(library.failed)} transitions of the library failed and no state is left whose actions are "
            "all known: build it again"
        )
    return pack_nearest(
        **table_fields(robot, library.content_sha256()),
        velocities=library.initial_velocity_body[whole],
        displacements=library.displacement_body[whole],
        velocities_end=library.velocity_body_end[whole],
    )
