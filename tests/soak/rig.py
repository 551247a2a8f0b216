"""The robot of the soak: its tables, its core, and cores that a test has spoilt."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

from tests.core.core import CORE
from tests.loop import rig
from tests.soak.tables import spread_table

from frogkick.planner.image import Tables, open_image
from frogkick.planner.plan import PlanConfig
from frogkick_codegen.emit import render
from frogkick_codegen.firmware import build, robot_config
from frogkick_codegen.native import build_shared

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


def spoilt_library(changes: Mapping[str, tuple[str, str]]) -> Path:
    """The same with texts of its sources replaced: file name -> what stands there once, what instead."""
    files = render(tables()[0], "soak", PlanConfig())
    files = {name: content for name, content in files.items() if "example" not in name}
    files |= {path.name: path.read_bytes() for path in sorted(CORE.glob("*.[ch]"))}
    files["fk_robot_config.h"] = robot_config(robot()).encode()
    templates = resources.files("frogkick_codegen") / "templates"
    files["native_flash.c"] = (templates / "native_flash.c").read_bytes()
    for name, (old, new) in changes.items():
        text = files[name].decode()
        assert text.count(old) == 1, f"{name} holds {old!r} {text.count(old)} times: correct the mutation"
        files[name] = text.replace(old, new).encode()
    return build_shared("fk_soak", {name: files[name] for name in files if name.endswith((".c", ".h"))})
