"""SAADC: voltages at the analogue inputs, converted one after the other into RAM."""

from __future__ import annotations

from typing import Final

from frogkick.pool.chip.bus import CYCLES_PER_US, Peripheral, Register, System, array
from frogkick.pool.chip.watchdog import Power

INPUTS: Final = 8
FULL_SCALE_V: Final = 3.6
"""Gain 1/6 of the reference of 0.6 V, the only setting known here."""
_CONVERSION_US: Final = 2
_TACQ_40_US: Final = 5 << 16
_BITS: Final = 12


class Saadc(Peripheral):
    """Successive approximation, 12 bits, single-ended, 40 us to settle on each input.

    Attributes:
        works: whether conversions ever end.
    """

    NAME = "SAADC"
    REGISTERS = [
        Register("TASKS_START", 0x000, "w"),
        Register("TASKS_SAMPLE", 0x004, "w"),
        Register("EVENTS_END", 0x104, "rw"),
        Register("ENABLE", 0x500, "rw"),
        *array("CH[{}].PSELP", 0x510, "rw", INPUTS, 16),
        *array("CH[{}].CONFIG", 0x518, "rw", INPUTS, 16),
        Register("RESOLUTION", 0x5F0, "rw"),
        Register("RESULT.PTR", 0x62C, "rw"),
        Register("RESULT.MAXCNT", 0x630, "rw"),
    ]

    works = True

    def __init__(self, system: System, name: str, base: int, power: Power) -> None:
        """Disabled; ``power`` knows the voltages at the pins, the other arguments as for every peripheral."""
        super().__init__(system, name, base)
        self._power = power
        self._is_started = False
        self._done = system.scheduler.add(self._end)

    def _channels(self) -> list[int]:
        """Inputs of the channels in use, in their order."""
        return [self.values[f"CH[{n}].PSELP"] - 1 for n in range(INPUTS) if self.values[f"CH[{n}].PSELP"]]

    def _end(self) -> None:
        counts = []
        for place in self._channels():
            share = self._power.input_v[place] / FULL_SCALE_V
            counts.append(min(max(round(share * (1 << _BITS)), 0), (1 << _BITS) - 1))
        data = b"".join(count.to_bytes(2, "little") for count in counts)
        self.system.ram_write(self.values["RESULT.PTR"], data)
        self._is_started = False
        self.raise_event("EVENTS_END")

    def on_write(self, name: str, value: int) -> None:
        """Settings that the model has, and no others."""
        if name.endswith(".CONFIG"):
            self.allow(name, value, (_TACQ_40_US,))
        elif name.endswith(".PSELP"):
            self.allow(name, value, range(INPUTS + 1))
        elif name == "RESOLUTION":
            self.allow(name, value, (2,))
        self.values[name] = value

    def on_task(self, name: str) -> None:
        """Take the buffer, or convert every channel once into it."""
        channels = self._channels()
        if not self.values["ENABLE"] or not channels:
            raise self.refuse(name, 1, "it is not enabled, or has no channel")
        if name == "TASKS_START":
            if self.values["RESULT.MAXCNT"] != len(channels):
                raise self.refuse(name, 1, f"the buffer has no room for {len(channels)} results, or more")
            self._is_started = True
        elif not self._is_started:
            raise self.refuse(name, 1, "it has no buffer: START comes first")
        elif self.works:
            us = len(channels) * (40 + _CONVERSION_US)
            self.system.scheduler.at(self._done, self.system.now_cycle + us * CYCLES_PER_US)
