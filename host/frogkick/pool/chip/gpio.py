"""P0 and GPIOTE: pins as outputs, driven by software or by tasks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from frogkick.pool.chip.bus import Peripheral, Register, System, array

PINS: Final = 32
CHANNELS: Final = 8
_MODE_TASK: Final = 3


class Gpio(Peripheral):
    """Port P0. A pin's level is known while it is an output or GPIOTE drives it; else it counts as low."""

    NAME = "P0"
    REGISTERS = [
        Register("OUTSET", 0x508, "rw"),
        Register("OUTCLR", 0x50C, "rw"),
        *array("PIN_CNF[{}]", 0x700, "rw", PINS),
    ]

    def __init__(self, system: System, name: str, base: int) -> None:
        """Start with all pins as inputs."""
        super().__init__(system, name, base)
        self._out = 0
        self._task_levels: dict[int, bool] = {}
        self._levels = [False] * PINS
        self.edges: list[tuple[int, int, bool]] = []

    def on_read(self, name: str) -> int:
        """Both OUTSET and OUTCLR read as OUT."""
        return self._out if name.startswith("OUT") else self.values[name]

    def on_write(self, name: str, value: int) -> None:
        """Set, clear or configure pins."""
        if name == "OUTSET":
            self._out |= value
        elif name == "OUTCLR":
            self._out &= ~value
        else:
            self.values[name] = value
        for pin in range(PINS):
            self._update(pin)

    def drive(self, pin: int, level: bool) -> None:
        """GPIOTE takes the pin over, or changes its level."""
        self._task_levels[pin] = level
        self._update(pin)

    def release(self) -> None:
        """A reset: all pins become inputs, which gates see as low."""
        self._out = 0
        self._task_levels = {}
        self.values = dict.fromkeys(self.values, 0)
        for pin in range(PINS):
            self._update(pin)

    def _update(self, pin: int) -> None:
        is_output = bool(self.values[f"PIN_CNF[{pin}]"] & 1)
        level = self._task_levels.get(pin, is_output and bool(self._out >> pin & 1))
        if level != self._levels[pin]:
            self._levels[pin] = level
            self.edges.append((self.system.now_cycle, pin, level))


class Gpiote(Peripheral):
    """Channels in task mode."""

    NAME = "GPIOTE"
    REGISTERS = [
        *array("TASKS_SET[{}]", 0x030, "w", CHANNELS),
        *array("TASKS_CLR[{}]", 0x060, "w", CHANNELS),
        *array("CONFIG[{}]", 0x510, "rw", CHANNELS),
    ]

    def __init__(
        self, system: System, name: str, base: int, gpio: Gpio, on_clear: Callable[[int], None]
    ) -> None:
        """Start with all channels off, beside their port; ``on_clear`` hears of each CLR task's channel."""
        super().__init__(system, name, base)
        self._gpio = gpio
        self._on_clear = on_clear

    def on_write(self, name: str, value: int) -> None:
        """Hand a pin to a channel."""
        if value & 3 != _MODE_TASK:
            raise self.refuse(name, value, "only task mode is modelled")
        self.values[name] = value
        self._gpio.drive(value >> 8 & 0x1F, bool(value >> 20 & 1))

    def on_task(self, name: str) -> None:
        """Set or clear the channel's pin; a channel that is off does nothing."""
        if name.startswith("TASKS_CLR"):
            self._on_clear(int(name[-2]))
        config = self.values[f"CONFIG[{name[-2]}]"]
        if config & 3 == _MODE_TASK:
            self._gpio.drive(config >> 8 & 0x1F, name.startswith("TASKS_SET"))
