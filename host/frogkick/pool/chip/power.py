"""POWER, the watchdog, CLOCK, the timers that count by it, FICR and RNG, as far as the firmware uses them."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Final

from frogkick.pool.chip.bus import CYCLES_PER_S, CYCLES_PER_US, NEVER, Peripheral, System, array, registers

CHANNELS: Final = 4
_BITS: Final = {0: 16, 1: 8, 2: 24, 3: 32}
_BASE_CYCLES: Final = 4  # the timer's 16 MHz clock in cycles of 64 MHz
_MODE_TIMER: Final = 0
_MODES_COUNTER: Final = (1, 2)
HFINT_PERCENT: Final = 108
"""Largest ratio of a time by the internal oscillator to that by the crystal (specification: f_TOL_HFINT)."""


class Timer(Peripheral):
    """A timer with four compare registers.

    It counts by the crystal, or, until that runs, by the internal oscillator, which may be slower. START
    begins a full tick of the prescaler; CLEAR begins the tick anew. A compare value that equals the counter
    when it is written matches only after the counter has gone all the way round.
    """

    REGISTERS = [
        *registers("w", TASKS_START=0x000, TASKS_STOP=0x004, TASKS_COUNT=0x008, TASKS_CLEAR=0x00C),
        *registers("w", TASKS_SHUTDOWN=0x010),
        *array("w", "TASKS_CAPTURE[{}]", 0x040, CHANNELS),
        *array("rw", "EVENTS_COMPARE[{}]", 0x140, CHANNELS),
        *registers("rw", SHORTS=0x200, INTENSET=0x304, INTENCLR=0x308),
        *registers("rw", MODE=0x504, BITMODE=0x508, PRESCALER=0x510),
        *array("rw", "CC[{}]", 0x540, CHANNELS),
    ]
    RESET_VALUES = {"PRESCALER": 4}
    KNOWN = {"MODE": range(3), "BITMODE": range(4), "PRESCALER": range(10)}
    INTERRUPT_EVENTS = {16 + i: f"EVENTS_COMPARE[{i}]" for i in range(CHANNELS)}

    def __init__(self, system: System, number: int) -> None:
        self.name, self.base = f"TIMER{number}", 0x4000_8000 + 0x1000 * number
        super().__init__(system)
        self._running = False
        self.draws = False  # current, from START until SHUTDOWN, though it was stopped (erratum 78)
        self._count = 0  # counter's value at _since, or the present value if it does not run by itself
        self._since = 0
        self._percent = HFINT_PERCENT  # time of a tick, of what it is by the crystal
        self._sources = [system.scheduler.add(partial(self._compare, i)) for i in range(CHANNELS)]

    @property
    def _mask(self) -> int:
        return (1 << _BITS[self.values["BITMODE"]]) - 1

    @property
    def _tick_centicycles(self) -> int:
        return (_BASE_CYCLES << self.values["PRESCALER"]) * self._percent

    @property
    def _ticks_by_itself(self) -> bool:
        return self._running and self.values["MODE"] == _MODE_TIMER

    @property
    def zero_cycle(self) -> int:
        """Cycle at which the counter of a timer that runs was 0, had it always counted as it does now."""
        return self._since - self._count * self._tick_centicycles // 100

    def count_by(self, percent: int) -> None:
        """From now on a tick takes this percentage of its time by the crystal; the current tick restarts."""
        count = self._counter()
        self._percent = percent
        self._set(count, self._running)

    def _ticks(self) -> int:
        return (self.system.now_cycle - self._since) * 100 // self._tick_centicycles

    def _counter(self) -> int:
        return (self._count + (self._ticks() if self._ticks_by_itself else 0)) & self._mask

    def _schedule(self, channel: int) -> None:
        cycle = NEVER
        if self._ticks_by_itself:
            mask = self._mask
            ticks = self._ticks()
            ahead = (self.values[f"CC[{channel}]"] - self._count - ticks) & mask or mask + 1
            cycle = self._since - (ticks + ahead) * self._tick_centicycles // -100
        self.system.scheduler.at(self._sources[channel], cycle)

    def _set(self, count: int, running: bool) -> None:
        self._count, self._running, self._since = count, running, self.system.now_cycle
        for channel in range(CHANNELS):
            self._schedule(channel)

    def _compare(self, channel: int) -> None:
        self._schedule(channel)
        shorts = self.values["SHORTS"]
        if shorts >> channel & 1:
            self._set(0, self._running)
        if shorts >> (8 + channel) & 1:
            self._set(self._counter(), False)
        self.raise_event(f"EVENTS_COMPARE[{channel}]")

    def on_write(self, name: str, value: int) -> None:
        if name in self.KNOWN and self._running:
            raise self.refuse(name, value, "the timer runs, stop it first")
        if name == "SHORTS":
            self.allow(name, value & ~0x0F0F, (0,))
        super().on_write(name, value)
        if name.startswith("CC"):
            self._schedule(int(name[3]))

    def on_task(self, name: str) -> None:
        if name == "TASKS_START":
            self.draws = True
            if not self._running:
                self._set(self._count, True)
        elif name == "TASKS_SHUTDOWN":
            self.draws = False
            self._set(0, False)
        elif name == "TASKS_STOP":
            self._set(self._counter(), False)
        elif name == "TASKS_CLEAR":
            self._set(0, self._running)
        elif name == "TASKS_COUNT":
            if self._running and self.values["MODE"] in _MODES_COUNTER:
                self._count = (self._count + 1) & self._mask
                for channel in range(CHANNELS):
                    if self.values[f"CC[{channel}]"] == self._count:
                        self._compare(channel)
        else:
            channel = int(name[-2])
            self.values[f"CC[{channel}]"] = self._counter()
            self._schedule(channel)


LFCLK_HZ: Final = 32_768
DOG: Final = 1 << 1
_RELOAD: Final = 0x6E524635
_CONFIG_SLEEP_RUN: Final = 1
_CRV_MIN: Final = 0xF
_POF_LEAST, _POF_LEAST_V = 4, 1.7
HFXO_START_CYCLES: Final = 360 * CYCLES_PER_US
"""Start of the 32 MHz crystal, typical value of the product specification (t_START_HFXO)."""
_XTAL, _RUNNING = 1, 1 << 16
RNG_BYTE_CYCLES: Final = 120 * CYCLES_PER_US
"""One byte with bias correction, typical value of the product specification (t_RNG,BC)."""
_DERCEN: Final = 1


class Power(Peripheral):
    """The reset reasons, and the comparator that warns of a falling supply.

    Reasons accumulate over all resets except power-on; writing a one clears one. The comparator warns when
    the supply falls below its threshold, or is below it when the comparator is switched on. A rising supply
    gives no event.
    """

    name, base = "POWER", 0x4000_0000
    REGISTERS = [
        *registers("w", TASKS_LOWPWR=0x07C),
        *registers("rw", EVENTS_POFWARN=0x108, INTENSET=0x304, RESETREAS=0x400, POFCON=0x510),
    ]
    INTERRUPT_EVENTS = {2: "EVENTS_POFWARN"}

    supply_v = 3.0  # of Nordic's kit; ``set_supply`` changes it
    constant_latency = False  # the mode that costs current asleep; a reset leaves the other
    crystal_works = True  # whether the board's 32 MHz crystal ever starts
    _is_below = False

    def __init__(self, system: System) -> None:
        super().__init__(system)
        self.input_v = [0.0] * 8  # at the analogue inputs AIN0 to AIN7

    def reset(self) -> None:
        """A reset of the chip: the comparator is off, the reasons stay, and so does the supply."""
        self.values |= {"EVENTS_POFWARN": 0, "POFCON": 0, "INTEN": 0}
        self._is_below = self.constant_latency = False

    def set_supply(self, supply_v: float) -> None:
        """Change the supply, V; the comparator sees it at once."""
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
        self.constant_latency = False

    def on_clear_task(self, channel: int) -> None:
        """Erratum 156: a CLR task of GPIOTE switches the mode as well, even ones this way, odd ones that."""
        self.constant_latency = channel % 2 == 0

    def on_write(self, name: str, value: int) -> None:
        if name == "RESETREAS":
            self.values[name] &= ~value
            return
        self.allow(name, value >> 1, range(_POF_LEAST, 16))
        self.values[name] = value
        self._compare()


class Watchdog(Peripheral):
    """A countdown of the 32,768 Hz clock that resets the chip, unless the one request register reloads it."""

    name, base = "WDT", 0x4001_0000
    REGISTERS = [
        *registers("w", TASKS_START=0x000),
        *registers("rw", CRV=0x504, RREN=0x508, CONFIG=0x50C),
        *array("w", "RR[{}]", 0x600, 8),
    ]
    RESET_VALUES = {"CRV": 0xFFFF_FFFF, "RREN": 1, "CONFIG": 1}
    # If it were paused in sleep, it would not reset a robot that never wakes.
    KNOWN = {"CRV": range(_CRV_MIN, 1 << 32), "RREN": (1,), "CONFIG": (_CONFIG_SLEEP_RUN,)}

    def __init__(self, system: System, on_timeout: Callable[[], None]) -> None:
        super().__init__(system)
        self._running = False
        self.started_cycle = NEVER
        self._due = NEVER
        self._timeout = system.scheduler.add(on_timeout)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Meanwhile it is paused, as under a debugger, because a caller from outside does not feed it."""
        left = self._due - self.system.now_cycle
        self.system.scheduler.at(self._timeout, NEVER)
        try:
            yield
        finally:
            if self._running:
                self._due = self.system.now_cycle + left
                self.system.scheduler.at(self._timeout, self._due)

    def _reload(self) -> None:
        cycles = (self.values["CRV"] + 1) * CYCLES_PER_S // LFCLK_HZ
        self._due = self.system.now_cycle + cycles
        self.system.scheduler.at(self._timeout, self._due)

    def on_task(self, name: str) -> None:
        if not self._running:
            self._running = True
            self.started_cycle = self.system.now_cycle
            self._reload()

    def on_write(self, name: str, value: int) -> None:
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
        super().on_write(name, value)


