"""Writes a directory of C that plans for one robot and builds alone: table, planner, settings, example.

Its planner alone is also built for the chip, for a host that measures it.
"""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.version import VERSION
from frogkick.core.weights import COSTS, WEIGHTS
from frogkick.planner import kernel
from frogkick.planner.plan import PlanConfig
from frogkick.tables.image import Tables, open_image, read_image
from frogkick_codegen.native import PLANNER_SOURCES, planner_files
from frogkick_codegen.toolchain import FLAGS, FLOAT_RULES, firmware_sources, zig


@dataclass(frozen=True)
class DepthTime:
    """Times of one decision at a depth, at 64 MHz: states timed, mean and worst."""

    states: int
    mean_ms: float
    worst_ms: float


@dataclass(frozen=True)
class Figures:
    """Measured on the emitted files themselves, compiled for the nRF52832."""

    compiler: str  # that built them, with its version
    flags: str  # that decide on size and speed
    code_bytes: int  # flash of the planner's code and constants, without the table
    ram_bytes: Mapping[str, int]  # type of the interface -> its size
    static_bytes: int  # RAM that the planner keeps itself
    stack_bytes: Mapping[str, int]  # the most that a call of the function can use, by function
    open_ms: float  # checking and opening the table, once after start-up
    times: Mapping[int, DepthTime]  # depth -> times of a decision


_MARK = "Do not edit: made by frogkick codegen"
_RENDERED = ("fk_table.h", "fk_table.c", "fk_config.h", "fk_sizes.h", "example_main.c", "README.md")
PARTS: Mapping[tuple[str, ...], str] = {
    ("tables.c", "tables_check.c"): "the image's format; opens an image, checking every byte",
    ("nearest.c", "lookup.c"): "nearest state, exactly, over a k-d tree; what the table says of it",
    ("wear.c",): "what worn limbs change of it",
    ("plan.c",): "a decision: checks, the search, what it predicts",
    ("tree.c", "search_beam.c", "fk_search.h"): "searches over sequences of actions: of all, or of the best",
    ("cost.c", "path.c"): "cost of a pose; the path's nearest point",
    ("route.c", "fk_route.h"): "cost along a path that may cross or close on itself",
    ("math.c", "fk_trig.h"): "angles in float32, no libm",
    ("fk_internal.h",): "what these files share",
}
"""Files of the planner -> what the emitted README says about them."""
SOURCES = tuple(sorted((*PLANNER_SOURCES, "fk_table.c")))
"""The C files that a firmware compiles; ``example_main.c`` is not among them."""
BUILD_COMMAND = shlex.join(["cc", *FLAGS, "-o", "example", "example_main.c", *SOURCES])
"""The one command of the emitted README."""
_BUILT = ("example", "example.exe")  # what that command makes: goes when the directory is replaced


def emit(
    image: bytes | Path | str,
    out_dir: Path | str,
    command: str,
    config: PlanConfig | None = None,
    robot_sha256: bytes | None = None,
    figures: Figures | None = None,
) -> dict[str, str]:
    """Write the directory, wholly or not at all.

    The same image, configuration and command give the same bytes: no times, no host names, and absolute
    paths in the command are cut to their last part.

    Args:
        image: a table image, or its file.
        out_dir: the directory to make; one that was emitted before is replaced, any other is refused.
        command: the command line that asked for it, for the files' first lines.
        config: weights and depth; the paper's where it is None.
        robot_sha256: 32 bytes of the robot's canonical dump; where it is None the first lines say that the
            library's hash covers it.
        figures: sizes and times of the planner with this table on the chip; None: not measured.

    Returns:
        File name -> SHA-256 of its content, hexadecimal.

    Raises:
        TableError: the image is not usable.
        InputError: the directory is not one that was emitted, cannot be written, or the command or the
            configuration cannot be used.
    """
    tables = open_image(image) if isinstance(image, bytes) else read_image(image)
    files = render(tables, command, config or PlanConfig(), robot_sha256, figures)
    swap_in(Path(out_dir), files)
    return {name: hashlib.sha256(files[name]).hexdigest() for name in sorted(files)}


