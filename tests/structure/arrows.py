"""Who may import whom: the arrows of the documentation's architecture page, and what breaks them."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

CODEGEN, STUDIES = "codegen", "studies"
"""How the table below calls the packages frogkick_codegen and frogkick_studies."""

PACKAGES = {
    "host/frogkick": "",
    "host/studies/frogkick_studies": STUDIES,
    "codegen/frogkick_codegen": CODEGEN,
}
"""Folder of each package -> its row; of frogkick each room has its own."""

EVERYBODY = frozenset({"core"})
"""Rooms of frogkick that all may import."""

_STAGES = ("robot", "effects", "tables", "runs", "identification", CODEGEN)
_MOST = (*_STAGES, "der", "library", "planner", "paths", "pool", "validation", "report")

ARROWS: Mapping[str, frozenset[str]] = {
    "core": frozenset(),
    "robot": frozenset(),
    "der": frozenset({"robot"}),
    "effects": frozenset({"robot", "der"}),
    "tables": frozenset(),
    "planner": frozenset({"tables"}),
    "estimator": frozenset({"tables", "planner"}),
    "library": frozenset({"robot", "der", "effects", "tables", "planner"}),  # planner: states that it meets
    "paths": frozenset(),
    "vision": frozenset(),
    "link": frozenset(),
    "pool": frozenset({"robot", "der", "effects", "link"}),
    "runs": frozenset(
        {"robot", "effects", "tables", "planner", "estimator", "paths", "vision", "link", "pool"}
    ),
    "identification": frozenset({"robot", "der", "effects", "runs"}),
    "validation": frozenset({"robot", "der", "effects"}),
    "ring": frozenset({*_STAGES, "library", "planner", "paths", "pool"}),
    "report": frozenset({*_STAGES, "der", "validation", "ring"}),
    "front": frozenset({*_MOST, "vision", "link", "ring"}),
    "cli": frozenset({"__init__", "front", "report", STUDIES}),  # arguments in, one call, printing out
    # A study asks what no front door answers: rods step by step, bytes of tables, cycles of the chip.
    STUDIES: frozenset({"__init__", *_MOST, "estimator", "front"}),
    CODEGEN: frozenset({"robot", "tables", "planner", "link"}),
    "__init__": frozenset({"front", "robot", "effects", "library", "paths"}),
}
"""Folder or module of frogkick -> those that it may import besides itself and ``EVERYBODY``."""

WHEELS: Mapping[str, frozenset[str]] = {
    "core": frozenset({"cffi", "distributed", "h5py", "numba", "numpy", "rich"}),
    "tables": frozenset({"numpy", "numba"}),
    "planner": frozenset({"numpy", "numba"}),
    "estimator": frozenset({"numpy", "numba"}),
    "paths": frozenset({"numpy", "numba", "scipy"}),
    "vision": frozenset({"numpy", "cv2", "pupil_apriltags"}),
    "link": frozenset({"cobs", "serial", "bleak"}),
    "__init__": frozenset(),
}
"""Where an arrow also limits what is not ours: the packages allowed besides the standard library."""


@dataclass(frozen=True)
class Import:
    """One import: from which file and line (relative to the root), which dotted module."""

    file: str
    line: int
    module: str


def imports_of(file: Path, package: str, name: str) -> Iterator[Import]:
    """Yield every import of a file, wherever it stands in it, with relative ones made absolute.

    Args:
        file: Python source.
        package: dotted package that the file is in.
        name: how to call the file in an ``Import``.
    """
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"), filename=name)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(name, node.lineno, alias.name)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = package.split(".")
                parents = parts[: len(parts) - node.level + 1]
                base = ".".join([*parents, base] if base else parents)
            # `from frogkick import cli` names the module in the list, not before it.
            for alias in node.names:
                yield Import(name, node.lineno, f"{base}.{alias.name}")
        elif isinstance(node, ast.Call) and node.args:
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            first = node.args[0]
            if (
                called in ("import_module", "__import__", "run_module")
                and isinstance(first, ast.Constant)
                and isinstance(first.value, str)
            ):
                yield Import(name, node.lineno, first.value)


def violations(root: Path) -> list[str]:
    """Return one line for each import below ``root`` that the tables do not allow.

    Args:
        root: a repository: folders of ``PACKAGES`` are read.
    """
    found: list[str] = []
    ours = _ours(root)
    for room, name, imports in _by_room(root):
        if room not in ARROWS:
            found.append(f"{name}:1 {room!r} has no row in ARROWS: add one")
            continue
        for one in imports:
            reason = _reason(room, one.module, ours)
            if reason:
                found.append(f"{one.file}:{one.line} {reason}")
    return sorted(set(found))


def unused(root: Path) -> list[tuple[str, str]]:
    """Return the arrows that no import below ``root`` needs: (room, what it may import)."""
    ours = _ours(root)
    needed = {(room, _target(one.module, ours)) for room, _, imports in _by_room(root) for one in imports}
    arrows = {(room, target) for room, targets in ARROWS.items() for target in targets}
    return sorted(arrows - needed)


def _ours(root: Path) -> set[str]:
    """Return the names of folders and modules of frogkick."""
    host = root / "host" / "frogkick"
    return {entry.stem for entry in host.iterdir() if entry.suffix == ".py" or entry.is_dir()}


def _by_room(root: Path) -> Iterator[tuple[str, str, list[Import]]]:
    """Yield the row, the name and the imports of each file of ``PACKAGES``."""
    for folder, row in PACKAGES.items():
        top = root / folder
        for file in sorted(top.rglob("*.py")):
            inside = file.relative_to(top)
            package = ".".join([top.name, *inside.parts[:-1]])
            name = file.relative_to(root).as_posix()
            yield row or inside.parts[0].removesuffix(".py"), name, list(imports_of(file, package, name))


def unknown(root: Path) -> list[str]:
    """Return one line for each import of a module of the project that is not below ``root``.

    Most imports stand in functions, where neither starting the program nor mypy, which is told to ignore
    packages without types, finds one of a file that was renamed.
    """
    found: list[str] = []
    tops = {Path(folder).name: (root / folder).parent for folder in PACKAGES}
    for folder in PACKAGES:
        for file in sorted((root / folder).rglob("*.py")):
            package = ".".join(file.relative_to((root / folder).parent).parts[:-1])
            for one in imports_of(file, package, file.relative_to(root).as_posix()):
                first, *inner = one.module.split(".")
                # The last part may be a name in the module before it.
                places = (
                    [tops[first].joinpath(first, *inner[:n]) for n in (-1, None)] if first in tops else []
                )
                if places and not any(p.is_dir() or p.with_suffix(".py").is_file() for p in places):
                    found.append(f"{one.file}:{one.line} {one.module} does not exist")
    return found


def circle(root: Path) -> list[str]:
    """Return modules below ``root`` that import each other in a circle, in its order; [] where none do.

    Imports in functions or for types alone count. A name of a package is the package.
    """
    files = {}
    for top in (root / folder for folder in PACKAGES):
        for file in top.rglob("*.py"):
            parts = [top.name, *file.relative_to(top).with_suffix("").parts]
            files[".".join(parts).removesuffix(".__init__")] = file
    graph: dict[str, set[str]] = {}
    for name, file in files.items():
        package = name if file.name == "__init__.py" else name.rpartition(".")[0]
        graph[name] = set()
        for one in imports_of(file, package, name):
            module = one.module
            while module and module not in files:
                module = module.rpartition(".")[0]
            graph[name] |= {module} - {"", name}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def _target(module: str, ours: set[str]) -> str:
    """Return the row of a module that is imported, or "" if it is not ours."""
    first, _, inner = module.partition(".")
    if first in ("frogkick_codegen", "frogkick_studies"):
        return first.removeprefix("frogkick_")
    if first != "frogkick":
        return ""
    # A name out of frogkick/__init__.py, unless there is such a folder.
    target = inner.partition(".")[0]
    return target if target in ARROWS or target in ours else "__init__"


def _reason(room: str, module: str, ours: set[str]) -> str:
    """Return why ``room`` must not import ``module``, or ""."""
    parts, target = module.split("."), _target(module, ours)
    if target == "__init__" and target not in ARROWS[room] and len(parts) > 1:
        return f"{room} imports {parts[1]} of the front door, which stands above it"
    if not target:
        if parts[0] in sys.stdlib_module_names or room not in WHEELS or parts[0] in WHEELS[room]:
            return ""
        return f"{room} imports {parts[0]}, allowed is {_list(WHEELS[room])} and the standard library"
    if target == room or target in EVERYBODY or target in ARROWS[room]:
        return ""
    return f"{room} imports {target} ({module}), allowed is {_list(ARROWS[room])}"


def _list(names: frozenset[str]) -> str:
    return ", ".join(sorted(names)) or "nothing of ours"


_C_FUNCTION = re.compile(r"^(?!static|typedef|#)[a-z][\w *]*?\b(fk_\w+)\(", re.M)


def c_arrows(files: Mapping[str, str]) -> dict[str, set[str]]:
    """Which C file calls functions of which others.

    Args:
        files: text of each, by its name.
    """
    code = {name: re.sub(r"/\*.*?\*/", "", text, flags=re.S) for name, text in files.items()}
    home = {
        function: name
        for name, text in code.items()
        for function in _C_FUNCTION.findall(re.sub(r"\);", "", text))
    }
    return {
        name: {home[called] for called in re.findall(r"\b(fk_\w+)\(", text) if called in home} - {name}
        for name, text in code.items()
    }