class Clock(Peripheral):
    """The 32 MHz crystal: its start, its end, and the timers that count by it."""

    name, base = "CLOCK", 0x4000_0000
    REGISTERS = [
        *registers("w", TASKS_HFCLKSTART=0x000),
        *registers("rw", EVENTS_HFCLKSTARTED=0x100, ERRATUM_31=0x53C, ERRATUM_108=0xEE4),
        *registers("r", HFCLKSTAT=0x40C),
    ]
    RESET_VALUES = {"HFCLKSTAT": _RUNNING}

    def __init__(self, system: System, power: Power, timers: Sequence[Timer]) -> None:
        super().__init__(system)
        self._power = power
        power.constant_latency = False
        self._timers = timers
        self._started = system.scheduler.add(self._run)

    def _switch(self, crystal: bool) -> None:
        self.values["HFCLKSTAT"] = _RUNNING | (_XTAL if crystal else 0)
        for timer in self._timers:
            timer.count_by(100 if crystal else HFINT_PERCENT)

    def _run(self) -> None:
        self._switch(True)
        self.raise_event("EVENTS_HFCLKSTARTED")

    def break_down(self) -> None:
        """Stop the crystal for good."""
        self._power.crystal_works = False
        self.system.scheduler.at(self._started, NEVER)
        self._switch(False)

    def on_task(self, name: str) -> None:
        if self._power.crystal_works:
            self.system.scheduler.at(self._started, self.system.now_cycle + HFXO_START_CYCLES)


