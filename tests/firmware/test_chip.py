"""The virtual chip: what it refuses, what it counts, and that it does so the same every time."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest
from bare_chip import NO_WAITS, bare
from bench_build import build_text
from tests.conftest import from_ci

from frogkick.core.errors import InputError
from frogkick.pool.chip import ChipError, VirtualChip
from frogkick.pool.chip.bus import Peripheral


def with_main(folder: Path, body: str) -> VirtualChip:
    """A chip that runs this main after our startup code."""
    source = f'#include "nrf52832_regs.h"\nint main(void);\nint main(void) {{ {body} for (;;) {{ }} }}\n'
    return VirtualChip(build_text(source, folder, drivers=True))


# What is refused


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("FK_REGISTER(0x40002000u + 0x2Cu) = 1u;", "write of UARTE0 + 0x02c (0x4000202c)"),
        ("(void)FK_REGISTER(0x40008000u + 0x510u + 4u);", "read of TIMER0 + 0x514"),
        ("(void)UARTE0_TASKS_STARTRX;", "read of UARTE0.TASKS_STARTRX"),
        ("FK_REGISTER(0x4000253Cu) = 1u;", "write of UARTE0.RXD.AMOUNT"),
        ("(void)FK_REGISTER(0x40003000u);", "read of 4 bytes at 0x40003000"),
        ("FK_REGISTER(0xE000E100u) = 1u;", "write of SCS + 0x100"),
        ("FK_REGISTER(0x1000u) = 1u;", "write of 4 bytes to flash at 0x00001000"),
        ("(void)FK_REGISTER(0x20010000u);", "read of 4 bytes at 0x20010000"),
        ("FK_REGISTER(0x1FFFFFFCu) = 1u;", "write of 4 bytes at 0x1ffffffc"),
        ("*(volatile uint8_t *)0x40002500u = 8u;", "access of 1 bytes to UARTE0 + 0x500"),
        ("UARTE0_TASKS_STARTRX = 1u;", "UARTE0.ENABLE is not 8"),
        ("UARTE0_RXD_MAXCNT = 256u;", "UARTE0.RXD.MAXCNT: MAXCNT has 8 bits"),
        ("TIMER_TASKS_START(TIMER0_BASE) = 2u;", "TIMER0.TASKS_START: a task is triggered by 1"),
        ("TIMER_EVENTS_COMPARE(TIMER0_BASE, 0u) = 1u;", "an event is taken back by 0"),
        ("PPI_CH_EEP(0u) = 0x40003100u;", "PPI.CH[0].EEP: no event or task there"),
        ("PPI_CH_TEP(0u) = 0x40002108u;", "PPI.CH[0].TEP: no event or task there"),
        ("GPIOTE_CONFIG(0u) = 1u;", "only task mode is modelled"),
        ("__asm__ volatile(\"wfi\");", "WFI"),
        ("__asm__ volatile(\"udf #0\");", "hard fault"),
        ("((void (*)(void))0x20000101u)();", "execution at 0x20000100"),
    ],
)  # fmt: skip
def test_refuses(tmp_path: Path, body: str, words: str) -> None:
    chip = with_main(tmp_path, body)
    with pytest.raises(ChipError, match=re.escape(words)) as caught:
        chip.run_until(10_000)
    assert re.search(r"pc 0x[0-9a-f]{8} in (main|\?)", str(caught.value))
    with pytest.raises(ChipError):  # it stays stopped
        chip.run_until(20_000)


def test_easydma_cannot_read_flash(tmp_path: Path) -> None:
    body = """
        UARTE0_PSEL_TXD = 6u; UARTE0_BAUDRATE = UARTE0_BAUDRATE_BAUDRATE_Baud115200; UARTE0_ENABLE = 8u;
        UARTE0_TXD_PTR = 0x100u; UARTE0_TXD_MAXCNT = 4u; UARTE0_TASKS_STARTTX = 1u;"""
    with pytest.raises(ChipError, match=r"UARTE0\.TXD\.PTR 0x00000100 \+ 4 bytes is outside RAM"):
        with_main(tmp_path, body).run_until(10_000)


def test_receiver_without_a_new_start_overruns(tmp_path: Path) -> None:
    """Four bytes fit the FIFO after ENDRX, the next raises ERROR with OVERRUN."""
    body = """
        static volatile uint8_t room[4]; static volatile uint32_t source;
        UARTE0_PSEL_RXD = 8u; UARTE0_BAUDRATE = UARTE0_BAUDRATE_BAUDRATE_Baud115200; UARTE0_ENABLE = 8u;
        UARTE0_RXD_PTR = (uint32_t)(uintptr_t)room; UARTE0_RXD_MAXCNT = 4u; UARTE0_TASKS_STARTRX = 1u;
        while (UARTE0_EVENTS_ERROR == 0u) { }
        source = UARTE0_ERRORSRC; (void)source;"""
    chip = with_main(tmp_path, body)
    chip.run_until(1000)
    chip.send(b"01234567", 1010)
    chip.run_until(3000)
    assert chip.uart_bytes_lost == 0
    chip.send(b"89", 3010)
    chip.run_until(4000)
    assert chip.uart_bytes_lost == 2
    assert chip.ram_read(chip.symbol("main.source"), 4) == b"\1\0\0\0"
    assert chip.ram_read(chip.symbol("main.room"), 4) == b"0123"


def test_fpu_must_be_enabled_first(tmp_path: Path) -> None:
    with pytest.raises(ChipError, match=r"SCB\.CPACR does not allow the FPU"):
        bare(tmp_path, "vmov.f32 s0, #1.0\n1: b 1b").run_until(100)


def test_fpu_may_be_used_once_enabled(tmp_path: Path) -> None:
    chip = bare(
        tmp_path,
        """movw r0, #0xED88
        movt r0, #0xE000
        mov r1, #0xF00000
        str r1, [r0]
        vmov.f32 s0, #1.0
        1: b 1b""",
    )
    chip.run_until(100)
    assert chip.instructions > 10


def test_startup_enables_the_fpu(tmp_path: Path) -> None:
    chip = with_main(tmp_path, "volatile float half = 0.5f; half = half * 3.0f; P0_OUTSET = (uint32_t)half;")
    chip.run_until(2000)


@pytest.mark.parametrize("access", ["ldrd r2, r3, [r0, #4]", "ldm r0, {r1, r2}", "stm r0!, {r1, r2}"])
def test_unaligned_access_that_the_core_cannot_do(tmp_path: Path, access: str) -> None:
    with pytest.raises(ChipError, match="unaligned access to 0x2000010"):
        bare(tmp_path, f"movw r0, #0x0102\nmovt r0, #0x2000\n{access}\n1: b 1b").run_until(100)


def test_unaligned_access_that_the_core_can_do(tmp_path: Path) -> None:
    chip = bare(tmp_path, "movw r0, #0x0102\nmovt r0, #0x2000\nldr r1, [r0]\n1: b 1b")
    chip.run_until(100)


@pytest.mark.parametrize("content", [b"not an ELF at all", b"\x7fELF\1\1\1" + bytes(20)])
def test_foreign_or_cut_file(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "x.elf"
    file.write_bytes(content)
    with pytest.raises(InputError):
        VirtualChip(file)


def test_sending_into_the_past(echo_elf: Path) -> None:
    chip = VirtualChip(echo_elf)
    chip.run_until(2000)
    with pytest.raises(ChipError, match="already at"):
        chip.send(b"x", 1000)


def test_ctrl_c_while_a_register_is_read_is_not_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python calls its handler inside the callback, of which unicorn takes neither the error nor a value."""
    chip, real, reads = (
        with_main(tmp_path, "for (;;) { (void)FK_REGISTER(0x40008540u); }"),
        Peripheral.read,
        [],
    )

    def read(self: Peripheral, offset: int) -> int:
        reads.append(offset)
        if len(reads) == 100:
            os.kill(os.getpid(), signal.SIGINT)
        return real(self, offset)

    monkeypatch.setattr(Peripheral, "read", read)
    with pytest.raises(KeyboardInterrupt):
        chip.run_until(10_000)
    assert len(reads) > 100, "it went on to where it can be left"
    chip.run_until(20_000)


