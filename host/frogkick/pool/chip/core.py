"""The Cortex-M4's own registers: pending interrupts, sleep, access to the FPU."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from frogkick.pool.chip.bus import Peripheral, Register, System

SEVONPEND: Final = 1 << 4
_CP10_CP11: Final = 0xF << 20


class CoreRegisters(Peripheral):
    """NVIC and SCB. No interrupt is taken: a pending one can only wake WFE (ARMv7-M ARM, B1.5.18)."""

    NAME = "SCS"
    REGISTERS = [
        Register("NVIC_ICPR0", 0x280, "rw"),
        Register("NVIC_ICPR1", 0x284, "rw"),
        Register("SCB_SCR", 0xD10, "rw"),
        Register("SCB_CPACR", 0xD88, "rw"),
    ]

    def __init__(self, system: System, name: str, base: int, on_fpu: Callable[[bool], None]) -> None:
        """``on_fpu`` hears when the FPU is switched."""
        super().__init__(system, name, base)
        self._on_fpu = on_fpu
        self._lines = 0
        self._pending = 0
        self.event_register = False

    def set_line(self, irq: int, level: bool) -> None:
        """A peripheral's line changed: pending follows a high line, and stays when it goes low."""
        self._lines = self._lines | 1 << irq if level else self._lines & ~(1 << irq)
        self._pend()

    def _pend(self) -> None:
        new = self._lines & ~self._pending
        self._pending |= self._lines
        if new and self.values["SCB_SCR"] & SEVONPEND:
            self.event_register = True

    def on_read(self, name: str) -> int:
        """Pending interrupts, or the register's value."""
        return self._pending if name == "NVIC_ICPR0" else self.values[name]

    def on_write(self, name: str, value: int) -> None:
        """Take back pending interrupts, allow waking by them, switch the FPU on or off."""
        if name == "NVIC_ICPR0":
            self._pending &= ~value
            self._pend()  # a line that is still high makes its interrupt pending again
            return
        if name == "NVIC_ICPR1":
            return  # only the FPU's of these is ever pending, where its flags stand
        if name == "SCB_SCR":
            self.allow(name, value, (0, SEVONPEND))
        else:
            self.allow(name, value, (0, _CP10_CP11))
            self._on_fpu(value == _CP10_CP11)
        self.values[name] = value
