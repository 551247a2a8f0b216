"""The cycle model: each kind of instruction, neighbours, wait states, the instruction cache."""

from __future__ import annotations

from pathlib import Path

import pytest
from bare_chip import NO_WAITS, bare
from bench_build import build_text
from tests.conftest import from_ci

from frogkick.pool.chip import ChipError, CostModel, VirtualChip

LOOP = "1: b 1b"
SINGLE = [
    ("nop", 1), ("adds r3, r2, #1", 1), ("mul r3, r2, r2", 1), ("mla r3, r2, r2, r2", 2),
    ("umull r3, r4, r2, r2", 1), ("udiv r3, r2, r2", 12), ("sdiv r3, r2, r2", 12),
    ("ldr r3, [r0]", 2), ("ldr.w r3, [r0, #16]", 2), ("ldrb r3, [r0, r2]", 2), ("ldr r3, [pc, #4]", 3),
    ("str r2, [r0]", 1), ("strh r2, [r0, #4]", 1), ("strb r2, [r0, r2]", 2), ("str r2, [r0, #4]!", 2),
    ("str r2, [r0], #4", 2), ("ldrd r3, r4, [r0]", 3), ("strd r3, r4, [r0]", 3),
    ("ldm r0, {r3, r4, r5}", 4), ("stm r0!, {r3, r4}", 3), ("push {r4, r5, r6, r7}", 5),
    ("vadd.f32 s0, s1, s1", 1), ("vmul.f32 s0, s1, s1", 1), ("vsub.f32 s0, s1, s1", 1),
    ("vdiv.f32 s0, s1, s1", 14), ("vsqrt.f32 s0, s1", 14), ("vmla.f32 s0, s1, s1", 3),
    ("vcmp.f32 s0, s1", 1), ("vmrs apsr_nzcv, fpscr", 1), ("vcvt.f32.s32 s0, s1", 1),
    ("vldr s0, [r0]", 2), ("vstr s1, [r0]", 2), ("vldr d0, [r0]", 3), ("vldm r0, {s0-s3}", 5),
    ("vpush {s16-s19}", 5), ("vmov s0, r2", 2), ("vmov r3, s1", 2), ("vmov s0, s1, r2, r3", 2),
    ("vmov.f32 s0, s1", 1), ("tbb [pc, r1]\n.byte 1\n.byte 1\nnop", 3 + 2 + 1),
    ("cmp r2, #3\nbeq 2f\n2: nop", 3), ("cmp r2, #3\nbeq 2f\nnop\n2: nop", 1 + 1 + 2 + 1),
    ("cmp r2, #4\nbeq 2f\nnop\n2: nop", 4), ("bl 2f\n2: nop", 2), ("b 2f\nnop\n2: nop", 1 + 2 + 1),
    ("cmp r2, #3\nitte eq\naddeq r3, r2, #1\nmoveq r3, r2\nmovne r3, r2", 5),
    ("isb", 4),
]  # fmt: skip
NEIGHBOURS = [
    # Loads and stores behind a load take one cycle less: the manual's own examples.
    ("ldr r3, [r0]\nldr r4, [r0, #4]", 3),
    ("ldr r3, [r0]\nldr r4, [r0, #4]\nldr r5, [r0, #8]", 4),
    ("ldr r3, [r0, r1]\nstr r3, [r0, #20]", 3),
    ("ldr r3, [r0, r1]\nstr r3, [r0, r1]", 3),
    ("str r3, [r0]\nldr r4, [r0]", 3),
    ("ldr r3, [r0]\nnop\nldr r4, [r0]", 5),
    ("ldrd r4, r5, [r0]\nldr r3, [r0]", 5),
    ("ldr r3, [r0]\nvldr s0, [r0]", 4),
    # An address that needs what is before it.
    ("ldr r3, [r0]\nldr r4, [r3]", 4),
    ("add r3, r0, #4\nldr r4, [r3]", 4),
    ("add r3, r0, #4\nldr r4, [r0, r1]", 3),
    ("add r3, r0, #4\nstr r2, [r3]", 3),
    ("add r3, r0, #4\nstr r3, [r0]", 2),
    ("add r3, r0, #4\nvldr s0, [r3]", 4),
    ("sub sp, #8\npush {r4}", 1 + 3),
    # Behind a branch that was taken nothing overlaps.
    ("ldr r3, [r0]\nb 2f\nnop\n2: ldr r4, [r0]", 2 + 1 + 2 + 2),
    # Float results that are needed at once.
    ("vadd.f32 s0, s1, s1\nvmul.f32 s2, s0, s0", 3),
    ("vadd.f32 s0, s1, s1\nvmul.f32 s2, s1, s1", 2),
    ("vadd.f32 s0, s1, s1\nnop\nvmul.f32 s2, s0, s0", 3),
    ("vcvt.s32.f32 s0, s1\nvmov r3, s0", 1 + 3),
    ("vmul.f32 s0, s1, s1\nvcmp.f32 s0, s1", 3),
    ("vmul.f32 s0, s1, s1\nvstr s0, [r0]", 4),
    # Unaligned: in parts.
    ("ldr r3, [r0, #2]", 3), ("ldr r3, [r0, #1]", 4), ("ldrh r3, [r0, #1]", 3), ("ldrh r3, [r0, #2]", 2),
]  # fmt: skip
FAR = [("nop\n" * far + "ldr r3, [r0]\nldr r4, [r0]", far + 3) for far in (3, 61, 62, 63, 64, 65, 66, 130)]
"""Instructions are decoded in runs of 64: a pair costs the same wherever such a run ends."""
MET_BY_A_JUMP = (
    "mov r5, #0\nb 2f\n1: ldr r3, [r0]\n2: ldr r4, [r0]\nadds r5, #1\ncmp r5, #2\nbne 1b",
    1 + (1 + 2) + (2 + 1 + 1 + 1 + 2) + (2 + 1 + 1 + 1 + 1),
)
"""The second of a pair of loads, first reached by a branch, then behind the first one."""
CASES = [*SINGLE, *NEIGHBOURS, *FAR, MET_BY_A_JUMP]
AROUND = 3  # mov r12, lr; nop; bx r12, whose refill lies outside


