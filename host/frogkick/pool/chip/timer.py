"""TIMER0 to TIMER2: timer and counter, compare, capture, shorts."""

from __future__ import annotations

from functools import partial
from typing import Final

from frogkick.pool.chip.bus import NEVER, Peripheral, System, array, registers

CHANNELS: Final = 4
_BITS: Final = {0: 16, 1: 8, 2: 24, 3: 32}
_BASE_CYCLES: Final = 4  # the timer's 16 MHz clock in cycles of 64 MHz
_MODE_TIMER: Final = 0
_MODES_COUNTER: Final = (1, 2)
HFINT_PERCENT: Final = 108
"""Largest ratio of a time by the internal oscillator to that by the crystal (specification: f_TOL_HFINT)."""


class Timer(Peripheral):
    """A timer with four compare registers.

    It counts by the crystal, or before that runs by the internal oscillator, slower. START begins a full tick
    of the prescaler; CLEAR begins the tick anew. A compare value that equals the counter when it is written
    matches only after the counter has gone all the way round.
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
