"""The firmware's ELF: flash content, symbols, and its structures as numpy types.

A file that is no firmware for this chip raises an ``InputError``, an unknown type a ``ChipError``.
"""

from __future__ import annotations

import bisect
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from elftools.common.exceptions import ELFError
from elftools.dwarf.descriptions import describe_form_class
from elftools.elf.elffile import ELFFile

from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.pool.chip.bus import FLASH_BYTES, RAM_BASE, RAM_BYTES, ChipError


class Symbol(NamedTuple):
    """A row of the symbol table; ``kind`` without its STT_, functions with their Thumb bit."""

    name: str
    address: int
    bytes: int
    kind: str


@dataclass(frozen=True)
class FirmwareImage:
    """All 512 KB of flash, erased (0xff) where the firmware has nothing, and the symbols."""

    flash: bytes
    table: tuple[Symbol, ...]

    @cached_property
    def symbols(self) -> dict[str, int]:
        """Address of each symbol by name."""
        return {each.name: each.address for each in self.table}

    @cached_property
    def functions(self) -> list[tuple[int, str]]:
        """Address and name of each, sorted."""
        return sorted((each.address & ~1, each.name) for each in self.table if each.kind == "FUNC")

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Bytes of flash by name, of functions and constants."""
        kept = (each for each in self.table if each.kind in ("FUNC", "OBJECT") and each.address < FLASH_BYTES)
        return {each.name: each.bytes for each in kept}

    @property
    def stack_pointer(self) -> int:
        """Stack pointer at reset: first vector."""
        return int.from_bytes(self.flash[0:4], "little")

    @property
    def reset_address(self) -> int:
        """Reset handler: second vector, without its Thumb bit."""
        return int.from_bytes(self.flash[4:8], "little") & ~1

    def function_at(self, address: int) -> str:
        """Name of the function that begins at an address or last before it; "?" without one."""
        place = bisect.bisect_right(self.functions, (address, "\U0010ffff")) - 1
        return self.functions[place][1] if place >= 0 else "?"


def load_image(path: Path | str, flash_before: bytes | None = None) -> FirmwareImage:
    """Read an ELF for the nRF52832.

    ``flash_before``: what the flash of such a chip held when it lost its power; None: what the ELF has.
    """
    file = existing_file(path, "firmware image")
    flash = bytearray(b"\xff" * FLASH_BYTES)
    symbols: list[Symbol] = []
    try:
        with file.open("rb") as stream:
            elf = ELFFile(stream)
            if elf["e_machine"] != "EM_ARM":
                raise InputError(
                    f"firmware image {str(path)!r} is for {elf['e_machine']}: build it for the nRF52832"
                )
            for segment in elf.iter_segments("PT_LOAD"):
                data = segment.data()
                begin = segment["p_paddr"]
                if data and begin + len(data) > FLASH_BYTES:
                    raise InputError(
                        f"firmware image {str(path)!r} has {len(data)} bytes for 0x{begin:08x}, outside "
                        f"the flash (0 to 0x{FLASH_BYTES:x}): link it with nrf52832.ld"
                    )
                flash[begin : begin + len(data)] = data
            table: Any = elf.get_section_by_name(".symtab")
            for symbol in table.iter_symbols() if table is not None else ():
                kind = str(symbol["st_info"]["type"]).removeprefix("STT_")  # a number where ELF has no name
                symbols.append(Symbol(symbol.name, symbol["st_value"], symbol["st_size"], kind))
    except (ELFError, UnicodeDecodeError) as error:
        raise InputError(
            f"firmware image {str(path)!r} is not a whole ELF file ({error}): build it again"
        ) from error
    image = FirmwareImage(flash_before or bytes(flash), tuple(symbols))
    vector = int.from_bytes(image.flash[4:8], "little")
    if not (RAM_BASE < image.stack_pointer <= RAM_BASE + RAM_BYTES and vector & 1 and vector < FLASH_BYTES):
        raise InputError(
            f"firmware image {str(path)!r} has no vectors at address 0 (stack 0x{image.stack_pointer:08x}, "
            f"reset 0x{vector:08x}): link it with nrf52832.ld"
        )
    return image


UNWANTED: Final[Mapping[str, re.Pattern[str]]] = {
    "64-bit division": re.compile(r"__aeabi_u?ldivmod|__u?(div|mod|divmod)[dt]i[34]|__divmod[dt]i4"),
    "double": re.compile(
        r"__aeabi_(d(add|sub|rsub|mul|div|neg|cmp\w*|2\w+)|cd\w+|u?[il]2d|f2d|h2d)"
        r"|__\w*df[23]|__(fix|fixuns|float|floatun|trunc|extend)\w*df\w*"
    ),
    "float arithmetic in software": re.compile(
        r"__aeabi_(f(add|sub|rsub|mul|div|neg|cmp\w*|2\w+)|cf\w+|u?[il]2f|h2f\w*|d2f)"
        r"|__\w*sf[23]|__(fix|fixuns|float|floatun|trunc|extend)\w*sf\w*"
    ),
    "libm": re.compile(
        r"_*(a?(sin|cos|tan)h?|atan2|sqrt|cbrt|exp[2m]?1?|log(2|10|1p)?|pow|hypot|fmod|remainder|fabs|floor|ceil"
        r"|round|l?lround|rint|l?lrint|nearbyint|trunc|ldexp|frexp|fma|fmin|fmax|copysign|sincos)[fl]?"
        r"|__(ieee754|kernel|rem_pio2)\w*"
    ),
    "heap": re.compile(r"_*(malloc|calloc|realloc|free|memalign|aligned_alloc|sbrk)(_r)?"),
}
"""What it is -> names of functions that show it: Arm's run-time ABI, libgcc, the C library."""


