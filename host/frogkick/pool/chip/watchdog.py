"""POWER's reset reason and power-fail comparator, and the watchdog."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ClassVar, Final

from frogkick.pool.chip.bus import CYCLES_PER_US, NEVER, Peripheral, Register, System, array

LFCLK_HZ: Final = 32_768
DOG: Final = 1 << 1
_CYCLES_PER_S: Final = CYCLES_PER_US * 1_000_000
_RELOAD: Final = 0x6E524635
_CONFIG_SLEEP_RUN: Final = 1
_CRV_MIN: Final = 0xF
SUPPLY_V: Final = 3.0
"""Of Nordic's kit."""
_POF_LEAST, _POF_LEAST_V = 4, 1.7


class Power(Peripheral):
    """Why the chip started, and the comparator that warns of a falling supply.

    Reasons add up over all resets but power-on; writing a one takes one back. The comparator warns when the
    supply falls below its threshold, or is below when it is switched on; of one that rises it says nothing.

    Attributes:
        supply_v: what the chip is supplied with; ``set_supply`` changes it.
        input_v: voltages at the analogue inputs AIN0 to AIN7.
        constant_latency: the mode that costs current asleep; a reset leaves the other.
        crystal_works: whether the board's 32 MHz crystal ever starts.
    """

    NAME = "POWER"
    REGISTERS = [
        Register("TASKS_LOWPWR", 0x07C, "w"),
        Register("EVENTS_POFWARN", 0x108, "rw"),
        Register("INTENSET", 0x304, "rw"),
        Register("RESETREAS", 0x400, "rw"),
        Register("POFCON", 0x510, "rw"),
    ]
    INTERRUPT_EVENTS: ClassVar[dict[int, str]] = {2: "EVENTS_POFWARN"}

    supply_v = SUPPLY_V
    constant_latency = False
    crystal_works = True
    _is_below = False

    def __init__(self, system: System, name: str, base: int) -> None:
        """Well supplied, nothing at the analogue inputs; arguments as for every peripheral."""
        super().__init__(system, name, base)
        self.input_v = [0.0] * 8

    def reset(self) -> None:
        """A reset of the chip: the comparator is off, the reasons stay, and so does the supply."""
        self.values |= {"EVENTS_POFWARN": 0, "POFCON": 0}
        self._interrupts = 0
        self._is_below = self.constant_latency = False

    def set_supply(self, supply_v: float) -> None:
        """Another supply from now on, V."""
        self.supply_v = supply_v
        self._compare()

    def _compare(self) -> None:
        """POFCON.THRESHOLD: 4 is 1.7 V, and each more 0.1 V."""
        threshold_v = _POF_LEAST_V + 0.1 * ((self.values["POFCON"] >> 1) - _POF_LEAST)
        was_below, self._is_below = self._is_below, self.supply_v < threshold_v
        if not self.values["POFCON"] & 1:
            self._is_below = False
        elif self._is_below and not was_below:
            self.raise_event("EVENTS_POFWARN")

    def on_task(self, name: str) -> None:
        """Go back to the mode after a reset."""
        self.constant_latency = False

    def on_clear_task(self, channel: int) -> None:
        """Erratum 156: a CLR task of GPIOTE switches the mode as well, even ones this way, odd ones that."""
        self.constant_latency = channel % 2 == 0

    def on_write(self, name: str, value: int) -> None:
        """Take reasons back; switch the comparator."""
        if name == "RESETREAS":
            self.values[name] &= ~value
            return
        self.allow(name, value >> 1, range(_POF_LEAST, 16))
        self.values[name] = value
        self._compare()


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
        self.started_cycle = NEVER
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
            self.started_cycle = self.system.now_cycle
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
