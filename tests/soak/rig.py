"""A native robot with a table of some pages, and another such table to send."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

from tests.runs import rig
from tests.soak.tables import spread_table

from frogkick.tables.image import Tables, open_image
from frogkick_codegen.firmware import build

robot = rig.robot
_FOLDER = tempfile.TemporaryDirectory(prefix="frogkick-soak-")


@functools.cache
def tables() -> tuple[Tables, Tables]:
    """The one that is built in, and the one that comes by radio."""
    return open_image(spread_table(rig.tables(), 1)), open_image(spread_table(rig.tables(), 2))


@functools.cache
def truth() -> Tables:
    """As the swimmer moves: like neither of them, and finer."""
    return open_image(spread_table(rig.tables(), 3, states=1000))


@functools.cache
def library() -> Path:
    """The target "native", as ``firmware build`` makes it."""
    image = Path(_FOLDER.name) / "soak.fkt"
    image.write_bytes(tables()[0].image)
    return build("native", image, robot(), Path(_FOLDER.name) / "native").image
