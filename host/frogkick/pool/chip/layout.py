"""The firmware's structures as numpy types, from the debug information of its own ELF."""

from __future__ import annotations

from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from elftools.dwarf.descriptions import describe_form_class
from elftools.elf.elffile import ELFFile

from frogkick.pool.chip.bus import ChipError

_FLOAT, _SIGNED, _UNSIGNED = 4, (5, 6, 13), (2, 7, 8)
"""DW_ATE_ numbers of base types: DWARF 4, section 7.8."""


class Layouts:
    """Types of a firmware by the names of their typedefs."""

    def __init__(self, elf_path: Path | str) -> None:
        """Find the typedefs of an ELF.

        Raises:
            ChipError: it has no debug information.
        """
        self._types = _types_of(Path(elf_path).read_bytes(), Path(elf_path).name)

    def __getitem__(self, name: str) -> np.dtype[Any]:
        """Return a type, members at the firmware's own offsets.

        Raises:
            ChipError: the firmware has none of that name.
        """
        found: np.dtype[Any] | None = self._types.get(name)
        if found is None:
            raise ChipError(f"the firmware has no type {name!r} that can be written from outside")
        return found

    def __contains__(self, name: str) -> bool:
        """Whether the firmware has a type of that name."""
        return self._types.get(name) is not None


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
    return {name: _dtype(die) for name, die in dies.items() if name.startswith("fk_")}


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