# What is counted


def test_time_goes_on_while_asleep(echo_elf: Path) -> None:
    chip = VirtualChip(echo_elf)
    chip.run_until(2000)
    before = chip.instructions
    chip.run_until(60e6)
    assert chip.cycles == 60_000_000 * 64
    assert chip.instructions == before


def test_stack_high_water(tmp_path: Path) -> None:
    """A function with a known array on its stack, once with 1000 and once with 3000 bytes."""
    found = []
    for size in (1000, 3000):
        body = f"volatile uint8_t room[{size}]; for (uint32_t i = 0u; i < {size}u; ++i) {{ room[i] = 1u; }}"
        chip = with_main(tmp_path, body)
        chip.run_until(10_000)
        found.append(chip.stack_high_water_bytes())
    assert 1000 <= found[0] < 1100
    assert found[1] - found[0] == 2000


def test_stack_overflow_faults(tmp_path: Path) -> None:
    body = "volatile uint8_t room[9000]; for (uint32_t i = 9000u; i > 0u; --i) { room[i - 1u] = 1u; }"
    with pytest.raises(ChipError, match="write of 1 bytes at 0x1fffff"):
        with_main(tmp_path, body).run_until(10_000)


def test_data_and_bss_are_set_by_startup_and_nothing_else(tmp_path: Path) -> None:
    source = """#include <stdint.h>
int main(void);
extern volatile uint32_t set; extern volatile uint32_t zero[3];
volatile uint32_t set = 0x12345678u; volatile uint32_t zero[3];
int main(void) { for (;;) { __asm__ volatile("wfe" : : "r"(set), "r"(zero[1])); } }
"""
    chip = VirtualChip(build_text(source, tmp_path, drivers=True))
    chip.run_until(2000)
    assert chip.ram_read(chip.symbol("set"), 4) == bytes.fromhex("78563412")
    assert chip.ram_read(chip.symbol("zero"), 12) == bytes(12)
    assert chip.ram_read(0x2000_FFF0, 4) == b"\xcd" * 4  # RAM after power-on is not zero


