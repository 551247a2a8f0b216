"""frogkick: plan for small robots that move by strokes, on the robot itself.

``import frogkick as fk`` gives the names below; each is loaded when it is first used.

Every error that an argument, a file or a robot can cause is a ``FrogkickError`` with a message of one line.
The message may name an option of a command: ``--budget-kib`` is the argument ``budget_kib``, ``--tables`` the
argument ``table``.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

from frogkick.core.version import VERSION as __version__

_FROM = {
    "effects": ("World",),
    "effects.swims": ("Trajectory",),
    "core.errors": ("CheckError", "ConvergenceError", "FrogkickError", "InputError"),
    "front.building": ("Firmware", "build_firmware", "emit_c"),
    "front.gaits": ("Swept", "Validated", "sweep", "validate"),
    "front.identifying": ("Identification", "identify"),
    "front.logs": ("Run", "load_run"),
    "front.planning": ("Plan", "Planner"),
    "front.replaying": ("Replayed", "replay"),
    "front.retuning": ("Retuning", "retune"),
    "front.robots": ("Camera", "Connection", "connect", "scan"),
    "front.running": ("run",),
    "front.swimming": ("simulate",),
    "front.tables": ("Table", "build_library", "fit_table", "load_library", "load_table"),
    "library": ("Library",),
    "paths": ("Path",),
    "robot": ("Robot", "built_in_robots", "load_robot"),
}
"""Module -> what the front door takes from it."""
_MODULE_OF = {name: module for module, names in _FROM.items() for name in names}
_MODULES = ("effects", "paths")

__all__ = [  # noqa: RUF022 - strings, in the order of the work
    "__version__", "load_robot", "built_in_robots", "Robot", "simulate", "Trajectory", "build_library",
    "load_library", "Library", "fit_table", "load_table", "Table", "paths", "Path", "Planner", "Plan",
    "effects", "World", "run", "load_run", "Run", "identify", "Identification", "retune", "Retuning",
    "replay", "Replayed", "validate", "Validated", "sweep", "Swept", "emit_c", "build_firmware", "Firmware",
    "scan", "connect", "Connection", "Camera", "FrogkickError", "InputError", "ConvergenceError",
    "CheckError",
]  # fmt: skip

if TYPE_CHECKING:
    from frogkick import effects as effects
    from frogkick import paths as paths
    from frogkick.core.errors import CheckError, ConvergenceError, FrogkickError, InputError
    from frogkick.effects import World
    from frogkick.effects.swims import Trajectory
    from frogkick.front.building import Firmware, build_firmware, emit_c
    from frogkick.front.gaits import Swept, Validated, sweep, validate
    from frogkick.front.identifying import Identification, identify
    from frogkick.front.logs import Run, load_run
    from frogkick.front.planning import Plan, Planner
    from frogkick.front.replaying import Replayed, replay
    from frogkick.front.retuning import Retuning, retune
    from frogkick.front.robots import Camera, Connection, connect, scan
    from frogkick.front.running import run
    from frogkick.front.swimming import simulate
    from frogkick.front.tables import Table, build_library, fit_table, load_library, load_table
    from frogkick.library import Library
    from frogkick.paths import Path
    from frogkick.robot import Robot, built_in_robots, load_robot

# Installed for all users: numba keeps what it compiles in this user's folder.
if not os.access(os.path.dirname(__file__), os.W_OK):
    from frogkick.core.files import cache_folder

    os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_folder("numba")))


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"frogkick.{name}")
    if name not in _MODULE_OF:
        from frogkick.core.errors import nearest_name

        raise AttributeError(f"module 'frogkick' has no attribute {name!r}{nearest_name(name, __all__)}")
    found = getattr(importlib.import_module(f"frogkick.{_MODULE_OF[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
