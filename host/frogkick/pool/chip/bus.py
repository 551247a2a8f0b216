"""Virtual time, and the common part of peripherals: registers, tasks, events, interrupt lines."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass
from typing import ClassVar, Final, Protocol

from frogkick.core.errors import FrogkickError

CYCLES_PER_US: Final = 64
CYCLES_PER_S: Final = CYCLES_PER_US * 1_000_000
NEVER: Final = 2**62
RAM_BASE: Final = 0x2000_0000
RAM_BYTES: Final = 64 * 1024
FLASH_BYTES: Final = 512 * 1024


class ChipError(FrogkickError):
    """The firmware did something that the chip cannot do, or that this model does not cover.

    The text names the operation, the register or address, and the program counter.
    """


class Scheduler:
    """Schedules at most one future event of each source.

    Events at the same cycle are handled in the order in which their sources were added.
    """

    def __init__(self) -> None:
        self._at: list[int] = []
        self._callbacks: list[Callable[[], None]] = []
        self.next_cycle = NEVER

    def add(self, callback: Callable[[], None]) -> int:
        """Add a source with the callback of its events; return its number."""
        self._at.append(NEVER)
        self._callbacks.append(callback)
        return len(self._at) - 1

    def clear(self) -> None:
        """Remove all sources and their events."""
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


def registers(access: str, /, **offsets: int) -> list[Register]:
    """Registers of one kind of access by name."""
    return [Register(name, offset, access) for name, offset in offsets.items()]


def array(access: str, name: str, offset: int, count: int, stride: int = 4) -> list[Register]:
    """Registers ``name.format(i)`` for i below count."""
    return registers(access, **{name.format(i): offset + stride * i for i in range(count)})


class System(Protocol):
    """The chip as its peripherals use it."""

    scheduler: Scheduler
    core: CoreRegisters

    @property
    def now_cycle(self) -> int: ...  # in cycles of 64 MHz
    def publish(self, event_address: int) -> None: ...  # to PPI
    def trigger(self, task_address: int) -> None: ...
    def has_register(self, address: int, prefix: str) -> bool: ...  # one whose name begins so
    def ram_read(self, address: int, count: int) -> bytes: ...  # by EasyDMA
    def ram_write(self, address: int, data: bytes) -> None: ...
    def fail(self, what: str) -> ChipError: ...  # with program counter and time


_PAIR: Final = ("SET", "CLR")


class Peripheral:
    """A block of registers. A subclass lists them and implements writes and tasks.

    Registers with names from TASKS_ and EVENTS_ behave as in the product specification's chapter "Peripheral
    interface". A pair such as INTENSET and INTENCLR sets and clears the bits of one value ("INTEN").
    """

    REGISTERS: ClassVar[list[Register]]
    INTERRUPT_EVENTS: ClassVar[dict[int, str]] = {}  # bit of INTEN -> the event that it lets through
    RESET_VALUES: ClassVar[dict[str, int]] = {}  # of registers that do not begin with 0
    PAIR_BITS: ClassVar[int]  # that every other pair has
    KNOWN: ClassVar[dict[str, Container[int]]] = {}  # register -> the only values of it that are modelled

    name: str  # instance, as in the SVD ("TIMER0")
    base: int  # address of its first register

    def __init__(self, system: System) -> None:
        """Place it in a chip, in its reset state."""
        self.system = system
        self.irq = self.base >> 12 & 0x1F
        self.by_offset = {register.offset: register for register in self.REGISTERS}
        names = [register.name.removesuffix("SET").removesuffix("CLR") for register in self.REGISTERS]
        self.values: dict[str, int] = dict.fromkeys(names, 0) | self.RESET_VALUES
        self._offsets = {register.name: register.offset for register in self.REGISTERS}

    def _register(self, offset: int, access: str) -> Register:
        register = self.by_offset.get(offset)
        verb, done = ("read", "read") if access == "r" else ("write", "written")
        at = f"0x{self.base + offset:08x}"
        if register is None:
            raise self.system.fail(
                f"{verb} of {self.name} + 0x{offset:03x} ({at}): no register there that the model knows"
            )
        if access not in register.access:
            raise self.system.fail(f"{verb} of {self.name}.{register.name} ({at}): it cannot be {done}")
        return register

    def read(self, offset: int) -> int:
        """Read a register; ChipError for one that is unknown or cannot be read."""
        name = self._register(offset, "r").name
        return self.values[name[:-3]] if name.endswith(_PAIR) else self.on_read(name)

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
        elif name.endswith(_PAIR):
            pair = name[:-3]
            known = sum(1 << bit for bit in self.INTERRUPT_EVENTS) if pair == "INTEN" else self.PAIR_BITS
            if unknown := value & ~known:
                raise self.refuse(name, value, f"bits 0x{unknown:x} are not modelled")
            before = self.values[pair]
            self.values[pair] = before | value if name.endswith("SET") else before & ~value
            self.on_pair()
        else:
            self.on_write(name, value)

    def on_read(self, name: str) -> int:
        return self.values[name]

    def on_write(self, name: str, value: int) -> None:
        self.allow(name, value, self.KNOWN.get(name, (value,)))
        self.values[name] = value

    def on_pair(self) -> None:
        self._update_line()

    def on_task(self, name: str) -> None:
        raise self.refuse(name, 1, "the model does not know this task")

    def allow(self, name: str, value: int, known: Container[int]) -> None:
        """ChipError unless a value of a register is modelled."""
        if value not in known:
            raise self.refuse(name, value, "the model does not know this value")

    def refuse(self, name: str, value: int, why: str) -> ChipError:
        """The error of a write that the chip forbids or the model lacks."""
        return self.system.fail(f"write of 0x{value:x} to {self.name}.{name}: {why}")

    def raise_event(self, name: str) -> None:
        """Set an event's register, and trigger PPI and the interrupt line."""
        self.values[name] = 1
        self._update_line()
        self.system.publish(self.base + self._offsets[name])

    def _update_line(self) -> None:
        enabled = self.values.get("INTEN", 0)
        level = any(enabled >> bit & 1 and self.values[event] for bit, event in self.INTERRUPT_EVENTS.items())
        self.system.core.set_line(self.irq, level)


