"""POWER's reset reason and the watchdog."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from frogkick.pool.chip.bus import Peripheral, Register, System, array
from frogkick.pool.chip.scheduler import CYCLES_PER_US, NEVER

LFCLK_HZ: Final = 32_768
DOG: Final = 1 << 1
_CYCLES_PER_S: Final = CYCLES_PER_US * 1_000_000
_RELOAD: Final = 0x6E524635
_CONFIG_SLEEP_RUN: Final = 1
_CRV_MIN: Final = 0xF


class Power(Peripheral):
    """Why the chip started. They add up over all resets but power-on; writing a one takes one back."""

    NAME = "POWER"
    REGISTERS = [Register("RESETREAS", 0x400, "rw")]

    def on_write(self, name: str, value: int) -> None:
        """Take reasons back."""
        self.values[name] &= ~value


class Watchdog(Peripheral):
    """A countdown of the 32,768 Hz clock that resets the chip, unless the one request register reloads it."""

    NAME = "WDT"
    REGISTERS = [
        Register("TASKS_START", 0x000, "w"),
        Register("CRV", 0x504, "rw"),
        Register("RREN", 0x508, "rw"),
        Register("CONFIG", 0x50C, "rw"),
        *array("RR[{}]", 0x600, "w", 8),
    ]

    def __init__(self, system: System, name: str, base: int, on_timeout: Callable[[], None]) -> None:
        """``on_timeout`` resets the chip."""
        super().__init__(system, name, base)
        self.values |= {"CRV": 0xFFFF_FFFF, "RREN": 1, "CONFIG": 1}
        self._running = False
        self._due = NEVER
        self._timeout = system.scheduler.add(on_timeout)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Meanwhile it stands still, as under a debugger: who calls from outside does not feed it."""
        left = self._due - self.system.now_cycle
        self.system.scheduler.at(self._timeout, NEVER)
        try:
            yield
        finally:
            if self._running:
                self._due = self.system.now_cycle + left
                self.system.scheduler.at(self._timeout, self._due)

    def _reload(self) -> None:
        cycles = (self.values["CRV"] + 1) * _CYCLES_PER_S // LFCLK_HZ
        self._due = self.system.now_cycle + cycles
        self.system.scheduler.at(self._timeout, self._due)

    def on_task(self, name: str) -> None:
        """Start; a second time does nothing."""
        if not self._running:
            self._running = True
            self._reload()

    def on_write(self, name: str, value: int) -> None:
        """Set it up while it does not run yet, or feed it."""
        if name.startswith("RR["):
            if value != _RELOAD:
                raise self.refuse(name, value, "only 0x6e524635 reloads the watchdog")
            if name != "RR[0]":
                raise self.refuse(name, value, "only RR[0] is enabled")
            if self._running:
                self._reload()
            return
        if self._running:
            raise self.refuse(name, value, "the watchdog runs: nothing can be changed until a reset")
        if name == "CRV":
            self.allow(name, value, range(_CRV_MIN, 1 << 32))
        else:
            # Paused in sleep it would not see a robot that never wakes.
            self.allow(name, value, (_CONFIG_SLEEP_RUN,) if name == "CONFIG" else (1,))
        self.values[name] = value
