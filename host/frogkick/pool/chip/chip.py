"""The virtual chip: unicorn for the instructions, this package for time and peripherals.

An operation that is impossible or not modelled raises a ``ChipError``, a file that is no firmware for the
chip an ``InputError``.
"""

from __future__ import annotations

import ctypes
from functools import partial
from pathlib import Path
from typing import Any, Final

from unicorn import arm_const

from frogkick.core.interrupts import ctrl_c_comes_after
from frogkick.pool.chip.bus import (
    CYCLES_PER_US,
    FLASH_BYTES,
    RAM_BYTES,
    ChipError,
    CoreRegisters,
    Peripheral,
    Register,
    Scheduler,
)
from frogkick.pool.chip.cost import PARTS, CostModel, CostTable, Profile
from frogkick.pool.chip.emulator import (
    CACHE_WORDS,
    PAGE,
    RETURN_ADDRESS,
    Flag,
    HookState,
    Stop,
    add_hooks,
    bare_core,
    invalid_access,
    set_arguments,
    unicorn,
)
from frogkick.pool.chip.flash import Flash, Nvmc
from frogkick.pool.chip.image import load_image
from frogkick.pool.chip.pins import Gpio, Gpiote, Ppi, Saadc
from frogkick.pool.chip.power import DOG, Clock, Ficr, Power, Rng, Timer, Watchdog
from frogkick.pool.chip.uarte import Uarte

_NOWHERE: Final = 0xFFFF_FFF0  # emulation ends by the hook, never by reaching an address
_ACCESS: Final = unicorn.UC_HOOK_MEM_READ | unicorn.UC_HOOK_MEM_WRITE
_UNINITIALISED: Final = b"\xcd"  # RAM after power-on: what .data and .bss do not set is not zero
_STACK_PAINT: Final = bytes([0xA5]) * 4
_FAULTS: Final = {
    Stop.WFI: "WFI: no interrupt is ever enabled in the NVIC, it would sleep for ever; use WFE",
    Stop.FPU: "float instruction while SCB.CPACR does not allow the FPU: usage fault (NOCP)",
    Stop.UNALIGNED: "usage fault: unaligned access to {} by one that cannot",
    Stop.NONE: "the emulator stopped for no known reason",
}


