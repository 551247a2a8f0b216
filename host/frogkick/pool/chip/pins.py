"""What happens at the pins: P0, GPIOTE, the PPI that drives it, and the converter (SAADC)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from frogkick.pool.chip.bus import CYCLES_PER_US, Peripheral, System, array, registers
from frogkick.pool.chip.power import Power

PINS: Final = 32
_GPIOTE_CHANNELS: Final = 8
_MODE_TASK: Final = 3


class Gpio(Peripheral):
    """Port P0. A pin's level is known while it is an output or GPIOTE drives it; else it counts as low."""

    name, base = "P0", 0x5000_0000
    REGISTERS = [*registers("rw", OUTSET=0x508, OUTCLR=0x50C), *array("rw", "PIN_CNF[{}]", 0x700, PINS)]
    PAIR_BITS = (1 << PINS) - 1

    def __init__(self, system: System) -> None:
        super().__init__(system)
        self._task_levels: dict[int, bool] = {}
        self._levels = [False] * PINS
        self.edges: list[tuple[int, int, bool]] = []

    def on_write(self, name: str, value: int) -> None:
        self.values[name] = value
        self.on_pair()

    def on_pair(self) -> None:
        for pin in range(PINS):
            self._update(pin)

    def drive(self, pin: int, level: bool) -> None:
        """GPIOTE takes the pin over, or changes its level."""
        self._task_levels[pin] = level
        self._update(pin)

    def release(self) -> None:
        """A reset: all pins become inputs, which gates see as low."""
        self._task_levels = {}
        self.values = dict.fromkeys(self.values, 0)
        self.on_pair()

    def _update(self, pin: int) -> None:
        is_output = bool(self.values[f"PIN_CNF[{pin}]"] & 1)
        level = self._task_levels.get(pin, is_output and bool(self.values["OUT"] >> pin & 1))
        if level != self._levels[pin]:
            self._levels[pin] = level
            self.edges.append((self.system.now_cycle, pin, level))


class Gpiote(Peripheral):
    """Channels in task mode."""

    name, base = "GPIOTE", 0x4000_6000
    REGISTERS = [
        *array("w", "TASKS_SET[{}]", 0x030, _GPIOTE_CHANNELS),
        *array("w", "TASKS_CLR[{}]", 0x060, _GPIOTE_CHANNELS),
        *array("rw", "CONFIG[{}]", 0x510, _GPIOTE_CHANNELS),
    ]

    def __init__(self, system: System, gpio: Gpio, on_clear: Callable[[int], None]) -> None:
        super().__init__(system)
        self._gpio = gpio
        self._on_clear = on_clear

    def on_write(self, name: str, value: int) -> None:
        if value & 3 != _MODE_TASK:
            raise self.refuse(name, value, "only task mode is modelled")
        self.values[name] = value
        self._gpio.drive(value >> 8 & 0x1F, bool(value >> 20 & 1))

    def on_task(self, name: str) -> None:
        if name.startswith("TASKS_CLR"):
            self._on_clear(int(name[-2]))
        config = self.values[f"CONFIG[{name[-2]}]"]
        if config & 3 == _MODE_TASK:
            self._gpio.drive(config >> 8 & 0x1F, name.startswith("TASKS_SET"))


_PPI_CHANNELS: Final = 20
_PPI_GROUPS: Final = 6


class Ppi(Peripheral):
    """Events trigger tasks without the core: the 20 programmable channels, their forks, groups of them."""

    name, base = "PPI", 0x4001_F000
    REGISTERS = [
        *array("w", "TASKS_CHG[{}].DIS", 0x004, _PPI_GROUPS, 8),
        *registers("rw", CHENSET=0x504, CHENCLR=0x508),
        *array("rw", "CH[{}].EEP", 0x510, _PPI_CHANNELS, 8),
        *array("rw", "CH[{}].TEP", 0x514, _PPI_CHANNELS, 8),
        *array("rw", "CHG[{}]", 0x800, _PPI_GROUPS),
        *array("rw", "FORK[{}].TEP", 0x910, _PPI_CHANNELS),
    ]
    PAIR_BITS = (1 << _PPI_CHANNELS) - 1

    def on_write(self, name: str, value: int) -> None:
        if name.startswith("CHG"):
            self.allow(name, value & ~self.PAIR_BITS, (0,))
        elif not self.system.has_register(value, "EVENTS_" if name.endswith("EEP") else "TASKS_"):
            raise self.refuse(name, value, "no event or task there that the model knows")
        self.values[name] = value

    def on_task(self, name: str) -> None:
        self.values["CHEN"] &= ~self.values[name.removeprefix("TASKS_").removesuffix(".DIS")]

    def pass_on(self, event_address: int) -> None:
        """Trigger the tasks that hang on this event, lowest channel first, a channel's fork after it."""
        enabled = self.values["CHEN"]
        for channel in range(_PPI_CHANNELS):
            if enabled >> channel & 1 and self.values[f"CH[{channel}].EEP"] == event_address:
                self.system.trigger(self.values[f"CH[{channel}].TEP"])
                if fork := self.values[f"FORK[{channel}].TEP"]:
                    self.system.trigger(fork)


_INPUTS: Final = 8
FULL_SCALE_V: Final = 3.6
"""Gain 1/6 of the reference of 0.6 V, the only setting known here."""
_CONVERSION_US: Final = 2
_TACQ_40_US: Final = 5 << 16
_BITS: Final = 12


class Saadc(Peripheral):
    """Voltages at the analogue inputs, converted one after the other into RAM.

    Successive approximation, 12 bits, single-ended, 40 us to settle on each input.
    """

    name, base = "SAADC", 0x4000_7000
    REGISTERS = [
        *registers("w", TASKS_START=0x000, TASKS_SAMPLE=0x004),
        *registers("rw", EVENTS_END=0x104, ENABLE=0x500, RESOLUTION=0x5F0),
        *registers("rw", **{"RESULT.PTR": 0x62C, "RESULT.MAXCNT": 0x630}),
        *array("rw", "CH[{}].PSELP", 0x510, _INPUTS, 16),
        *array("rw", "CH[{}].CONFIG", 0x518, _INPUTS, 16),
    ]
    KNOWN = {
        "RESOLUTION": (2,),
        **{f"CH[{n}].CONFIG": (_TACQ_40_US,) for n in range(_INPUTS)},
        **{f"CH[{n}].PSELP": range(_INPUTS + 1) for n in range(_INPUTS)},
    }

    works = True  # whether conversions ever end

    def __init__(self, system: System, power: Power) -> None:
        super().__init__(system)
        self._power = power
        self._is_started = False
        self._done = system.scheduler.add(self._end)

    def _channels(self) -> list[int]:
        return [self.values[f"CH[{n}].PSELP"] - 1 for n in range(_INPUTS) if self.values[f"CH[{n}].PSELP"]]

    def _end(self) -> None:
        counts = []
        for place in self._channels():
            share = self._power.input_v[place] / FULL_SCALE_V
            counts.append(min(max(round(share * (1 << _BITS)), 0), (1 << _BITS) - 1))
        data = b"".join(count.to_bytes(2, "little") for count in counts)
        self.system.ram_write(self.values["RESULT.PTR"], data)
        self._is_started = False
        self.raise_event("EVENTS_END")

    def on_task(self, name: str) -> None:
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