# The same every time


def life(chip: VirtualChip, step_us: float) -> tuple[object, ...]:
    """A busy 400 ms, cut up by steps of run_until."""
    chip.send(bytes(range(200)) * 4, 3000)
    chip.send(bytes([0xFE, 1, 5, 0xE8, 3]), 120_000)
    bytes_out: list[tuple[float, bytes]] = []
    edges: list[tuple[float, int, bool]] = []
    time_us = 0.0
    while time_us < 400_000:
        time_us = min(time_us + step_us, 400_000)
        chip.run_until(time_us)
        bytes_out += chip.received()
        edges += chip.pin_edges()
    return chip.cycles, chip.instructions, bytes_out, edges, chip.stack_high_water_bytes()


def test_the_same_twice_and_however_time_is_cut_up(echo_elf: Path) -> None:
    first = life(VirtualChip(echo_elf), 400_000)
    assert len(first[2]) == 803
    assert life(VirtualChip(echo_elf), 400_000) == first
    assert life(VirtualChip(echo_elf), 37.7) == first


def test_conditional_blocks_survive_being_cut_up(tmp_path: Path) -> None:
    """The core is stopped wherever it may be stopped, and IT blocks still work and count right."""
    code = """movs r0, #0
        movs r1, #0
        2: adds r0, #1
        tst r0, #1
        itete eq
        addeq r1, #1
        addne r1, #100
        moveq r3, r1
        addne r1, #0
        cmp r0, #200
        bne 2b
        movw r2, #0x0100
        movt r2, #0x2000
        str r1, [r2]
        1: b 1b"""
    chip = bare(tmp_path, code, NO_WAITS)
    for i in range(1, 6000):
        chip.run_until(i / 64)
    whole = bare(tmp_path, code, NO_WAITS)
    whole.run_until(5999 / 64)
    assert (whole.cycles, whole.instructions) == (chip.cycles, chip.instructions)
    assert chip.ram_read(0x2000_0100, 4) == (100 + 100 * 100).to_bytes(4, "little")