class Ficr(Peripheral):
    """The factory's data: two unnamed words, which the start-up code copies after a reset.

    They are arbitrary here, and include bits that the start-up code must not copy.
    """

    name, base = "FICR", 0x1000_0000
    REGISTERS = registers("r", ERRATUM_31=0x244, ERRATUM_108=0x258)
    RESET_VALUES = {"ERRATUM_31": 0x1234_BFFF, "ERRATUM_108": 0xFFFF_FFCA}


class Rng(Peripheral):
    """Noise that is the same for every chip, so that the same firmware and calls give the same bytes."""

    name, base = "RNG", 0x4000_D000
    REGISTERS = [
        *registers("w", TASKS_START=0x000, TASKS_STOP=0x004),
        *registers("rw", EVENTS_VALRDY=0x100, CONFIG=0x504),
        *registers("r", VALUE=0x508),
    ]
    KNOWN = {"CONFIG": (_DERCEN,)}  # the firmware needs bytes without bias

    def __init__(self, system: System) -> None:
        super().__init__(system)
        self._noise = random.Random(self.name)
        self._next = system.scheduler.add(self._make)

    def on_task(self, name: str) -> None:
        if name == "TASKS_START" and not self.values["CONFIG"] & _DERCEN:
            raise self.refuse(name, 1, "the bytes would be biased: set CONFIG.DERCEN first")
        at = self.system.now_cycle + RNG_BYTE_CYCLES if name == "TASKS_START" else NEVER
        self.system.scheduler.at(self._next, at)

    def _make(self) -> None:
        self.values["VALUE"] = self._noise.getrandbits(8)
        self.system.scheduler.at(self._next, self.system.now_cycle + RNG_BYTE_CYCLES)
        self.raise_event("EVENTS_VALRDY")