@pytest.fixture(scope="module")
def chip(tmp_path_factory: pytest.TempPathFactory) -> VirtualChip:
    """Sleeps; each case is a function: r0 points to RAM that holds its own address, r1 is 0, r2 is 3."""
    functions = ""
    for number, (lines, _) in enumerate(CASES):
        text = "\\n".join(["mov r12, lr", "nop", *lines.splitlines(), "bx r12"])
        functions += f'__attribute__((naked, used)) void case_{number}(void) {{ __asm__("{text}"); }}\n'
    calls = "".join(f"void case_{number}(void);\n" for number in range(len(CASES)))
    wake = 'for (;;) { __asm__ volatile("wfe"); }'
    uses = "".join(f'__asm__ volatile("" : : "r"(case_{number}));' for number in range(len(CASES)))
    source = f"int main(void);\n{calls}{functions}int main(void) {{ {uses} {wake} }}\n"
    found = VirtualChip(build_text(source, tmp_path_factory.mktemp("cases"), drivers=True), NO_WAITS)
    found.run_until(2000)
    assert found.sleeping
    return found


@pytest.mark.parametrize(
    "number", range(len(CASES)), ids=[lines.replace("\n", "; ")[:60] for lines, _ in CASES]
)
def test_cycles(chip: VirtualChip, number: int) -> None:
    """The documented model (cost.py), with a refill of 2 and no wait states."""
    place = chip.symbol("fk_bss_end") + 255 & ~255
    chip.ram_write(place, place.to_bytes(4, "little"))
    spent = chip.call(f"case_{number}", place, 0, 3, 0, 0.0, 2.0)[1]
    assert spent - AROUND == CASES[number][1]


def test_cycles_of_a_loop(tmp_path: Path) -> None:
    """100 turns of subs and bne: 1 + 1 each, and a refill of 2 for each of the 99 branches taken."""
    chip = bare(tmp_path, "movs r0, #100\n2: subs r0, #1\nbne 2b\nudf #0", NO_WAITS)
    with pytest.raises(ChipError, match="hard fault"):
        chip.run_until(100)
    assert chip.cycles == 1 + 100 * 2 + 99 * 2 + 1
    assert chip.instructions == 1 + 200 + 1


def test_wait_states_are_added_as_stated(tmp_path: Path) -> None:
    """Two reads of data from flash, 7 instructions: each parameter of the model shows in the sum."""
    code = "movs r0, #0\nldr r1, [r0]\nldr r1, [r0, #4]\nnop\nnop\nnop\nudf #0"
    with_waits = CostModel(branch_refill_cycles=2, fetch_wait_uncached_parts=128, flash_data_wait_cycles=2)
    found = []
    for cost in (NO_WAITS, with_waits):
        chip = bare(tmp_path, code, cost)
        with pytest.raises(ChipError, match="hard fault"):
            chip.run_until(100)
        found.append(chip.cycles)
    assert found == [9, 9 + 7 // 2 + 2 * 2]


CACHE_ON = "movw r0, #0xE540\nmovt r0, #0x4001\nmovs r1, #1\nstr r1, [r0]\n"


def cycles_of(folder: Path, code: str, cost: CostModel) -> int:
    chip = bare(folder, code + "\nudf #0", cost)
    with pytest.raises(ChipError, match="hard fault"):
        chip.run_until(1000)
    return chip.cycles


@from_ci
def test_the_cache_holds_what_fits_and_no_more(tmp_path: Path) -> None:
    """Lines of 16 bytes: a straight run misses each once, a loop in 2 KB not again, a larger one always."""
    free = CostModel(branch_refill_cycles=2, fetch_wait_uncached_parts=0, cache_miss_cycles=0)
    waits = CostModel(branch_refill_cycles=2, fetch_wait_uncached_parts=0, cache_miss_cycles=3)

    def misses(body: str) -> int:
        extra = cycles_of(tmp_path, CACHE_ON + body, waits) - cycles_of(tmp_path, CACHE_ON + body, free)
        assert extra % 3 == 0
        return extra // 3

    around = ".balign 16\nmovs r2, #{turns}\n2: .rept {nops}\nnop\n.endr\nsubs r2, #1\nbne.w 2b"
    once = misses(around.format(turns=1, nops=400))
    assert once == pytest.approx(800 / 16, abs=3)
    assert misses(around.format(turns=20, nops=400)) == once  # 800 bytes stay
    large = misses(around.format(turns=1, nops=2000))
    assert misses(around.format(turns=20, nops=2000)) > 15 * large  # 4000 bytes push each other out


@pytest.mark.parametrize(("place", "reads"), [(0, 1), (2, 2), (1, 3)])
def test_each_part_of_an_unaligned_word_waits(tmp_path: Path, place: int, reads: int) -> None:
    code = f"movs r0, #0\nnop\nldr r1, [r0, #{place}]"
    waits = CostModel(branch_refill_cycles=2, fetch_wait_uncached_parts=0, cache_miss_cycles=0)
    assert cycles_of(tmp_path, code, waits) - cycles_of(tmp_path, code, NO_WAITS) == 2 * reads
