"""The bench's drivers on the virtual chip: bytes through EasyDMA, pulses that end by themselves."""

from __future__ import annotations

import itertools
import random
import shutil
from collections.abc import Iterable
from pathlib import Path

import pytest
from bare_chip import clock_of, power_of
from bench_build import BENCH, DRIVERS, GCC, build
from tests.conftest import count, some

from frogkick.pool.chip import VirtualChip
from frogkick.pool.virtual_robot import LIMB_PINS

BOOT_US = 2000.0
BYTE_US = 1e6 * 10 / 115200
PINS = LIMB_PINS[:4]
ESCAPE = 0xFE
LATE, NO_CRYSTAL = -16, -3


def echoable(count: int, seed: int) -> bytes:
    choose = random.Random(seed)
    return bytes(choose.choice([b for b in range(256) if b != ESCAPE]) for _ in range(count))


def talk(chip: VirtualChip, data: bytes, extra_us: float = 1000.0) -> bytes:
    """Send, wait until the echo must be through, return it."""
    chip.send(data, chip.time_us)
    chip.run_until(chip.time_us + 2 * len(data) * BYTE_US + 255 * BYTE_US + extra_us)
    return b"".join(part for _, part in chip.received())


def pulse_command(kind: int, mask: int, pulse_us: int) -> bytes:
    return bytes([ESCAPE, kind, mask, *(pulse_us // 10).to_bytes(2, "little")])


def signed(answer: bytes) -> int:
    assert answer[:2] == bytes([ESCAPE, 1]), answer
    return int.from_bytes(answer[2:3], "little", signed=True)


@pytest.fixture
def chip(echo_elf: Path) -> VirtualChip:
    booted = VirtualChip(echo_elf)
    booted.run_until(BOOT_US)
    booted.pin_edges()
    return booted


def test_echo_of_all_byte_values(chip: VirtualChip) -> None:
    data = bytes(b for b in range(256) if b != ESCAPE)
    assert talk(chip, data) == data


@pytest.mark.parametrize("count", [1, 2, 254, 255, 256, 509, 510, 511, 1500])
def test_echo_in_one_go_over_the_ends_of_the_buffers(chip: VirtualChip, count: int) -> None:
    data = echoable(count, count)
    assert talk(chip, data) == data
    assert chip.uart_bytes_lost == 0


def test_echo_of_frames_back_to_back_and_apart(chip: VirtualChip) -> None:
    frames = [echoable(3 + 37 * i % 120, i) for i in range(40)]
    for i, frame in enumerate(frames):
        chip.send(frame, chip.time_us + (0.0 if i % 3 else 333.3 * i))
        chip.run_until(chip.time_us + (50.0 * i) % 700)
    chip.run_until(chip.time_us + 1e6)
    assert b"".join(part for _, part in chip.received()) == b"".join(frames)


def test_bytes_leave_at_the_wires_pace(chip: VirtualChip) -> None:
    chip.send(b"frog", chip.time_us)
    chip.run_until(chip.time_us + 2000)
    times = [time for time, _ in chip.received()]
    # The first byte wakes the core and goes out alone; the rest follow later, never faster than the wire.
    assert all(after - before >= BYTE_US - 0.02 for before, after in itertools.pairwise(times))
    assert times[0] - BOOT_US == pytest.approx(2 * BYTE_US, abs=10.0)


def test_unread_bytes_are_kept_for_a_buffer_and_dropped_whole_beyond(chip: VirtualChip) -> None:
    """60 ms asleep: 255 bytes always survive; 600 do not, are counted, and reception goes on after them."""
    kept = echoable(255, 1)
    assert talk(chip, bytes([ESCAPE, 5]) + kept, 60_000) == kept
    assert talk(chip, bytes([ESCAPE, 5]) + echoable(600, 2), 60_000) == b""
    data = echoable(700, 3)
    assert talk(chip, data) == data
    overruns, line_errors = talk(chip, bytes([ESCAPE, 4]))[2:]
    assert (overruns, line_errors) == (1, 0)


def test_unread_bytes_of_an_older_buffer_are_not_garbled(chip: VirtualChip) -> None:
    """The reader stops in the first buffer, the hardware goes on until it fills that one again."""
    begin = chip.time_us
    first, second, third = echoable(100, 1), echoable(200, 2), echoable(250, 3)
    chip.send(bytes([ESCAPE, 5]) + first + bytes([ESCAPE, 5]) + second, begin)
    chip.run_until(begin + 80_000)
    chip.send(third, begin + 80_010)
    chip.run_until(begin + 200_000)
    assert b"".join(part for _, part in chip.received()) == first
    assert talk(chip, bytes([ESCAPE, 4])) == bytes([ESCAPE, 4, 1, 0])
    assert talk(chip, third) == third


@pytest.mark.parametrize("before", some([0, 1, 100, 251, 252, 253, 254], 3))
@pytest.mark.parametrize("unread", [1, 254, 255, 256])
def test_bytes_while_nobody_reads_are_whole_or_dropped_whole(
    chip: VirtualChip, before: int, unread: int
) -> None:
    """Wherever in its buffer the receiver stands: nothing is garbled, and 255 bytes are never lost."""
    first = echoable(before, before + 1)
    assert talk(chip, first) == first
    data = echoable(unread, unread)
    echo = talk(chip, bytes([ESCAPE, 5]) + data, 60_000)
    assert echo == data or (unread > 255 and echo == b"")
    after = echoable(300, 5)
    assert talk(chip, after) == after


@pytest.mark.parametrize("pulse_us", [10, 1000, 70_000, 80_000, 100_000])
@pytest.mark.parametrize("mask", some([0b0001, 0b0110, 0b1111], 1))
@pytest.mark.parametrize("kind", [1, 2], ids=["core lives", "core hangs"])
def test_a_pulse_lasts_its_time_even_where_the_core_hangs(
    chip: VirtualChip, pulse_us: int, mask: int, kind: int
) -> None:
    chip.send(pulse_command(kind, mask, pulse_us), chip.time_us)
    chip.run_until(chip.time_us + pulse_us + 3000)
    edges = chip.pin_edges()
    for limb, pin in enumerate(PINS):
        own = [(time, level) for time, edge_pin, level in edges if edge_pin == pin]
        if mask >> limb & 1:
            assert [level for _, level in own] == [True, False]
            assert own[1][0] - own[0][0] == pytest.approx(pulse_us, abs=1.0)
        else:
            assert own == []


def test_no_pulse_begins_without_the_crystal(echo_elf: Path) -> None:
    """One that never starts does not hold up the firmware; one that stops is seen before each pulse."""
    never = VirtualChip(echo_elf)
    power_of(never).crystal_works = False
    never.run_until(50_000)
    assert never.sleeping, "it waits for ever for a crystal"
    never.pin_edges()
    assert signed(talk(never, pulse_command(1, 0b0110, 1_000))) == NO_CRYSTAL
    assert never.pin_edges() == []
    stops = VirtualChip(echo_elf)
    stops.run_until(BOOT_US)
    stops.pin_edges()
    assert signed(talk(stops, pulse_command(1, 0b0110, 1_000))) == 0
    assert len(stops.pin_edges()) == 4
    clock_of(stops).break_down()
    assert signed(talk(stops, pulse_command(1, 0b0110, 1_000))) == NO_CRYSTAL
    assert stops.pin_edges() == []


STALLS_US = (4.0, 20.0, 150.0, 900.0, 1_500.0, 85_000.0, 2_000_000.0)
"""How long the core stands still: within the start, as long as the pulse, an erased page, a debugger."""


def stalled(chip: VirtualChip, what: str, cases: int) -> list[int]:
    """Results of as many pulses; in each the core stands still once, somewhere from its command on.

    Each gate is high once for the pulse's time, or less where the pulse is taken back ("off"), or never.
    """
    pulse_us, limbs = 1_000, (1, 2)
    command = pulse_command(1, 0b0110, pulse_us)
    arrived_us = chip.time_us + len(command) * BYTE_US
    chip.send(command, chip.time_us)
    chip.run_until(arrived_us + 5_000)
    assert signed(b"".join(part for _, part in chip.received())) == 0
    rises = [time for time, _, level in chip.pin_edges() if level]
    assert len(rises) == 2 and max(rises) - min(rises) < 2.0
    span = round((rises[0] - arrived_us + 15.0) * 64)
    assert 300 < span < 2_000
    every = list(itertools.product(range(span), STALLS_US))
    results = []
    for cycle, stall_us in random.Random(1).sample(every, min(cases, len(every))):
        arrived_us = chip.time_us + len(command) * BYTE_US
        chip.send(command, chip.time_us)
        if what == "off":
            chip.run_until(arrived_us + 400.0)
            arrived_us = chip.time_us + 2 * BYTE_US
            chip.send(bytes([ESCAPE, 3]), chip.time_us)
        chip.run_until(arrived_us + cycle / 64)
        chip.hang()
        chip.run_until(chip.time_us + stall_us)
        chip.hang(False)
        chip.run_until(chip.time_us + pulse_us + 4_000)
        results.append(signed(b"".join(part for _, part in chip.received())))
        assert results[-1] in (0, LATE), (cycle, stall_us)
        edges = chip.pin_edges()
        for limb, pin in enumerate(PINS):
            own = [(time, level) for time, edge_pin, level in edges if edge_pin == pin]
            if limb not in limbs or results[-1] == LATE:
                assert own == [], (cycle, stall_us, own)
                continue
            assert [level for _, level in own] == [True, False], (cycle, stall_us, own)
            on_us = own[1][0] - own[0][0]
            assert on_us <= pulse_us, (cycle, stall_us)
            assert what == "off" or on_us == pytest.approx(pulse_us, abs=0.1), (cycle, stall_us)
    return results


@pytest.mark.parametrize("what", ["start", "off"])
def test_wherever_the_core_stands_still_no_gate_stays_high(chip: VirtualChip, what: str) -> None:
    """At each instruction from the command's arrival until gates are high, or low again."""
    results = stalled(chip, what, count(700, 20_000, 200))
    assert results.count(0) > 0 and (what == "off" or results.count(LATE) > 0)


SOFTWARE = (
    ("    PPI_CHENSET = (uint32_t)limb_mask << FK_PPI_PULSE_BEGIN_FIRST;\n", ""),
    (
        "        if (begin_at(begin_us) != 0) {\n",
        "        if (begin_at(begin_us) != 0) {\n"
        "            GPIOTE_TASKS_SET(1) = 1u;\n            GPIOTE_TASKS_SET(2) = 1u;\n",
    ),
)
STOPPED_FIRST = (
    ("    TIMER_TASKS_STOP(PULSE_TIMER) = 1u;\n", ""),
    (
        "    for (uint32_t limb = 0u; limb < FK_BOARD_LIMBS; ++limb) {\n        GPIOTE_TASKS_CLR",
        "    TIMER_TASKS_STOP(PULSE_TIMER) = 1u;\n"
        "    for (uint32_t limb = 0u; limb < FK_BOARD_LIMBS; ++limb) {\n        GPIOTE_TASKS_CLR",
    ),
)


def chip_with_changed_pulse(tmp_path: Path, changes: Iterable[tuple[str, str]]) -> VirtualChip:
    """Return a booted chip whose pulse.c has other lines, each of which occurs once."""
    text = (BENCH / "pulse.c").read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    (tmp_path / "pulse.c").write_text(text, encoding="utf-8")
    others = [BENCH / name for name in DRIVERS if name != "pulse.c"]
    sources = [Path(__file__).with_name("driver_echo.c"), tmp_path / "pulse.c", *others]
    chip = VirtualChip(build(sources, tmp_path / "echo.elf", drivers=False))
    chip.run_until(BOOT_US)
    chip.pin_edges()
    return chip


@pytest.mark.parametrize(
    ("what", "changes"),
    [("start", SOFTWARE), ("off", STOPPED_FIRST)],
    ids=["gates by software", "the end stopped before gates are low"],
)
def test_a_pulse_that_leans_on_the_core_is_found_out(
    what: str, changes: tuple[tuple[str, str], ...], tmp_path: Path
) -> None:
    chip = chip_with_changed_pulse(tmp_path, changes)
    with pytest.raises(AssertionError):
        stalled(chip, what, 2_000)


BELOW_RAM = '    __asm__ volatile("msr msp, %0" : : "r"(0x1FFFFFF8u));\n'


@pytest.mark.parametrize("before", ["", BELOW_RAM], ids=["stack well", "stack overflowed"])
def test_no_gate_goes_high_after_a_fault(before: str, tmp_path: Path) -> None:
    """Even if the processor faults after it enabled a pulse's start, and before the pulse begins."""
    wait = "    while (fk_time_now_us() < begin_us"
    fault = f"    extern void fk_fault(void);\n{before}    fk_fault();\n"
    chip = chip_with_changed_pulse(tmp_path, [(wait, fault + wait)])
    chip.send(pulse_command(1, 0b0110, 1_000), chip.time_us)
    chip.run_until(chip.time_us + 5_000)
    assert chip.pin_edges() == []


def test_a_second_pulse_while_one_is_on_is_refused(chip: VirtualChip) -> None:
    assert signed(talk(chip, pulse_command(1, 0b0001, 80_000))) == 0
    assert signed(talk(chip, pulse_command(1, 0b0010, 80_000))) == -2
    chip.run_until(chip.time_us + 100_000)
    assert [(pin, level) for _, pin, level in chip.pin_edges()] == [(22, True), (22, False)]
    assert signed(talk(chip, pulse_command(1, 0b0010, 1000))) == 0
    assert [(pin, level) for _, pin, level in chip.pin_edges()] == [(23, True), (23, False)]


@pytest.mark.parametrize("limbs", [1, 6, 8])
def test_a_board_of_other_limbs_drives_exactly_their_pins(limbs: int, tmp_path: Path) -> None:
    source = Path(__file__).with_name("driver_echo.c")
    chip = VirtualChip(build([source], tmp_path / "echo.elf", f"-DFK_BOARD_LIMBS={limbs}u"))
    chip.run_until(BOOT_US)
    chip.pin_edges()
    for limb in range(8):
        assert signed(talk(chip, pulse_command(1, 1 << limb, 1000))) == (0 if limb < limbs else -1)
        chip.run_until(chip.time_us + 2000)
    everybody = 2**limbs - 1
    assert signed(talk(chip, pulse_command(1, everybody, 70_000))) == 0
    chip.run_until(chip.time_us + 100_000)
    edges = chip.pin_edges()
    for limb, pin in enumerate(LIMB_PINS):
        levels = [level for _, edge_pin, level in edges if edge_pin == pin]
        assert levels == ([True, False] * 2 if limb < limbs else [])


@pytest.mark.parametrize(
    ("mask", "pulse_us"), [(0, 1000), (0b10000, 1000), (1, 0), (1, 100_010), (1, 655_350)]
)
def test_a_pulse_out_of_range_is_refused(chip: VirtualChip, mask: int, pulse_us: int) -> None:
    assert signed(talk(chip, pulse_command(1, mask, pulse_us))) == -1
    assert chip.pin_edges() == []


def test_off_ends_a_pulse_at_once_and_frees_the_gates(chip: VirtualChip) -> None:
    talk(chip, pulse_command(1, 0b0011, 80_000))
    before = chip.time_us
    chip.send(bytes([ESCAPE, 3]), before)
    chip.run_until(before + 1000)
    falls = [time for time, _, level in chip.pin_edges() if not level]
    assert len(falls) == 2
    assert all(0 <= time - before - 2 * BYTE_US < 20 for time in falls)
    assert signed(talk(chip, pulse_command(1, 0b0100, 500))) == 0
    assert [level for *_, level in chip.pin_edges()] == [True, False]


def test_sleep_is_found_again_after_everything(chip: VirtualChip) -> None:
    talk(chip, pulse_command(1, 0b0001, 20_000))
    talk(chip, echoable(600, 9))
    chip.run_until(chip.time_us + 100_000)
    before = chip.instructions
    chip.run_until(chip.time_us + 10e6)
    assert chip.instructions == before


def test_the_clock_survives_its_32_bits(echo_elf: Path) -> None:
    """TIMER0 wraps after 71.6 minutes; the firmware still sleeps, wakes and answers after three of them."""
    chip = VirtualChip(echo_elf)
    chip.run_until(3.5 * 2**32)
    assert chip.instructions < 100_000
    data = echoable(300, 4)
    assert talk(chip, data) == data
    assert talk(chip, bytes([ESCAPE, 5]) + data[:20], 65_000) == data[:20]
    high_word = chip.ram_read(chip.symbol("high_word"), 4)
    assert int.from_bytes(high_word, "little") == 3


@pytest.mark.extra
def test_the_other_compiler_takes_it_too(tmp_path: Path) -> None:
    if shutil.which(GCC[0]) is None:
        pytest.skip(f"{GCC[0]} is not installed")
    source = Path(__file__).with_name("driver_echo.c")
    chip = VirtualChip(build([source], tmp_path / "echo.elf", compiler=GCC))
    chip.run_until(BOOT_US)
    data = echoable(300, 7)
    assert talk(chip, data) == data
