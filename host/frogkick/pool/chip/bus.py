"""Virtual time, and the common part of peripherals: registers, tasks, events, interrupt lines."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import ClassVar, Final, Protocol

from frogkick.core.errors import FrogkickError

CYCLES_PER_US: Final = 64
NEVER: Final = 2**62
RAM_BASE: Final = 0x2000_0000
RAM_BYTES: Final = 64 * 1024
FLASH_BYTES: Final = 512 * 1024


class ChipError(FrogkickError):
    """The firmware did what the chip cannot do, or what this model of it does not know.

    The text names what was done, the register or address, and the program counter.
    """


class Scheduler:
    """Schedules at most one future event of each source.

    Events at the same cycle are handled in the order in which their sources were added.
    """

    def __init__(self) -> None:
        """Start without sources."""
        self._at: list[int] = []
        self._callbacks: list[Callable[[], None]] = []
        self.next_cycle = NEVER

    def add(self, callback: Callable[[], None]) -> int:
        """Add a source with the callback of its events; return its number."""
        self._at.append(NEVER)
        self._callbacks.append(callback)
        return len(self._at) - 1

    def clear(self) -> None:
        """Remove all sources."""
        self._at, self._callbacks, self.next_cycle = [], [], NEVER

    def at(self, source: int, cycle: int) -> None:
        """Set the source's next event; ``NEVER`` removes it."""
        self._at[source] = cycle
        self.next_cycle = min(self._at)

    def take(self) -> Callable[[], None]:
        """Remove the earliest event and return its callback."""
        source = self._at.index(self.next_cycle)
        self.at(source, NEVER)
        return self._callbacks[source]


@dataclass(frozen=True)
class Register:
    """A modelled register: name as in the SVD, offset in the peripheral, r, w or rw."""

    name: str
    offset: int
    access: str


def array(name: str, offset: int, access: str, count: int, stride: int = 4) -> list[Register]:
    """Registers ``name.format(i)`` for i below count."""
    return [Register(name.format(i), offset + stride * i, access) for i in range(count)]


class System(Protocol):
    """The chip as a peripheral uses it."""

    scheduler: Scheduler

    @property
    def now_cycle(self) -> int:
        """Current time in cycles of 64 MHz."""

    def publish(self, event_address: int) -> None:
        """Pass an event to PPI."""

    def trigger(self, task_address: int) -> None:
        """Trigger a task by its register's address."""

    def is_event(self, address: int) -> bool:
        """Whether a modelled event register is at this address."""

    def is_task(self, address: int) -> bool:
        """Whether a modelled task register is at this address."""

    def set_interrupt_line(self, irq: int, level: bool) -> None:
        """Set a peripheral's interrupt line to the NVIC."""

    def ram_read(self, address: int, count: int) -> bytes:
        """Read RAM by EasyDMA."""

    def ram_write(self, address: int, data: bytes) -> None:
        """Write RAM by EasyDMA."""

    def fail(self, what: str) -> ChipError:
        """An error with program counter and time."""


class Peripheral:
    """A block of registers. A subclass lists them and implements writes and tasks.

    Registers with names from TASKS_ and EVENTS_ behave as in the product specification's chapter "Peripheral
    interface"; INTENSET and INTENCLR act on ``INTERRUPT_EVENTS``.
    """

    NAME: ClassVar[str]
    REGISTERS: ClassVar[list[Register]]
    INTERRUPT_EVENTS: ClassVar[dict[int, str]] = {}

    def __init__(self, system: System, name: str, base: int) -> None:
        """Place the peripheral.

        Args:
            system: the chip.
            name: instance, as in the SVD ("TIMER0").
            base: address of its first register.
        """
        self.system = system
        self.name = name
        self.base = base
        self.irq = base >> 12 & 0x1F
        self.by_offset = {register.offset: register for register in self.REGISTERS}
        self.values: dict[str, int] = {register.name: 0 for register in self.REGISTERS}
        self._offsets = {register.name: register.offset for register in self.REGISTERS}
        self._interrupts = 0

    def _register(self, offset: int, access: str) -> Register:
        register = self.by_offset.get(offset)
        verb = "read" if access == "r" else "write"
        if register is None:
            raise self.system.fail(
                f"{verb} of {self.name} + 0x{offset:03x} (0x{self.base + offset:08x}): "
                "no register there that the model knows"
            )
        if access not in register.access:
            raise self.system.fail(
                f"{verb} of {self.name}.{register.name} (0x{self.base + offset:08x}): "
                f"it cannot be {'read' if access == 'r' else 'written'}"
            )
        return register

    def read(self, offset: int) -> int:
        """Read a register; ChipError for one that is unknown or cannot be read."""
        name = self._register(offset, "r").name
        if name in ("INTENSET", "INTENCLR"):
            return self._interrupts
        return self.on_read(name)

    def write(self, offset: int, value: int) -> None:
        """Write a register; ChipError for one that is unknown or cannot be written, or an unknown value."""
        name = self._register(offset, "w").name
        if name.startswith("TASKS_"):
            if value != 1:
                raise self.refuse(name, value, "a task is triggered by 1")
            self.on_task(name)
        elif name.startswith("EVENTS_"):
            if value != 0:
                raise self.refuse(name, value, "an event is taken back by 0")
            self.values[name] = 0
            self._update_line()
        elif name in ("INTENSET", "INTENCLR"):
            unknown = value & ~sum(1 << bit for bit in self.INTERRUPT_EVENTS)
            if unknown:
                raise self.refuse(name, value, f"bits 0x{unknown:x} are not modelled")
            self._interrupts = self._interrupts | value if name == "INTENSET" else self._interrupts & ~value
            self._update_line()
        else:
            self.on_write(name, value)

    def on_read(self, name: str) -> int:
        """Read a plain register."""
        return self.values[name]

    def on_write(self, name: str, value: int) -> None:
        """Write a plain register."""
        self.values[name] = value

    def on_task(self, name: str) -> None:
        """Execute a task."""
        raise self.refuse(name, 1, "the model does not know this task")

    def allow(self, name: str, value: int, known: Iterable[int]) -> None:
        """Raise ChipError for a value outside ``known``."""
        if value not in known:
            raise self.refuse(name, value, "the model does not know this value")

    def refuse(self, name: str, value: int, why: str) -> ChipError:
        """The error of a write that is not modelled."""
        return self.system.fail(f"write of 0x{value:x} to {self.name}.{name}: {why}")

    def raise_event(self, name: str) -> None:
        """Set an event's register, and trigger PPI and the interrupt line."""
        self.values[name] = 1
        self._update_line()
        self.system.publish(self.base + self._offsets[name])

    def _update_line(self) -> None:
        level = any(
            self._interrupts >> bit & 1 and self.values[event] for bit, event in self.INTERRUPT_EVENTS.items()
        )
        self.system.set_interrupt_line(self.irq, level)
