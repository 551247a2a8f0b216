"""RNG: a byte of noise at a time."""

from __future__ import annotations

import random
from typing import Final

from frogkick.pool.chip.bus import Peripheral, Register, System
from frogkick.pool.chip.scheduler import CYCLES_PER_US, NEVER

BYTE_CYCLES: Final = 120 * CYCLES_PER_US
"""One byte with bias correction, typical value of the product specification (t_RNG,BC)."""
_DERCEN: Final = 1


class Rng(Peripheral):
    """Noise that is the same for every chip, so that the same firmware and calls give the same bytes."""

    NAME = "RNG"
    REGISTERS = [
        Register("TASKS_START", 0x000, "w"),
        Register("TASKS_STOP", 0x004, "w"),
        Register("EVENTS_VALRDY", 0x100, "rw"),
        Register("CONFIG", 0x504, "rw"),
        Register("VALUE", 0x508, "r"),
    ]

    def __init__(self, system: System, name: str, base: int) -> None:
        """Stopped; arguments as for every peripheral."""
        super().__init__(system, name, base)
        self._noise = random.Random(name)
        self._next = system.scheduler.add(self._make)

    def on_write(self, name: str, value: int) -> None:
        """Only with bias correction are the bytes of use."""
        self.allow(name, value, (_DERCEN,))
        self.values[name] = value

    def on_task(self, name: str) -> None:
        """Begin, or stop."""
        if name == "TASKS_START" and not self.values["CONFIG"] & _DERCEN:
            raise self.refuse(name, 1, "the bytes would be biased: set CONFIG.DERCEN first")
        at = self.system.now_cycle + BYTE_CYCLES if name == "TASKS_START" else NEVER
        self.system.scheduler.at(self._next, at)

    def _make(self) -> None:
        self.values["VALUE"] = self._noise.getrandbits(8)
        self.system.scheduler.at(self._next, self.system.now_cycle + BYTE_CYCLES)
        self.raise_event("EVENTS_VALRDY")