def render(
    tables: Tables,
    command: str,
    config: PlanConfig,
    robot_sha256: bytes | None = None,
    figures: Figures | None = None,
) -> dict[str, bytes]:
    """Return the directory's files by name; arguments and errors as for ``emit``."""
    _check_config(config)
    weights = [_literal(value) for value in config.weights()]
    banner = _banner(tables, portable_command(command), config, weights, robot_sha256)
    image, own = tables.image, planner_files()
    values = {
        "banner": banner,
        "tables": tables,
        "config": config,
        "cost": tuple(COSTS)[config.cost],
        "costs": ", ".join(f"{number} = {name}" for number, name in enumerate(COSTS)),
        "config_weights": dict(zip(WEIGHTS, weights, strict=True)),
        "format_version": tables.format_version,
        "build_command": BUILD_COMMAND,
        "figures": figures,
        "period_s": f"{tables.period_us * 1e-6:g}",
        "parts": [
            (present, what)
            for names, what in PARTS.items()
            if (present := [name for name in names if name in own])
        ],
        "float_rules": " ".join(FLOAT_RULES),
        "plain_weights": {name: weight.rstrip("f") for name, weight in zip(WEIGHTS, weights, strict=True)},
        "velocity_scale": [_literal(value).rstrip("f") for value in tables.velocity_scale],
        "motion_scale": [_literal(value).rstrip("f") for value in tables.motion_scale],
        "lines": [
            ", ".join(f"0x{byte:02x}" for byte in image[at : at + 16]) + ","
            for at in range(0, len(image), 16)
        ],
    }
    files = {name: filled(name, **values).encode("utf-8") for name in _RENDERED}
    head = "/* " + "\n * ".join(banner) + "\n */\n"
    for name, content in own.items():
        files[name] = head.encode("utf-8") + content
    return files


def filled(name: str, **values: Any) -> str:
    """Return a file that is made of a template."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("frogkick_codegen"),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,
    )
    return environment.get_template(f"{name}.jinja").render(values)


def portable_command(command: str) -> str:
    """Return a command line without this machine's folders: absolute paths keep their last part.

    InputError where it is empty, has unbalanced quotes, or holds what would end a C comment or a line.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise InputError(f"command {command!r} cannot be read ({error}): balance its quotes") from None
    if not words:
        raise InputError("command is empty: pass the command line that makes these files")
    if not command.isprintable() or "*/" in command or "/*" in command or "--" + ">" in command:
        raise InputError(f"command {command!r} holds a line end or a comment mark: rename the file in it")
    portable = []
    for word in words:
        option, equals, value = word.partition("=")
        if equals and option.startswith("-") and Path(value).is_absolute():
            portable.append(f"{option}={Path(value).name}")
        else:
            portable.append(Path(word).name if Path(word).is_absolute() else word)
    return shlex.join(portable)


def _banner(
    tables: Tables, command: str, config: PlanConfig, weights: list[str], robot_sha256: bytes | None
) -> list[str]:
    numbers = (config.depth, int(config.cost), config.transitions_max)
    settings = ",".join([*weights, *map(str, numbers)])
    robot = f"SHA-256 {robot_sha256.hex()}" if robot_sha256 else "its hash is part of the library's"
    return [
        f"{_MARK} {VERSION}, table image format {tables.format_version}, kind {tables.kind}.",
        f"library SHA-256 {tables.provenance.hex()}",
        f"robot {tables.robot_id}, {robot}",
        f"configuration SHA-256 {hashlib.sha256(settings.encode()).hexdigest()} ({settings})",
        f"table image SHA-256 {hashlib.sha256(tables.image).hexdigest()}",
        f"command: {command}",
        f"flash: {len(tables.image)} bytes of table",
    ]