class VirtualChip:
    """An nRF52832 from power-on, in virtual time.

    The same firmware and calls give the same cycles, bytes and edges, however ``run_until`` is divided. No
    interrupt is taken; WFE sleeps until an interrupt that is enabled at its peripheral becomes pending. An
    action of the firmware that is not modelled is a ``ChipError``, which stops the chip for good.
    """

    def __init__(
        self, elf_path: Path | str, cost: CostModel | None = None, flash: bytes | None = None
    ) -> None:
        """Load a firmware and hold it at reset, at time 0.

        Args:
            elf_path: ELF linked with firmware/bench/nrf52832.ld.
            cost: cycle model; None: the default.
            flash: ``flash.content()`` of a chip without power; None: the ELF's.
        """
        self._cost = cost or CostModel()
        self._image = load_image(elf_path, flash)
        self.scheduler = Scheduler()
        self._event_cycle: int | None = None
        self._target_cycle = 0
        self.sleeping = False  # whether the core waits for an event
        self._hung = self._reset_due = False
        self._slept_parts = 0
        self._failed: ChipError | None = None
        self._invalid = ""
        self.resets: list[float] = []  # times of the watchdog's resets, us
        self._access_error: ChipError | None = None
        self.power = Power(self)
        self.flash = Flash(self.fail)
        self._place_peripherals([])
        self._table = CostTable(self._image.flash)
        self._state = HookState(
            expected=self._image.reset_address,
            address=self._image.reset_address,
            fetch_wait=self._cost.fetch_wait_uncached_parts,
            miss_wait=self._cost.cache_miss_cycles * PARTS,
            data_wait=self._cost.flash_data_wait_cycles * PARTS,
            refill=self._cost.branch_refill_cycles * PARTS,
            flash_bytes=FLASH_BYTES,
            table=ctypes.cast(self._table.entries, ctypes.c_void_p),
        )
        self._pc = self._image.reset_address
        self._uc = bare_core(self._image.flash, _UNINITIALISED * RAM_BYTES)
        for base in self._by_base:
            self._uc.mmio_map(base, PAGE, self._read, base, self._write, base)
        self._uc.hook_add(unicorn.UC_HOOK_MEM_INVALID, self._on_invalid)
        self._uc.reg_write(arm_const.UC_ARM_REG_SP, self._image.stack_pointer)
        functions = {unicorn.UC_HOOK_CODE: "fk_hook_code", _ACCESS: "fk_hook_memory"}
        add_hooks(self._uc, self._state, functions)
        self.flash.attach(self._uc, self._state, self._refuse)

    def _place_peripherals(self, edges: list[tuple[int, int, bool]]) -> None:
        """Place all peripherals in their reset state, with the edges so far."""
        self._uarte = Uarte(self)
        self._gpio = Gpio(self)
        self._gpio.edges = edges
        self.ppi = Ppi(self)
        self.publish = self.ppi.pass_on
        self.core = CoreRegisters(self, self._switch_fpu)
        self._watchdog = Watchdog(self, partial(setattr, self, "_reset_due", True))
        gpiote = Gpiote(self, self._gpio, self.power.on_clear_task)
        timers = [Timer(self, number) for number in range(3)]
        self.peripherals: tuple[Peripheral, ...] = (
            Clock(self, self.power, timers),
            Ficr(self),
            self.power,
            self._uarte,
            gpiote,
            *timers,
            self._watchdog,
            Rng(self),
            Saadc(self, self.power),
            Nvmc(self, self._switch_cache, self.flash),
            self.ppi,
            self._gpio,
            self.core,
        )
        self._by_base: dict[int, list[Peripheral]] = {}
        for peripheral in self.peripherals:
            self._by_base.setdefault(peripheral.base, []).append(peripheral)

    def _find(self, address: int) -> tuple[Peripheral | None, Register | None]:
        """The peripheral at an address, and its register there; a page may have two peripherals."""
        page, offset = self._by_base.get(address & ~(PAGE - 1), []), address & (PAGE - 1)
        peripheral = next((one for one in page if offset in one.by_offset), page[0] if page else None)
        return peripheral, peripheral.by_offset.get(offset) if peripheral else None

    @property
    def cycles(self) -> int:
        """Cycles of 64 MHz since power-on, asleep or awake."""
        return int(self._state.time) // PARTS

    @property
    def busy_cycles(self) -> int:
        """Cycles spent awake since power-on."""
        return (int(self._state.time) - self._slept_parts) // PARTS

    @property
    def stack_reserved_bytes(self) -> int:
        """RAM that the linker reserves for the stack."""
        return self.symbol("fk_stack_top") - self.symbol("fk_stack_bottom")

    @property
    def time_us(self) -> float:
        """Virtual time since power-on, exact in binary."""
        return self.cycles / CYCLES_PER_US

    @property
    def instructions(self) -> int:
        """Number of executed instructions since power-on."""
        return int(self._state.instructions)

    @property
    def uart_bytes_lost(self) -> int:
        """Bytes on the wire that the receiver lost, by overrun or while it was off."""
        return self._uarte.bytes_lost

    def send(self, data: bytes, at_us: float) -> None:
        """Put bytes on the UART's wire to the chip, at 115200 baud, after those on their way.

        ``at_us``: time of the first start bit, not before ``time_us``.
        """
        cycle = round(at_us * CYCLES_PER_US)
        if cycle < self.cycles:
            raise ChipError(f"cannot send at {at_us} us: the chip is already at {self.time_us} us")
        self._uarte.put_on_wire(data, cycle)

    def received(self) -> list[tuple[float, bytes]]:
        """Bytes from the chip since the last call, each with the time (us) of its stop bit."""
        taken, self._uarte.transmitted = self._uarte.transmitted, []
        return [(cycle / CYCLES_PER_US, bytes([byte])) for cycle, byte in taken]

    def pin_edges(self) -> list[tuple[float, int, bool]]:
        """Edges of port P0's outputs since the last call: time (us), pin, new level. Outputs start low."""
        taken, self._gpio.edges = self._gpio.edges, []
        return [(cycle / CYCLES_PER_US, pin, level) for cycle, pin, level in taken]

    def stack_high_water_bytes(self) -> int:
        """The largest used stack, by the pattern that the startup code writes."""
        bottom, top = self.symbol("fk_stack_bottom"), self.symbol("fk_stack_top")
        stack = self.ram_read(bottom, top - bottom)
        free = next((at for at in range(0, len(stack), 4) if stack[at : at + 4] != _STACK_PAINT), len(stack))
        return top - bottom - free

    def symbol(self, name: str) -> int:
        """Address of a symbol of the firmware; a function has its Thumb bit."""
        if name in self._image.symbols:
            return self._image.symbols[name]
        raise ChipError(f"the firmware has no symbol {name!r}: name one of its variables, unstripped")

    def hang(self, hangs: bool = True) -> None:
        """Stop the core until a reset or ``hang(False)``. Time, peripherals and the watchdog continue."""
        self._hung = hangs

    @ctrl_c_comes_after()  # in a register's callback it would be lost, and the register's value with it
    def run_until(self, time_us: float) -> None:
        """Advance to a virtual time, or beyond it by the rest of an instruction or IT block."""
        if self._failed is not None:
            raise self._failed
        self._target_cycle = round(time_us * CYCLES_PER_US)
        try:
            while self.cycles < self._target_cycle:
                self._handle_events()
                if self._reset_due:
                    self._reset()
                elif not (self.sleeping or self._hung):
                    self._execute()
                elif self.core.event_register and not self._hung:
                    self.core.event_register = self.sleeping = False
                else:
                    awake_at = PARTS * min(self.scheduler.next_cycle, self._target_cycle)
                    if not self._hung:
                        self._slept_parts += max(0, awake_at - int(self._state.time))
                    self._state.time = awake_at
            self._handle_events()
        except ChipError as error:
            self._failed = error
            raise

    @ctrl_c_comes_after()
    def call(self, function: str, *arguments: int | float) -> tuple[int, int]:
        """Let the sleeping chip call a C function of its firmware that returns.

        Args:
            arguments: words, or floats for float parameters, by AAPCS with FPU registers.

        Returns:
            Register r0, and the cycles from the function's first instruction to its return.
        """
        if not self.sleeping:
            raise self.fail(f"cannot call {function}: the chip is awake; let it run until it sleeps")
        entry, context, begun = self.symbol(function) & ~1, self._uc.context_save(), int(self._state.time)
        pc, self._target_cycle = self._pc, 1 << 50
        set_arguments(self._uc, arguments, RETURN_ADDRESS)
        self._table.entries[RETURN_ADDRESS // 2] = Flag.KNOWN | Flag.RETURN
        self._pc = self._state.address = self._state.expected = entry
        self._state.counted = self._state.time
        try:
            with self._watchdog.held():
                while self._pc != RETURN_ADDRESS:
                    self._handle_events()
                    self._execute()
        except ChipError as error:
            self._failed = error
            raise
        result, cycles = self._uc.reg_read(arm_const.UC_ARM_REG_R0), int(self._state.time) - begun
        self._uc.context_restore(context)
        self._pc = self._state.address = self._state.expected = pc
        return int(result), -(-cycles // PARTS)

    def profile(self) -> Profile:
        """Begin to count the cycles of each function; return the counts, which grow."""
        profile = Profile(self._image)
        self._state.profile = ctypes.cast(profile.parts, ctypes.c_void_p)
        self._state.visits = ctypes.cast(profile.visits, ctypes.c_void_p)
        self._state.counted = self._state.time
        return profile

    # Inside

    @property
    def now_cycle(self) -> int:
        """Time of the current hardware event, else of the core."""
        return self.cycles if self._event_cycle is None else self._event_cycle

    def _handle_events(self) -> None:
        while self.scheduler.next_cycle <= self.cycles:
            self._event_cycle = self.scheduler.next_cycle
            self.scheduler.take()()
        self._event_cycle = None

    def _refuse(self, error: ChipError) -> None:
        self._access_error = error
        self._uc.emu_stop()

    def _reset(self) -> None:
        """Reset core and peripherals by the watchdog; RAM, the wire and the reset reasons stay."""
        self.resets.append(self.time_us)
        self._reset_due = self._hung = self.sleeping = False
        self.power.reset()
        self.power.values["RESETREAS"] |= DOG
        self._gpio.release()
        before = self._uarte
        self.scheduler.clear()
        self._place_peripherals(self._gpio.edges)
        self._uarte.take_wire(before)
        self._switch_fpu(False)
        self._switch_cache(False)
        self._uc.reg_write(arm_const.UC_ARM_REG_SP, self._image.stack_pointer)
        self._pc = self._state.address = self._state.expected = self._image.reset_address

    def _set_limit(self) -> None:
        until = 0 if self._reset_due else min(self.scheduler.next_cycle, self._target_cycle)
        self._state.limit = PARTS * until

    def _execute(self) -> None:
        self._set_limit()
        self._state.stop = Stop.NONE
        try:
            self._uc.emu_start(self._pc | 1, _NOWHERE)
        except unicorn.UcError as error:
            raise self._access_error or self.fail(self._invalid or f"hard fault: {error}") from error
        if self._access_error is not None:
            raise self._access_error
        self._pc = self._state.address
        why = Stop(self._state.stop)
        if self._state.late and why is not Stop.UNALIGNED:
            raise self.fail(
                f"the emulator ran {self._state.late} instructions past a stop: its counts are wrong"
            )
        if why is Stop.UNKNOWN:
            self._table.decode_from(self._pc)
        elif why is Stop.WFE:
            self._wait_for_event()
        elif why in _FAULTS:
            raise self.fail(_FAULTS[why].format(f"0x{self._state.unaligned:08x}"))

    def _wait_for_event(self) -> None:
        """WFE: pass if an event has occurred, else sleep."""
        size = 4 if self._image.flash[self._pc + 1] >> 3 >= 0x1D else 2
        self._state.time += PARTS + self._state.fetch_wait
        self._state.instructions += 1
        self._pc += size
        self._state.address = self._state.expected = self._pc
        if self.core.event_register:
            self.core.event_register = False
        else:
            self.sleeping = True

    def _switch_fpu(self, enabled: bool) -> None:
        self._state.fpu_enabled = enabled

    def _switch_cache(self, enabled: bool) -> None:
        self._cache_lines = (ctypes.c_uint32 * CACHE_WORDS)()  # empty
        self._state.cache = ctypes.cast(self._cache_lines, ctypes.c_void_p) if enabled else None
        self._state.line = 0xFFFF_FFFF
        self._state.fetch_wait = 0 if enabled else self._cost.fetch_wait_uncached_parts

    def _read(self, _uc: Any, offset: int, size: int, base: int) -> int:
        return self._access(base, offset, size)

    def _write(self, _uc: Any, offset: int, size: int, value: int, base: int) -> None:
        self._access(base, offset, size, value)

    def _access(self, base: int, offset: int, size: int, value: int | None = None) -> int:
        """Read (value None) or write a register; an error is kept for after the emulator has stopped."""
        if self._access_error is not None:
            return 0
        try:
            peripheral, _ = self._find(base + offset)
            assert peripheral is not None
            if size != 4 or offset % 4:
                raise self.fail(
                    f"access of {size} bytes to {peripheral.name} + 0x{offset:03x}: only aligned words are "
                    "taken"
                )
            self._handle_events()
            result = 0
            if value is None:
                result = peripheral.read(offset)
            else:
                peripheral.write(offset, value & 0xFFFF_FFFF)
            self._set_limit()
            return result
        except ChipError as error:
            self._refuse(error)
            return 0

    def _on_invalid(self, _uc: Any, access: int, address: int, size: int, _value: int, _data: Any) -> bool:
        self._invalid = invalid_access(access, address, size)
        return False

    def fail(self, what: str) -> ChipError:
        """An error with the program counter, its function and the time."""
        pc = self._state.address
        return ChipError(f"{what} (pc 0x{pc:08x} in {self._image.function_at(pc)}, {self.time_us:.3f} us)")

    def trigger(self, task_address: int) -> None:
        peripheral, register = self._find(task_address)
        assert peripheral is not None and register is not None
        peripheral.on_task(register.name)

    def has_register(self, address: int, prefix: str) -> bool:
        _, register = self._find(address)
        return register is not None and register.name.startswith(prefix)

    def ram_read(self, address: int, count: int) -> bytes:
        return bytes(self._uc.mem_read(address, count))

    def ram_write(self, address: int, data: bytes) -> None:
        self._uc.mem_write(address, data)