def unwanted(symbols: Iterable[str]) -> list[str]:
    """Return 'name: what it is' for each symbol that a firmware must not have."""
    found = []
    for symbol in sorted(set(symbols)):
        what = next(
            (what for what, pattern in UNWANTED.items() if pattern.fullmatch(symbol.split(".")[0])), ""
        )
        found += [f"{symbol}: {what}"] if what else []
    return found


_FLOAT, _SIGNED, _UNSIGNED = 4, (5, 6, 13), (2, 7, 8)
"""DW_ATE_ numbers of base types: DWARF 4, section 7.8."""


class Layouts(dict[str, "np.dtype[Any]"]):
    """Types of a firmware by the names of their typedefs, members at the firmware's own offsets."""

    def __init__(self, elf_path: Path | str) -> None:
        super().__init__(_types_of(Path(elf_path).read_bytes(), Path(elf_path).name))

    def __missing__(self, name: str) -> np.dtype[Any]:
        raise ChipError(f"the firmware has no type {name!r} that can be written from outside")


@lru_cache(maxsize=8)  # reading takes a second
def _types_of(content: bytes, name: str) -> dict[str, Any]:
    dies: dict[str, Any] = {}
    elf = ELFFile(BytesIO(content))
    if not elf.has_dwarf_info():
        raise ChipError(f"firmware {name!r} has no debug information: do not strip it")
    for unit in elf.get_dwarf_info().iter_CUs():
        for die in unit.iter_DIEs():
            if die.tag == "DW_TAG_typedef" and "DW_AT_type" in die.attributes:
                dies.setdefault(die.attributes["DW_AT_name"].value.decode(), die)
    types = {name: _dtype(die) for name, die in dies.items() if name.startswith("fk_")}
    return {name: found for name, found in types.items() if found is not None}


def _dtype(die: Any) -> Any:
    """Type of a DIE; None for what has no value of its own, as a function."""
    if die.tag == "DW_TAG_base_type":
        size, encoding = die.attributes["DW_AT_byte_size"].value, die.attributes["DW_AT_encoding"].value
        kind = {_FLOAT: "f", **dict.fromkeys(_SIGNED, "i"), **dict.fromkeys(_UNSIGNED, "u")}.get(encoding)
        return None if kind is None else np.dtype(f"<{kind}{size}")
    if die.tag == "DW_TAG_pointer_type":
        return np.dtype("<u4")
    if die.tag == "DW_TAG_enumeration_type":
        return np.dtype(f"<i{die.attributes['DW_AT_byte_size'].value}")
    if die.tag == "DW_TAG_structure_type":
        return _structure(die)
    if "DW_AT_type" not in die.attributes:
        return None
    inner = _dtype(die.get_DIE_from_attribute("DW_AT_type"))
    if die.tag == "DW_TAG_array_type":
        return None if inner is None else np.dtype((inner, _shape(die)))
    return inner if die.tag in ("DW_TAG_typedef", "DW_TAG_const_type", "DW_TAG_volatile_type") else None


def _structure(die: Any) -> Any:
    members = [child for child in die.iter_children() if child.tag == "DW_TAG_member"]
    types = [_dtype(member.get_DIE_from_attribute("DW_AT_type")) for member in members]
    if "DW_AT_byte_size" not in die.attributes or any(found is None for found in types):
        return None
    return np.dtype(
        {
            "names": [member.attributes["DW_AT_name"].value.decode() for member in members],
            "formats": types,
            "offsets": [member.attributes["DW_AT_data_member_location"].value for member in members],
            "itemsize": die.attributes["DW_AT_byte_size"].value,
        }
    )


def _shape(die: Any) -> tuple[int, ...]:
    sizes = []
    for child in die.iter_children():
        if child.tag == "DW_TAG_subrange_type":
            attribute = child.attributes.get("DW_AT_count") or child.attributes["DW_AT_upper_bound"]
            assert describe_form_class(attribute.form) == "constant"
            sizes.append(int(attribute.value) + (0 if "DW_AT_count" in child.attributes else 1))
    return tuple(sizes)