def _check_config(config: PlanConfig) -> None:
    status = int(kernel.check_settings(config.settings(), config.depth))
    if status == kernel.ERROR_DEPTH:
        raise InputError(f"depth is {config.depth}, allowed is 1 to 4: correct the planner's configuration")
    if status == kernel.ERROR_WEIGHT:
        values = config.weights().tolist()
        raise InputError(
            f"weights are {values}, allowed is 0 to 1e6 (glide_lead, turn_lead 2, wall_glide 100; walls "
            "within 1000 m): correct the planner's configuration"
        )
    if status == kernel.ERROR_COST:
        known = " or ".join(f"{number} ({name})" for number, name in enumerate(COSTS))
        raise InputError(f"cost is {config.cost}, allowed is {known}: correct it")
    if not 0 <= config.transitions_max < 2**32:
        raise InputError(
            f"transitions_max is {config.transitions_max}, allowed is 0 to {2**32 - 1}: correct it"
        )


def _literal(value: np.float32) -> str:
    """Return a C literal that names exactly this float32: nine significant digits do."""
    text = f"{float(value):.9g}"
    return (text if any(mark in text for mark in ".en") else text + ".0") + "f"


def swap_in(out_dir: Path, files: dict[str, bytes]) -> None:
    """Write into a new directory beside ``out_dir``, then put it in its place."""
    target = Path(os.path.realpath(out_dir))
    _refuse_foreign(target, out_dir, set(files))
    made = [place for place in target.parents if not place.exists()]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    except OSError as error:
        _remove_empty(made)
        raise InputError(f"cannot write {str(out_dir)!r}: {error.strerror}; choose another --out") from error
    fresh, old = work / "new", work / "old"
    try:
        fresh.mkdir()
        for name, content in files.items():
            with (fresh / name).open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
        if target.exists():
            os.rename(target, old)
        try:
            os.rename(fresh, target)
        except OSError:
            if old.exists():
                os.rename(old, target)
            raise
    except OSError as error:
        raise InputError(f"cannot write {str(out_dir)!r}: {error.strerror}; choose another --out") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if not target.exists():
            _remove_empty(made)


def _remove_empty(folders: Iterable[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # something else is in it, or it is not there
            folder.rmdir()


def _refuse_foreign(target: Path, given: Path, names: set[str]) -> None:
    """Raise unless the target is absent, empty, or holds nothing but emitted files and their example."""
    if not target.exists():
        return
    if not target.is_dir():
        raise InputError(f"--out {str(given)!r} is a file: name a directory")
    for entry in sorted(target.iterdir()):
        if entry.name in _BUILT:
            continue
        emitted = entry.name in names and entry.is_file()
        if emitted:
            with entry.open("rb") as file:
                emitted = _MARK.encode() in file.readline()
        if not emitted:
            raise InputError(
                f"--out {str(given)!r} holds {entry.name!r}, which codegen did not write: "
                "choose another directory, or remove it"
            )


_BARE = (
    "-ffreestanding", "-ffunction-sections", "-fdata-sections",
    "-fno-unwind-tables", "-fno-asynchronous-unwind-tables",
)  # fmt: skip
NOT_PLANNER = ("main", "fk_reset", "fk_fault", "fk_stop", "fk_clock_init", "memcpy", "memset", "vectors")
"""Symbols of that image that belong neither to the planner nor to the table."""


def build_planner(emitted: Path, elf: Path) -> Path:
    """Build the planner of an emitted directory for the chip, into ``elf``."""
    bench = firmware_sources() / "bench"
    main = resources.files("frogkick_codegen") / "templates" / "measure_main.c"
    with resources.as_file(main) as file:
        zig("chip").run(
            [
                *FLAGS, *_BARE, f"-I{emitted}", f"-I{bench}",
                "-nostdlib", "-Wl,--entry=fk_reset", f"-Wl,-T,{bench / 'nrf52832.ld'}", "-Wl,--gc-sections",
                *(emitted / name for name in SOURCES), bench / "startup.c", bench / "clock.c",
                file, "-o", elf,
            ],
            folder=elf.parent,
        )  # fmt: skip
    return elf
