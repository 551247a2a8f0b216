"""UARTE0 at 115200 baud, 8N1, with EasyDMA."""

from __future__ import annotations

from collections import deque
from enum import Enum, auto
from typing import Final

from frogkick.pool.chip.bus import CYCLES_PER_S, NEVER, RAM_BASE, RAM_BYTES, Peripheral, System, registers

BITS_PER_S: Final = 115_200
_BITS_PER_BYTE: Final = 10
FIFO_BYTES: Final = 4
"""Bytes that the receiver keeps while EasyDMA has no buffer (the specification: up to four after STOPRX)."""
DMA_CYCLES: Final = 16
"""From RXDRDY to the byte in RAM. The specification gives no figure, only that RXDRDY may come first."""
_BAUD_115200: Final = 0x01D60000
_ENABLED: Final = 8
_SHORT_ENDRX_STARTRX: Final = 1 << 5
_ERROR_OVERRUN: Final = 1
_DISCONNECTED: Final = 0xFFFF_FFFF


def bytes_cycles(count: int) -> int:
    """Cycles that ``count`` bytes in a row take on the wire, rounded down."""
    return count * _BITS_PER_BYTE * CYCLES_PER_S // BITS_PER_S


class _Receiver(Enum):
    OFF = auto()  # bytes are lost
    FILLING = auto()
    FULL = auto()  # ENDRX without a new start: the FIFO takes some bytes, then they overrun
    STOPPING = auto()  # after STOPRX, for four byte times


