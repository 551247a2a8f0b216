"""Builds the firmware: emitted tables and planner, the core, and a port, into one image.

``bench`` is the bare-metal image for an nRF52832; ``native`` is the same core as a shared library for this
computer, which the simulated pool talks to.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from frogkick.core.errors import InputError, require
from frogkick.core.files import atomic_path, cache_folder, one_at_a_time, write_bytes
from frogkick.core.weights import WEIGHTS
from frogkick.planner.plan import PlanConfig, look_up_most_ns, states_most, transitions_of
from frogkick.robot import Robot
from frogkick.tables.image import read_image
from frogkick_codegen import declared
from frogkick_codegen.emit import render, swap_in
from frogkick_codegen.map_file import write_map
from frogkick_codegen.toolchain import (
    FLAGS,
    Compiler,
    ToolchainError,
    built_once,
    firmware_sources,
    zig,
    zig_folders,
)


@dataclass(frozen=True)
class Chip:
    """A chip with a port of its own, without an operating system.

    Attributes:
        name: for errors.
        port: folder of the port in ``firmware``.
        script: linker script there.
        flash_bytes, ram_bytes: its memory.
        gate_input_first: number of the analog input at the gate of the fifth limb; the next ones follow.
    """

    name: str
    port: str
    script: str
    flash_bytes: int
    ram_bytes: int
    gate_input_first: int


CHIPS: Mapping[str, Chip] = {
    "bench": Chip("nRF52832", "bench", "nrf52832.ld", 512 * 1024, 64 * 1024, gate_input_first=4),
}
"""Target -> chip."""
TARGETS = (*CHIPS, "native")
FLASH_PAGE_BYTES = 4096
SLOT_BYTES_MIN = 64 * 1024
_CODE_BYTES_MAX = 64 * 1024  # without the table; the linker refuses more


@dataclass(frozen=True)
class Firmware:
    """A built firmware image.

    Attributes:
        target: of ``CHIPS``, or "native".
        image: ELF file, or shared library.
        files: files by kind: elf, hex and map, or library.
        flash_bytes, ram_bytes: bytes of the chip's flash and RAM, including the stack; 0 for "native".
        stack_bytes: bytes reserved for the stack; 0 for "native".
        plan_time: keys of ``frogkick.front.plan_time``; empty where it was not asked for.
    """

    target: str
    image: Path
    files: dict[str, Path]
    flash_bytes: int = 0
    ram_bytes: int = 0
    stack_bytes: int = 0
    plan_time: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``firmware build``."""
        files = {what: str(path) for what, path in self.files.items()}
        return {**vars(self), "image": str(self.image), "files": files}

    def __repr__(self) -> str:
        return f"Firmware({self.target}, flash {self.flash_bytes} bytes, RAM {self.ram_bytes} bytes)"


PULSE_CEILING_S = 0.1
REST_FLOOR_S = 0.1
FIX_FRESH_CEILING_S = 0.5
FIX_LOST_CEILING_S = 2.0
CHECKED_CEILING = 18
"""Bounds of every robot's limits, the same as in fk_guard.h, where the compiler checks them again."""
_PORT_LATE_US = 200
"""``FK_PORT_LATE_US``: what a port may take from the time that it reports to the pins."""


def require_limits(robot: Robot) -> None:
    """Raise InputError for limits of a robot's file that no firmware takes."""
    guard = robot.guard
    for name, value, least, most in (
        ("pulse_max_s", guard.pulse_max_s, 1e-6, PULSE_CEILING_S),
        ("rest_min_s", guard.rest_min_s, REST_FLOOR_S, 60.0),
        ("duty_window_s", guard.duty_window_s, guard.pulse_max_s, 60.0),
        ("fix_fresh_s", guard.fix_fresh_s, 1e-6, FIX_FRESH_CEILING_S),
        ("fix_lost_s", guard.fix_lost_s, guard.fix_fresh_s, FIX_LOST_CEILING_S),
    ):
        if not least <= value <= most:
            raise InputError(
                f"guard.{name} of robot {robot.id!r} is {value:g} s, the firmware takes {least:g} to "
                f"{most:g} s: correct the robot's file"
            )
    remembered = (round(guard.duty_window_s * 1e6) + _PORT_LATE_US) // round(guard.rest_min_s * 1e6) + 2
    if remembered + guard.limbs_at_once_max > CHECKED_CEILING:
        most_s = (CHECKED_CEILING - 1 - guard.limbs_at_once_max) * guard.rest_min_s - 1e-3
        raise InputError(
            f"guard.duty_window_s of robot {robot.id!r} is {guard.duty_window_s:g} s: for so many rests "
            "within it the chip checks each pulse for too long, and would refuse it as late: give at most "
            f"{most_s:g} s, or a longer guard.rest_min_s"
        )
    if guard.duty_max >= 1.0:
        raise InputError(
            f"guard.duty_max of robot {robot.id!r} is {guard.duty_max:g}, which limits nothing: "
            "give less than 1 in the robot's file"
        )