@pytest.mark.parametrize("step_cycles", [1, 7, 100_000])
def test_memory_accesses_inside_conditional_blocks(tmp_path: Path, step_cycles: int) -> None:
    """unicorn 2.1 leaves its IT state set by such an access, and that spoils the code that follows."""
    code = """movw r2, #0x0100
        movt r2, #0x2000
        mov r6, #0x40000000
        add r6, #0x8000
        movs r0, #0
        movs r4, #0
        2: bl 3f
        adds r0, #1
        cmp r0, #50
        bne 2b
        str r4, [r2]
        1: b 1b
        3: push {r5, lr}
        tst r0, #1
        ittte eq
        streq r0, [r6, #0x540]
        ldreq r5, [r6, #0x540]
        addeq r4, r5
        addne r4, #1000
        tst r0, #2
        it eq
        popeq {r5, pc}
        tst r0, #4
        b 4f
        4: pop {r5, pc}"""
    chip = bare(tmp_path, code, NO_WAITS)
    for cycle in range(0, 60 * 64, step_cycles):
        chip.run_until(cycle / 64)
    chip.run_until(100)
    assert chip.ram_read(0x2000_0100, 4) == (sum(range(0, 50, 2)) + 25 * 1000).to_bytes(4, "little")
    whole = bare(tmp_path, code, NO_WAITS)
    whole.run_until(100)
    assert (whole.cycles, whole.instructions) == (chip.cycles, chip.instructions)


@from_ci
def test_without_the_crystal_time_is_the_internal_oscillator_s(tmp_path: Path) -> None:
    """A pulse that nobody guards, by a timer: 8 % longer before the crystal runs, and right afterwards."""
    body = """
        P0_PIN_CNF(22u) = 1u;
        GPIOTE_CONFIG(0u) = (3u << 0) | (22u << 8);
        PPI_CH_EEP(0u) = FK_ADDRESS_OF(TIMER_EVENTS_COMPARE(TIMER2_BASE, 0u));
        PPI_CH_TEP(0u) = FK_ADDRESS_OF(GPIOTE_TASKS_CLR(0u));
        PPI_CH_EEP(1u) = FK_ADDRESS_OF(TIMER_EVENTS_COMPARE(TIMER2_BASE, 1u));
        PPI_CH_TEP(1u) = FK_ADDRESS_OF(GPIOTE_TASKS_SET(0u));
        PPI_CHENSET = 3u;
        TIMER_BITMODE(TIMER2_BASE) = 3u;
        TIMER_CC(TIMER2_BASE, 1u) = 1u;
        TIMER_CC(TIMER2_BASE, 0u) = 100001u;
        TIMER_SHORTS(TIMER2_BASE) = 0x101u;
        for (int once = 0; once < 2; ++once) {
            TIMER_TASKS_START(TIMER2_BASE) = 1u;
            while (TIMER_EVENTS_COMPARE(TIMER2_BASE, 0u) == 0u) { }
            TIMER_EVENTS_COMPARE(TIMER2_BASE, 0u) = 0u;
            CLOCK_TASKS_HFCLKSTART = 1u;
            while (CLOCK_EVENTS_HFCLKSTARTED == 0u) { }
        }"""
    chip = with_main(tmp_path, body)
    chip.run_until(400_000)
    times = [time for time, _, _ in chip.pin_edges()]
    assert [times[1] - times[0], times[3] - times[2]] == pytest.approx([108_000.0, 100_000.0], abs=0.1)