class Uarte(Peripheral):
    """Receiver with a double-buffered pointer, transmitter, both at the wire's pace."""

    name, base = "UARTE0", 0x4000_2000
    REGISTERS = [
        *registers("w", TASKS_STARTRX=0x000, TASKS_STOPRX=0x004, TASKS_STARTTX=0x008),
        *registers("rw", EVENTS_RXDRDY=0x108, EVENTS_ENDRX=0x110, EVENTS_ENDTX=0x120, EVENTS_ERROR=0x124),
        *registers("rw", EVENTS_RXTO=0x144, EVENTS_RXSTARTED=0x14C),
        *registers("rw", SHORTS=0x200, INTENSET=0x304, INTENCLR=0x308),
        *registers("rw", ERRORSRC=0x480, ENABLE=0x500, BAUDRATE=0x524),
        *registers("rw", **{"PSEL.TXD": 0x50C, "PSEL.RXD": 0x514}),
        *registers("rw", **{"RXD.PTR": 0x534, "RXD.MAXCNT": 0x538, "TXD.PTR": 0x544, "TXD.MAXCNT": 0x548}),
        *registers("r", **{"RXD.AMOUNT": 0x53C}),
    ]
    RESET_VALUES = {"PSEL.TXD": _DISCONNECTED, "PSEL.RXD": _DISCONNECTED, "BAUDRATE": 0x04000000}
    INTERRUPT_EVENTS = {
        2: "EVENTS_RXDRDY",
        4: "EVENTS_ENDRX",
        8: "EVENTS_ENDTX",
        9: "EVENTS_ERROR",
        17: "EVENTS_RXTO",
        19: "EVENTS_RXSTARTED",
    }

    def __init__(self, system: System) -> None:
        super().__init__(system)
        self._arriving: deque[tuple[int, int]] = deque()
        self._line_free_cycle = 0
        self._receiver = _Receiver.OFF
        self._fifo: deque[int] = deque()
        self._rx_pointer = self._rx_room = 0
        self.bytes_lost = 0
        self._tx_pointer = self._tx_count = self._tx_done = self._tx_begin = self._tx_byte = 0
        self._transmitting = False
        self.transmitted: list[tuple[int, int]] = []
        scheduler = system.scheduler
        self._dma = scheduler.add(self._move)
        self._arrival = scheduler.add(self._arrive)
        self._stopped = scheduler.add(self._stop_reception)
        self._sent = scheduler.add(self._end_byte)

    # The wire, from outside

    def put_on_wire(self, data: bytes, cycle: int) -> None:
        """Bytes begin to arrive at a cycle, or when those before them are through."""
        begin = max(cycle, self._line_free_cycle)
        for i, byte in enumerate(data):
            self._arriving.append((begin + bytes_cycles(i + 1), byte))
        self._line_free_cycle = begin + bytes_cycles(len(data))
        self._expect()

    def take_wire(self, before: Uarte) -> None:
        """After a reset: bytes on the wire still arrive, and bytes sent before are still reported."""
        self._arriving, self._line_free_cycle = before._arriving, before._line_free_cycle
        self.transmitted, self.bytes_lost = before.transmitted, before.bytes_lost
        self._expect()

    def _expect(self) -> None:
        self.system.scheduler.at(self._arrival, self._arriving[0][0] if self._arriving else NEVER)

    # Receiver

    def _arrive(self) -> None:
        byte = self._arriving.popleft()[1]
        self._expect()
        if self._receiver is _Receiver.OFF:
            self.bytes_lost += 1
        elif len(self._fifo) >= FIFO_BYTES:
            self.bytes_lost += 1
            self.values["ERRORSRC"] |= _ERROR_OVERRUN
            self.raise_event("EVENTS_ERROR")
        else:
            self._fifo.append(byte)
            self.system.scheduler.at(self._dma, self.system.now_cycle + DMA_CYCLES)
            self.raise_event("EVENTS_RXDRDY")

    def _move(self) -> None:
        while self._fifo and self._receiver is _Receiver.FILLING:
            self.system.ram_write(self._rx_pointer, bytes([self._fifo.popleft()]))
            self._rx_pointer += 1
            self._rx_room -= 1
            self.values["RXD.AMOUNT"] += 1
            if self._rx_room == 0:
                self._receiver = _Receiver.FULL
                self._end_reception()

    def _end_reception(self) -> None:
        self.raise_event("EVENTS_ENDRX")
        if self.values["SHORTS"] & _SHORT_ENDRX_STARTRX:
            self._start_reception()

    def _start_reception(self) -> None:
        self._rx_pointer, self._rx_room = self._dma_buffer("STARTRX", "RXD")
        self.values["RXD.AMOUNT"] = 0
        self._receiver = _Receiver.FILLING
        self.system.scheduler.at(self._stopped, NEVER)
        self.raise_event("EVENTS_RXSTARTED")
        if self._fifo:
            self.system.scheduler.at(self._dma, self.system.now_cycle + DMA_CYCLES)

    def _stop_reception(self) -> None:
        if self._receiver is _Receiver.STOPPING:
            self._end_reception()
        if self._receiver is _Receiver.STOPPING:  # no short has started it again
            self._receiver = _Receiver.OFF
            self.raise_event("EVENTS_RXTO")

    # Transmitter

    def _start_transmission(self) -> None:
        self._tx_pointer, self._tx_count = self._dma_buffer("STARTTX", "TXD")
        self._tx_done, self._tx_begin = 0, self.system.now_cycle
        self._transmitting = True
        self._begin_byte()

    def _begin_byte(self) -> None:
        """EasyDMA fetches a byte when its turn comes: a buffer changed too early shows on the wire."""
        self._tx_byte = self.system.ram_read(self._tx_pointer + self._tx_done, 1)[0]
        self.system.scheduler.at(self._sent, self._tx_begin + bytes_cycles(self._tx_done + 1))

    def _end_byte(self) -> None:
        self.transmitted.append((self.system.now_cycle, self._tx_byte))
        self._tx_done += 1
        if self._tx_done < self._tx_count:
            self._begin_byte()
        else:
            self._transmitting = False
            self.raise_event("EVENTS_ENDTX")

    # Registers

    def _dma_buffer(self, task: str, line: str) -> tuple[int, int]:
        """Address and length of the buffer of a direction that a task starts."""
        if self.values["ENABLE"] != _ENABLED:
            raise self.system.fail(f"UARTE0.TASKS_{task} while UARTE0.ENABLE is not 8: enable it first")
        if self.values[f"PSEL.{line}"] >> 31:
            raise self.system.fail(f"UARTE0.TASKS_{task} without a pin in PSEL.{line}: connect it first")
        self.allow("BAUDRATE", self.values["BAUDRATE"], (_BAUD_115200,))
        if line == "TXD" and self._transmitting:
            raise self.system.fail("UARTE0.TASKS_STARTTX while a transmission is under way: wait for ENDTX")
        pointer, count = self.values[f"{line}.PTR"], self.values[f"{line}.MAXCNT"]
        if count == 0:
            raise self.system.fail(
                f"UARTE0.{line}.MAXCNT is 0 at the start of a transfer: set it to 1 to 255"
            )
        if not RAM_BASE <= pointer <= RAM_BASE + RAM_BYTES - count:
            raise self.system.fail(
                f"UARTE0.{line}.PTR 0x{pointer:08x} + {count} bytes is outside RAM, where EasyDMA fails"
            )
        return pointer, count

    def on_write(self, name: str, value: int) -> None:
        if name == "ERRORSRC":
            self.values[name] &= ~value
            return
        if name == "ENABLE":
            self._enable(value)
        elif (name.startswith("PSEL") or name == "BAUDRATE") and self.values["ENABLE"]:
            raise self.refuse(name, value, "UARTE0 is enabled, disable it first")
        elif name == "SHORTS":
            self.allow(name, value, (0, _SHORT_ENDRX_STARTRX))
        elif name.endswith("MAXCNT") and value > 0xFF:
            raise self.refuse(name, value, "MAXCNT has 8 bits, 255 bytes at the most")
        self.values[name] = value

    def _enable(self, value: int) -> None:
        self.allow("ENABLE", value, (0, _ENABLED))
        if value == 0:
            if self._receiver is not _Receiver.OFF:
                raise self.refuse("ENABLE", value, "the receiver runs: STOPRX and wait for RXTO first")
            if self._transmitting:
                raise self.refuse("ENABLE", value, "the transmitter runs: wait for ENDTX first")
            self._fifo.clear()

    def on_task(self, name: str) -> None:
        if name == "TASKS_STARTRX":
            self._start_reception()
        elif name == "TASKS_STARTTX":
            self._start_transmission()
        elif self._receiver in (_Receiver.FILLING, _Receiver.FULL):
            self._receiver = _Receiver.STOPPING
            self.system.scheduler.at(self._stopped, self.system.now_cycle + bytes_cycles(4))