def robot_config(robot: Robot) -> str:
    """The header that carries the robot's limits and planner defaults into the core."""
    require_limits(robot)
    guard, planner, battery = robot.guard, robot.planner, robot.battery
    inputs = battery.inputs if battery is not None else ()
    least_mv = math.ceil(1e3 * battery.low_v / battery.divider) if battery is not None and inputs else 0
    duty_on_us = round(guard.duty_max * guard.duty_window_s * 1e6)
    lines = [
        "/* Do not edit. Made by frogkick_codegen.firmware from the robot's TOML.",
        f" * Robot SHA-256 {robot.sha256.hex()}",
        " */",
        "#ifndef FK_ROBOT_CONFIG_H",
        "#define FK_ROBOT_CONFIG_H",
        "",
        f'#define FK_ROBOT_ID "{robot.id}"',
        "",
        "/* Limits of the guard. */",
        f"#define FK_PULSE_MAX_US {round(guard.pulse_max_s * 1e6)}u",
        f"#define FK_REST_MIN_US {round(guard.rest_min_s * 1e6)}u",
        f"#define FK_DUTY_WINDOW_US {round(guard.duty_window_s * 1e6)}u",
        f"#define FK_DUTY_ON_MAX_US {duty_on_us}u",
        f"#define FK_LIMBS_AT_ONCE_MAX {guard.limbs_at_once_max}u",
        "/* In a closed loop no pulse without a fix of the first, disarmed without one of the second. */",
        f"#define FK_FIX_FRESH_US {round(guard.fix_fresh_s * 1e6)}u",
        f"#define FK_FIX_LOST_US {round(guard.fix_lost_s * 1e6)}u",
        "",
        "/* Inputs of the SAADC that see a battery (bit n: AINn), and the least at such an input. */",
        f"#define FK_BATTERY_INPUTS {sum(1 << n for n in inputs):#x}u",
        f"#define FK_BATTERY_LEAST_MV {least_mv}",
        "",
        "/* Defaults of the planner; PARAM changes them. Hexadecimal floats lose no bit. */",
        *(f"#define FK_{name.upper()} {_c_float(getattr(planner, name))}" for name in WEIGHTS),
        f"#define FK_COST FK_COST_{planner.cost.upper()}",
        f"#define FK_DEPTH {planner.depth}u",
        f"#define FK_PLAN_TIME_US {round(planner.plan_time_s * 1e6)}u",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _c_float(value: float) -> str:
    return f"{float(value).hex()}f /* {value!r} */"


def build(
    target: str,
    image: Path,
    robot: Robot,
    out: Path,
    compiler: Compiler | None = None,
    timed: Callable[[Path, Path], Mapping[str, Any]] | None = None,
) -> Firmware:
    """Build firmware around a table image.

    Args:
        target: of ``CHIPS``, or "native".
        image: table image file.
        robot: the robot that the table is for; its limits go into the guard.
        out: folder for the results, not touched before everything is built; the same arguments give the
            same bytes.
        compiler: for the target "native"; zig where it is None.
        timed: of a chip's image (ELF) and the folder of its planner's sources: how long it plans
            (``Firmware.plan_time``), or an error where that is too long.

    Raises:
        InputError: unknown target, the table is for another robot, the limits of the robot's guard are out of
            range, the sources or a package are not installed, the image does not fit the chip, ``out`` cannot
            be written, or its folder ``emitted`` holds other files.
        ToolchainError: no compiler, or a refused source.
    """
    if target not in TARGETS:
        raise InputError(f"firmware target is {target!r}: choose from {', '.join(TARGETS)}")
    tables = read_image(image)
    tables.require_robot(robot.id)
    actions, states = len(tables.actions), len(tables.states)
    if transitions_of(tables) < actions:
        raise InputError(
            f"the table has {states} states: a look-up may take the chip "
            f"{look_up_most_ns(states, tables.tree_levels) * 1e-6:.0f} ms, and a decision longer than its "
            f"watchdog waits: build a table of at most {states_most(actions, tables.period_us)} states"
        )
    if compiler is None:
        require_tools(target)
    command = f"frogkick firmware build --target {target} --tables {image.name}"
    config = robot_config(robot)
    rendered = render(tables, command, PlanConfig(), robot.sha256)
    emitted = {name: content for name, content in rendered.items() if Path(name).suffix in (".c", ".h")}
    with _workshop(target, {**emitted, "fk_robot_config.h": config.encode()}) as work:
        if target in CHIPS:
            made = _build_image(work, target, tables.limbs, len(tables.image), robot)
            sizes = image_sizes(made["elf"], CHIPS[target])
            plan_time = timed(made["elf"], work / "emitted") if timed is not None else {}
        else:
            made, sizes, plan_time = _build_native(work, compiler or zig("host")), (0, 0, 0), {}
        files = {what: out / path.name for what, path in made.items()}
        contents = {files[what]: path.read_bytes() for what, path in made.items()}
        contents[out / "fk_robot_config.h"] = config.encode()
        with (
            ExitStack() as until_written
        ):  # all of it, or nothing: what a full disk refuses comes before any name
            for file, content in contents.items():
                with until_written.enter_context(atomic_path(file)).open("wb") as temporary:
                    temporary.write(content)
                    temporary.flush()
                    os.fsync(temporary.fileno())
            swap_in(out / "emitted", rendered)
    return Firmware(target, files["elf" if target in CHIPS else "library"], files, *sizes, plan_time)


@contextmanager
def _workshop(target: str, made: Mapping[str, bytes]) -> Iterator[Path]:
    """Yield a folder with all sources, where one process builds at a time.

    It is the same folder each time, and files that have not changed stay: zig then compiles little more than
    the table. First lines that name the table and the robot are blank here, so only what they say changes.
    """
    files = {
        f"{'config' if name == 'fk_robot_config.h' else 'emitted'}/{name}": _without_banner(content)
        for name, content in made.items()
    }
    firmware = firmware_sources()
    for place in ("core", *(chip.port for chip in CHIPS.values())):
        for path in (firmware / place).iterdir():
            if path.suffix in (".c", ".h", ".ld"):
                files[f"firmware/{place}/{path.name}"] = path.read_bytes()
    folder = cache_folder("workshop")
    config = hashlib.sha256(files["config/fk_robot_config.h"]).hexdigest()[:16]
    with ExitStack() as until_built:
        try:
            work = until_built.enter_context(one_at_a_time(folder, f"{target}-{config}")).resolve()
            for path in sorted(work.rglob("*")):
                if path.is_file() and path.relative_to(work).as_posix() not in (*files, ".lock"):
                    path.unlink()
            for name, content in files.items():
                file = work / name
                if not file.exists() or file.read_bytes() != content:
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_bytes(content)
        except OSError as error:
            raise ToolchainError(
                f"cannot build in {str(folder)!r} ({error.strerror}): set FROGKICK_CACHE_DIR to a writable "
                "folder"
            ) from error
        yield work


def _without_banner(content: bytes) -> bytes:
    """The file without its first comment; what follows keeps the numbers of its lines."""
    banner, end, rest = content.partition(b"*/")
    return b"\n" * banner.count(b"\n") + rest if end and banner.startswith(b"/*") else content


def require_tools(target: str) -> None:
    """Raise an error for a target that cannot be built here; ``doctor`` checks the same."""
    firmware_sources()
    zig("chip" if target in CHIPS else "host")
    if target in CHIPS:
        require("the image for the chip", "elftools", "intelhex")


def _sources(work: Path) -> tuple[list[Path], list[Path], list[str]]:
    """C files, headers, and the compiler's flags with their folders."""
    core = work / "firmware" / "core"
    folders = [work / "config", work / "emitted", core]
    emitted = [path for path in sorted(folders[1].glob("*.c")) if "example" not in path.name]
    headers = [path for folder in folders for path in sorted(folder.glob("*.h"))]
    places = [
        *(f"-I{folder}" for folder in folders),
        # Debug information would otherwise name these folders, and differ by place.
        f"-ffile-prefix-map={work}=.",
        *(f"-ffile-prefix-map={folder}=zig" for folder in zig_folders()),
    ]
    return emitted + sorted(core.glob("*.c")), headers, places


def slots_for(table_bytes: int, chip: Chip = CHIPS["bench"]) -> tuple[int, int]:
    """Slots for tables by radio beside a built-in table: how many fit, one or two, and bytes of each."""
    slot = max(SLOT_BYTES_MIN, -(-table_bytes // FLASH_PAGE_BYTES) * FLASH_PAGE_BYTES)
    store_end = chip.flash_bytes // 10 * 9  # the linker script refuses more
    room = store_end - 2 * FLASH_PAGE_BYTES - _CODE_BYTES_MAX - table_bytes
    return (2 if 2 * slot <= room else 1), slot


def _build_image(work: Path, target: str, limbs: int, table_bytes: int, robot: Robot) -> dict[str, Path]:
    chip = CHIPS[target]
    for limb in range(4, limbs):
        taken = chip.gate_input_first + limb - 4
        if robot.battery is not None and taken in robot.battery.inputs:
            raise InputError(
                f"battery.inputs of robot {robot.id!r} has {taken}, on the bench the gate of limb {limb + 1} "
                f"of {limbs}: take another input"
            )
    port = work / "firmware" / chip.port
    sources, headers, places = _sources(work)
    sources, script = [*sources, *sorted(port.glob("*.c"))], port / chip.script
    elf = work / f"frogkick-{target}.elf"
    slots, slot_bytes = slots_for(table_bytes, chip)
    flags = [
        *FLAGS,
        "-ffreestanding",
        "-ffunction-sections",
        "-fdata-sections",
        f"-DFK_BOARD_LIMBS={limbs}u",
        f"-DFK_BOARD_SLOTS={slots}u",
        f"-DFK_BOARD_SLOT_BYTES={slot_bytes}u",
        "-fno-unwind-tables",
        "-fno-asynchronous-unwind-tables",
        "-nostdlib",
        "-Wl,--entry=fk_reset",
        "-Wl,--gc-sections",
    ]
    files = [*sources, *headers, *sorted(port.glob("*.h")), script]
    elf.write_bytes(
        built_once(zig("chip"), flags, [*places, f"-I{port}", f"-Wl,-T,{script}", *sources], files, elf)
    )
    return {"elf": elf, "hex": _hex_of(elf), "map": write_map(elf)}


def _build_native(work: Path, compiler: Compiler) -> dict[str, Path]:
    sources, headers, places = _sources(work)
    port = work / "native_port.c"
    write_bytes(port, (resources.files("frogkick_codegen") / "templates" / port.name).read_bytes())
    declarations = work / declared.SOURCE
    write_bytes(
        declarations, declared.source({path.name: path.read_bytes() for path in [*headers, *sources, port]})
    )
    sources += [port, declarations]
    name = compiler.version.encode()
    digest = hashlib.sha256(name + b"".join(path.read_bytes() for path in [*sources, *headers])).hexdigest()[
        :12
    ]
    # A library that is already loaded must not be overwritten: each content has its own name.
    suffix = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")
    library = work / f"frogkick-native-{digest}{suffix}"
    flags = [*FLAGS, "-fPIC", "-shared"]
    library.write_bytes(built_once(compiler, flags, [*places, *sources], [*sources, *headers], library))
    return {"library": library}


def _hex_of(elf: Path) -> Path:
    """Intel HEX of the ELF's loadable segments at their load addresses."""
    from elftools.elf.elffile import ELFFile
    from intelhex import IntelHex

    content = IntelHex()
    with elf.open("rb") as file:
        for segment in ELFFile(file).iter_segments("PT_LOAD"):
            if segment["p_filesz"]:
                content.puts(segment["p_paddr"], segment.data())
    target = elf.with_suffix(".hex")
    content.write_hex_file(str(target))
    return target


def image_sizes(elf: Path, chip: Chip = CHIPS["bench"]) -> tuple[int, int, int]:
    """Flash, RAM and reserved stack, bytes, of a chip's image (ELF); InputError where the chip has less."""
    from elftools.common.exceptions import ELFError
    from elftools.elf.elffile import ELFFile

    flash = ram = 0
    with elf.open("rb") as file:
        try:
            content = ELFFile(file)
        except ELFError as error:
            raise InputError(
                f"{elf.name!r} is not a firmware image of frogkick ({error}): build it again"
            ) from error
        for segment in content.iter_segments("PT_LOAD"):
            flash += segment["p_filesz"]
            if segment["p_vaddr"] >= 0x20000000:
                ram += segment["p_memsz"]
        flash = max(flash, _address(content, elf, "fk_region_end"))
        bottom, top = (_address(content, elf, name) for name in ("fk_stack_bottom", "fk_stack_top"))
    for what, used, limit in (("flash", flash, chip.flash_bytes), ("RAM", ram, chip.ram_bytes)):
        if used > limit:
            raise InputError(
                f"the firmware needs {used} bytes of {what}, the {chip.name} has {limit}: use a smaller table"
            )
    return flash, ram, top - bottom


def _address(content: Any, elf: Path, name: str) -> int:
    from elftools.elf.sections import SymbolTableSection

    table = content.get_section_by_name(".symtab")
    found = table.get_symbol_by_name(name) if isinstance(table, SymbolTableSection) else None
    if not found:
        raise InputError(f"{elf.name!r} has no symbol {name!r}: build it again, without stripping")
    return int(found[0]["st_value"])
