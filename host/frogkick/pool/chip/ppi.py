"""PPI: events trigger tasks without the core."""

from __future__ import annotations

from typing import Final

from frogkick.pool.chip.bus import Peripheral, Register, System, array

CHANNELS: Final = 20
GROUPS: Final = 6


class Ppi(Peripheral):
    """The 20 programmable channels, their forks, and groups of them."""

    NAME = "PPI"
    REGISTERS = [
        *array("TASKS_CHG[{}].DIS", 0x004, "w", GROUPS, 8),
        Register("CHENSET", 0x504, "rw"),
        Register("CHENCLR", 0x508, "rw"),
        *array("CH[{}].EEP", 0x510, "rw", CHANNELS, 8),
        *array("CH[{}].TEP", 0x514, "rw", CHANNELS, 8),
        *array("CHG[{}]", 0x800, "rw", GROUPS),
        *array("FORK[{}].TEP", 0x910, "rw", CHANNELS),
    ]

    def __init__(self, system: System, name: str, base: int) -> None:
        """Start with all channels off."""
        super().__init__(system, name, base)
        self._enabled = 0

    def on_read(self, name: str) -> int:
        """Both CHENSET and CHENCLR read as CHEN."""
        return self._enabled if name.startswith("CHEN") else self.values[name]

    def on_write(self, name: str, value: int) -> None:
        """Set a channel's ends or a group, or switch channels on or off."""
        if name.startswith(("CHEN", "CHG")):
            self.allow(name, value & ~((1 << CHANNELS) - 1), (0,))
            if name == "CHENSET":
                self._enabled |= value
            elif name == "CHENCLR":
                self._enabled &= ~value
            self.values[name] = value
            return
        known = self.system.is_event(value) if name.endswith("EEP") else self.system.is_task(value)
        if not known:
            raise self.refuse(name, value, "no event or task there that the model knows")
        self.values[name] = value

    def on_task(self, name: str) -> None:
        """Switch a group's channels off."""
        self._enabled &= ~self.values[name.removeprefix("TASKS_").removesuffix(".DIS")]

    def pass_on(self, event_address: int) -> None:
        """Trigger the tasks that hang on this event, lowest channel first, a channel's fork after it."""
        enabled = self._enabled
        for channel in range(CHANNELS):
            if enabled >> channel & 1 and self.values[f"CH[{channel}].EEP"] == event_address:
                self.system.trigger(self.values[f"CH[{channel}].TEP"])
                if fork := self.values[f"FORK[{channel}].TEP"]:
                    self.system.trigger(fork)
