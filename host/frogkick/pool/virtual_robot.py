"""The bench firmware on the virtual chip as a ``RobotPort``."""

from __future__ import annotations

from pathlib import Path

from frogkick.core.errors import InputError
from frogkick.link.frames import FrameCollector
from frogkick.link.wire import Edge
from frogkick.pool.chip import VirtualChip
from frogkick.pool.native_robot import COLD_LIMBS, SimulatedPort

# firmware/bench/board.h; a test holds the two together.
LIMB_PINS = (22, 23, 24, 25, 28, 29, 30, 31)


class VirtualRobot(SimulatedPort):
    """A port with real firmware, UARTE frames, and limbs seen at the pins of ``chip``."""

    def __init__(
        self,
        elf: Path,
        limbs: int,
        flash: bytes | None = None,
        heat_known: bool = True,
        learned: bytes = b"",
    ) -> None:
        """Power the chip on with an image of the target "bench".

        ``flash`` is the content of such a robot's flash when it was switched off; None: that of the image.
        For ``heat_known`` and ``learned`` see ``NativeRobot``.
        """
        if limbs > len(LIMB_PINS):
            raise InputError(
                f"the robot has {limbs} limbs, the bench board {len(LIMB_PINS)} pins: use --robot pool"
            )
        self.chip = VirtualChip(elf, flash=flash)
        if heat_known:
            self.chip.ram_write(self.chip.symbol("persistent"), COLD_LIMBS)
        self.chip.ram_write(self.chip.symbol("learned"), learned)
        self._limb_of_pin = {pin: limb for limb, pin in enumerate(LIMB_PINS[:limbs])}
        self._collector = FrameCollector()

    def send(self, encoded: bytes, at_s: float) -> None:
        # The chip may be a part of an instruction ahead of its target time.
        self.chip.send(encoded, max(at_s * 1e6, self.chip.time_us))

    def advance(self, until_s: float) -> None:
        self.chip.run_until(until_s * 1e6)

    def received(self) -> list[tuple[float, bytes]]:
        return [(time_us * 1e-6, data) for time_us, data in self.chip.received()]

    def flash_content(self) -> bytes:
        return self.chip.flash.content()

    def edges(self) -> list[Edge]:
        return [
            Edge(time_us * 1e-6, self._limb_of_pin[pin], level)
            for time_us, pin, level in self.chip.pin_edges()
            if pin in self._limb_of_pin
        ]