SEVONPEND: Final = 1 << 4
_CP10_CP11: Final = 0xF << 20


class CoreRegisters(Peripheral):
    """The Cortex-M4's own: NVIC and SCB.

    No interrupt is taken: a pending one can only wake WFE (ARMv7-M ARM, B1.5.18).
    """

    name, base = "SCS", 0xE000_E000
    REGISTERS = registers("rw", NVIC_ICPR0=0x280, NVIC_ICPR1=0x284, SCB_SCR=0xD10, SCB_CPACR=0xD88)
    KNOWN = {"SCB_SCR": (0, SEVONPEND), "SCB_CPACR": (0, _CP10_CP11)}

    def __init__(self, system: System, on_fpu: Callable[[bool], None]) -> None:
        super().__init__(system)
        self._on_fpu = on_fpu
        self._lines = 0
        self._pending = 0
        self.event_register = False

    def set_line(self, irq: int, level: bool) -> None:
        """A peripheral's line changed: pending follows a high line, and stays when it goes low."""
        self._lines = self._lines | 1 << irq if level else self._lines & ~(1 << irq)
        self._pend()

    def _pend(self) -> None:
        new = self._lines & ~self._pending
        self._pending |= self._lines
        if new and self.values["SCB_SCR"] & SEVONPEND:
            self.event_register = True

    def on_read(self, name: str) -> int:
        return self._pending if name == "NVIC_ICPR0" else self.values[name]

    def on_write(self, name: str, value: int) -> None:
        if name == "NVIC_ICPR0":
            self._pending &= ~value
            self._pend()  # a line that is still high makes its interrupt pending again
        elif name != "NVIC_ICPR1":  # there only the FPU's interrupt is ever pending, where its flags stand
            super().on_write(name, value)
            self._on_fpu(self.values["SCB_CPACR"] == _CP10_CP11)
