"""A map of an image: addresses and sizes of its sections and symbols."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from frogkick.core.files import write_text

RAM_START = 0x20000000


def write_map(elf: Path) -> Path:
    """Write the map of an ELF beside it: sections, then every function and object by address, with its size.

    zig's linker makes none; this one is read from the image itself.
    """
    from elftools.elf.elffile import ELFFile

    with elf.open("rb") as file:
        content = ELFFile(file)
        sections = [
            (int(section["sh_addr"]), int(section["sh_size"]), str(section.name))
            for section in content.iter_sections()
            if section["sh_flags"] & 2 and section["sh_size"]
        ]
        symbols = _symbols(content)
    lines = [f"{elf.name}: addresses and sizes", "", "sections", "address     bytes  name"]
    lines += [f"0x{address:08x} {size:6d}  {name}" for address, size, name in sorted(sections)]
    for title, low, high in (("flash", 0, RAM_START), ("RAM", RAM_START, 1 << 32)):
        own = [row for row in symbols if low <= row[0] < high]
        lines += ["", f"{title}: {sum(row[1] for row in own)} bytes in {len(own)} symbols"]
        lines += ["address     bytes  section  name"]
        lines += [f"0x{address:08x} {size:6d}  {section}  {name}" for address, size, section, name in own]
    target = elf.with_suffix(".map")
    write_text(target, "\n".join(lines) + "\n")
    return target


def _symbols(content: Any) -> list[tuple[int, int, str, str]]:
    """Address, bytes, section, name of every function and object that takes room."""
    from elftools.elf.sections import SymbolTableSection

    found = set()
    for table in content.iter_sections():
        if not isinstance(table, SymbolTableSection):
            continue
        for symbol in table.iter_symbols():
            kind, index = symbol["st_info"]["type"], symbol["st_shndx"]
            if kind not in ("STT_FUNC", "STT_OBJECT") or not symbol["st_size"] or not isinstance(index, int):
                continue
            section = str(content.get_section(index).name)
            # A function's address has the Thumb bit set.
            address = int(symbol["st_value"]) & ~1 if kind == "STT_FUNC" else int(symbol["st_value"])
            found.add((address, int(symbol["st_size"]), section, str(symbol.name)))
    return sorted(found)
