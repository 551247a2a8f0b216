"""CLOCK, FICR, NVMC and RNG, as far as the firmware uses them."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Final

from frogkick.pool.chip.bus import CYCLES_PER_US, NEVER, Peripheral, Register, System
from frogkick.pool.chip.flash import ERASE, READ_ONLY, WRITE, Flash
from frogkick.pool.chip.timer import HFINT_PERCENT, Timer
from frogkick.pool.chip.watchdog import Power

HFXO_START_CYCLES: Final = 360 * CYCLES_PER_US
"""Start of the 32 MHz crystal, typical value of the product specification (t_START_HFXO)."""


_XTAL, _RUNNING = 1, 1 << 16


class Clock(Peripheral):
    """The 32 MHz crystal: its start, its end, and who counts by it."""

    NAME = "CLOCK"
    REGISTERS = [
        Register("TASKS_HFCLKSTART", 0x000, "w"),
        Register("EVENTS_HFCLKSTARTED", 0x100, "rw"),
        Register("HFCLKSTAT", 0x40C, "r"),
        Register("ERRATUM_31", 0x53C, "rw"),
        Register("ERRATUM_108", 0xEE4, "rw"),
    ]

    def __init__(self, system: System, name: str, base: int, power: Power, timers: Sequence[Timer]) -> None:
        """Start on the internal oscillator.

        Args:
            system, name, base: as for every peripheral.
            power: the block that outlives a reset, and so knows whether the crystal works.
            timers: whatever counts by it.
        """
        super().__init__(system, name, base)
        self._power = power
        power.constant_latency = False
        self._timers = timers
        self._started = system.scheduler.add(self._run)
        self.values["HFCLKSTAT"] = _RUNNING

    def _switch(self, crystal: bool) -> None:
        self.values["HFCLKSTAT"] = _RUNNING | (_XTAL if crystal else 0)
        for timer in self._timers:
            timer.count_by(100 if crystal else HFINT_PERCENT)

    def _run(self) -> None:
        self._switch(True)
        self.raise_event("EVENTS_HFCLKSTARTED")

    def break_down(self) -> None:
        """The crystal stops, and will not start again."""
        self._power.crystal_works = False
        self.system.scheduler.at(self._started, NEVER)
        self._switch(False)

    def on_task(self, name: str) -> None:
        """Start the crystal."""
        if self._power.crystal_works:
            self.system.scheduler.at(self._started, self.system.now_cycle + HFXO_START_CYCLES)


class Ficr(Peripheral):
    """What the factory has written: two words without a name, which start-up code copies after a reset."""

    NAME = "FICR"
    REGISTERS = [Register("ERRATUM_31", 0x244, "r"), Register("ERRATUM_108", 0x258, "r")]

    def __init__(self, system: System, name: str, base: int) -> None:
        """Arbitrary values, which include bits that the start-up code must not copy."""
        super().__init__(system, name, base)
        self.values |= {"ERRATUM_31": 0x1234_BFFF, "ERRATUM_108": 0xFFFF_FFCA}


class Nvmc(Peripheral):
    """The instruction cache's switch, and flash. The core waits for that, and never sees READY at 0."""

    NAME = "NVMC"
    REGISTERS = [
        Register("READY", 0x400, "r"),
        Register("CONFIG", 0x504, "rw"),
        Register("ERASEPAGE", 0x508, "rw"),
        Register("ICACHECNF", 0x540, "rw"),
    ]

    def __init__(
        self, system: System, name: str, base: int, on_cache: Callable[[bool], None], flash: Flash
    ) -> None:
        """``on_cache`` hears when the cache is switched."""
        super().__init__(system, name, base)
        self._on_cache = on_cache
        self._flash = flash
        self.values["READY"] = 1
        flash.configure(READ_ONLY)
        # Memory must not change under an instruction of the emulator: it is done before the next one.
        self._configure = system.scheduler.add(lambda: flash.configure(self.values["CONFIG"]))
        self._erase = system.scheduler.add(lambda: flash.erase(self.values["ERASEPAGE"]))

    def on_write(self, name: str, value: int) -> None:
        """Switch the cache, allow writing or erasing, erase."""
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


RNG_BYTE_CYCLES: Final = 120 * CYCLES_PER_US
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
        """Refuse to run without bias correction, whose bytes the firmware needs."""
        self.allow(name, value, (_DERCEN,))
        self.values[name] = value

    def on_task(self, name: str) -> None:
        """Begin, or stop."""
        if name == "TASKS_START" and not self.values["CONFIG"] & _DERCEN:
            raise self.refuse(name, 1, "the bytes would be biased: set CONFIG.DERCEN first")
        at = self.system.now_cycle + RNG_BYTE_CYCLES if name == "TASKS_START" else NEVER
        self.system.scheduler.at(self._next, at)

    def _make(self) -> None:
        self.values["VALUE"] = self._noise.getrandbits(8)
        self.system.scheduler.at(self._next, self.system.now_cycle + RNG_BYTE_CYCLES)
        self.raise_event("EVENTS_VALRDY")
