"""Flash as NVMC erases and writes it, with its times and its wear.

An operation that the product specification does not allow raises a ``ChipError``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, Final

from frogkick.pool.chip.bus import CYCLES_PER_US, FLASH_BYTES, ChipError, Peripheral, System, registers
from frogkick.pool.chip.cost import PARTS
from frogkick.pool.chip.emulator import HookState, unicorn

PAGE_BYTES: Final = 4096
READ_ONLY, WRITE, ERASE = 0, 1, 2
"""CONFIG.WEN."""
WRITE_CYCLES: Final = 338 * CYCLES_PER_US
"""Time to write one word; upper end of the product specification (t_WRITE).

A core that runs from flash waits meanwhile.
"""
ERASE_CYCLES: Final = 89_700 * CYCLES_PER_US
"""Time to erase one page, upper end as well (t_ERASEPAGE)."""
BLOCK_BYTES: Final = 512
BLOCK_WRITES_MAX: Final = 181
"""Writes to a block between two erases of its page (n_WRITE)."""


class Flash:
    """The 512 KB of flash of a chip."""

    def __init__(self, fail: Callable[[str], ChipError]) -> None:
        self._fail = fail
        self._uc: Any = None
        self._block_writes: Counter[int] = Counter()
        self.mode = READ_ONLY
        self.words_written = 0  # since power-on
        self.erases: Counter[int] = Counter()  # of each page since power-on, by its number

    def attach(self, uc: Any, state: HookState, on_error: Callable[[ChipError], None]) -> None:
        """Use the core's memory and time; ``on_error`` is called for writes that the flash refuses."""
        self._uc = uc
        self._state = state

        def on_write(_uc: Any, _access: int, address: int, size: int, value: int, _data: Any) -> None:
            if self.mode == WRITE:  # else the core faults by itself
                try:
                    self._write(address, size, value & 0xFFFF_FFFF)
                except ChipError as error:
                    on_error(error)

        uc.hook_add(unicorn.UC_HOOK_MEM_WRITE, on_write, None, 0, FLASH_BYTES - 1)
        uc.ctl_flush_tb()  # code translated before a hook was added would not call it

    def configure(self, mode: int) -> None:
        """Allow reading alone, writing or erasing: READ_ONLY, WRITE, ERASE."""
        self.mode = mode
        if self._uc is not None:
            access = unicorn.UC_PROT_ALL if mode == WRITE else unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC
            self._uc.mem_protect(0, FLASH_BYTES, access)

    def _write(self, address: int, size: int, value: int) -> None:
        if size != 4 or address % 4:
            raise self._fail(
                f"write of {size} bytes to flash at 0x{address:08x}: only aligned words are taken"
            )
        old = self.word(address)
        if value & ~old:
            raise self._fail(
                f"write of 0x{value:08x} to flash at 0x{address:08x}, which holds 0x{old:08x}: "
                "only an erase turns bits to 1"
            )
        block = address // BLOCK_BYTES
        self._block_writes[block] += 1
        if self._block_writes[block] > BLOCK_WRITES_MAX:
            raise self._fail(
                f"write to flash at 0x{address:08x}: more than {BLOCK_WRITES_MAX} in its 512 bytes since the "
                "last erase"
            )
        self.words_written += 1
        self._state.time += WRITE_CYCLES * PARTS

    def require_erasable(self, address: int) -> None:
        """ChipError unless a page begins at an address and erasing is enabled."""
        if self.mode != ERASE:
            raise self._fail(f"erase of the page at 0x{address:08x}: NVMC.CONFIG does not enable erasing")
        if address % PAGE_BYTES or not 0 <= address < FLASH_BYTES:
            raise self._fail(f"erase at 0x{address:08x}: no page of flash begins there")

    def erase(self, address: int) -> None:
        """Erase the page at an address; the core waits ERASE_CYCLES."""
        self._uc.mem_write(address, b"\xff" * PAGE_BYTES)
        for block in range(address // BLOCK_BYTES, (address + PAGE_BYTES) // BLOCK_BYTES):
            self._block_writes[block] = 0
        self.erases[address // PAGE_BYTES] += 1
        self._state.time += ERASE_CYCLES * PARTS

    def word(self, address: int) -> int:
        """The 32-bit word at an address."""
        return int.from_bytes(self._uc.mem_read(address, 4), "little")

    def content(self) -> bytes:
        """The whole content, which survives a loss of power."""
        return bytes(self._uc.mem_read(0, FLASH_BYTES))


class Nvmc(Peripheral):
    """The instruction cache's switch, and flash. The core waits for that, and never sees READY at 0."""

    name, base = "NVMC", 0x4001_E000
    REGISTERS = [
        *registers("r", READY=0x400),
        *registers("rw", CONFIG=0x504, ERASEPAGE=0x508, ICACHECNF=0x540),
    ]
    RESET_VALUES = {"READY": 1}

    def __init__(self, system: System, on_cache: Callable[[bool], None], flash: Flash) -> None:
        super().__init__(system)
        self._on_cache = on_cache
        self._flash = flash
        flash.configure(READ_ONLY)
        # Memory must not change under an instruction of the emulator: it is done before the next one.
        self._configure = system.scheduler.add(lambda: flash.configure(self.values["CONFIG"]))
        self._erase = system.scheduler.add(lambda: flash.erase(self.values["ERASEPAGE"]))

    def on_write(self, name: str, value: int) -> None:
        if name == "ERASEPAGE":
            self._flash.require_erasable(value)
            self.values[name] = value
            self.system.scheduler.at(self._erase, self.system.now_cycle)
            return
        self.allow(name, value, (0, 1) if name == "ICACHECNF" else (READ_ONLY, WRITE, ERASE))
        self.values[name] = value
        if name == "CONFIG":
            self.system.scheduler.at(self._configure, self.system.now_cycle)
        else:
            self._on_cache(bool(value))
