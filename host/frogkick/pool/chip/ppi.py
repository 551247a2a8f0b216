"""PPI: events trigger tasks without the core."""

from __future__ import annotations

from typing import Final

from frogkick.pool.chip.bus import Peripheral, Register, array

CHANNELS: Final = 20


class Ppi(Peripheral):
    """The 20 programmable channels."""

    NAME = "PPI"
    REGISTERS = [
        Register("CHENSET", 0x504, "rw"),
        *array("CH[{}].EEP", 0x510, "rw", CHANNELS, 8),
        *array("CH[{}].TEP", 0x514, "rw", CHANNELS, 8),
    ]

    def on_write(self, name: str, value: int) -> None:
        """Set a channel's ends, or switch channels on."""
        if name == "CHENSET":
            self.allow(name, value & ~((1 << CHANNELS) - 1), (0,))
            self.values[name] |= value
            return
        known = self.system.is_event(value) if name.endswith("EEP") else self.system.is_task(value)
        if not known:
            raise self.refuse(name, value, "no event or task there that the model knows")
        self.values[name] = value

    def pass_on(self, event_address: int) -> None:
        """Trigger the tasks that hang on this event, lowest channel first."""
        enabled = self.values["CHENSET"]
        for channel in range(CHANNELS):
            if enabled >> channel & 1 and self.values[f"CH[{channel}].EEP"] == event_address:
                self.system.trigger(self.values[f"CH[{channel}].TEP"])
