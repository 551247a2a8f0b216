"""The default table of a robot, made once and kept in the user's cache."""

from __future__ import annotations

import hashlib
from pathlib import Path

from frogkick.core.errors import InputError
from frogkick.core.files import cache_folder, one_at_a_time, write_bytes
from frogkick.core.progress import progress_bar
from frogkick.library import default_table
from frogkick.library.default import SAMPLING, SEED, STATES
from frogkick.robot import Robot, load_robot
from frogkick.tables.image import read_image


def default_tables(robot: Robot | str, states: int | None = None, sampling: str = SAMPLING) -> Path:
    """Return the path of a robot's table image, which is built on first use (about a minute).

    Args:
        robot: the robot, its TOML file or its built-in name.
        states: number of states of its library; None = ``STATES``.
        sampling: how these are drawn; see ``build_library``.

    Raises:
        InputError: no such robot.
    """
    robot = load_robot(robot)
    states = STATES if states is None else states
    made_of = f"{_source_sha256()} {states} {SEED} {sampling}".encode()
    key = hashlib.sha256(robot.sha256 + made_of).hexdigest()[:24]
    folder = cache_folder("tables")
    target = folder / f"{robot.id}-{key}.fkt"
    if _is_valid(target):
        return target
    with one_at_a_time(cache_folder("building"), key) as work:
        if not _is_valid(target):  # otherwise another process has built it meanwhile
            file = work / "library.h5"
            title = f"library for {robot.id}"
            image = default_table(robot, file, progress_bar, title, states, SEED, sampling)
            write_bytes(target, image)
            file.unlink()
    return target


def _source_sha256() -> str:
    """Return the hash of the simulating and quantising code, so that new physics gives a new table."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[1]
    for folder in ("robot", "der", "library", "tables", "planner"):
        for file in sorted((package / folder).glob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _is_valid(target: Path) -> bool:
    """Return whether a valid table exists; a damaged one is made again without an error."""
    try:
        read_image(target)
    except InputError:
        return False
    return True
