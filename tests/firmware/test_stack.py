"""The bound of the stack: exact where it can be counted by hand, refused where there is none."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench_build import BENCH, build, build_text

from frogkick.pool.chip import ChipError, VirtualChip
from frogkick.pool.chip.stack import StackAnalysis

PROGRAM = """#include <stdint.h>
int main(void);
extern volatile uint32_t sink[64];
volatile uint32_t sink[64];
{functions}
int main(void) {{ {body} for (;;) {{ __asm__ volatile("wfe"); }} }}
"""
ASSEMBLY = (
    '__attribute__((naked, noinline, used)) static void {name}(void) {{ __asm__ volatile("{text}"); }}\n'
)


def program(folder: Path, functions: str, body: str) -> Path:
    return build_text(PROGRAM.format(functions=functions, body=body), folder, drivers=True)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("bx lr", 0),
        ("push {r4, lr}\\n pop {r4, pc}", 8),
        ("push {r4-r7, lr}\\n sub sp, #20\\n add sp, #20\\n pop {r4-r7, pc}", 40),
        ("sub.w sp, sp, #1024\\n add.w sp, sp, #1024\\n bx lr", 1024),
        ("subw sp, sp, #516\\n addw sp, sp, #516\\n bx lr", 516),
        ("vpush {d8-d11}\\n vpop {d8-d11}\\n bx lr", 32),
        ("vpush {s16-s18}\\n vpop {s16-s18}\\n bx lr", 12),
        ("str lr, [sp, #-8]!\\n ldr pc, [sp], #8", 8),
        ("stmdb sp!, {r4-r9, lr}\\n ldmia sp!, {r4-r9, pc}", 28),
        # The deeper of two ways counts, and what a condition skips may not have been freed.
        ("cbz r0, 1f\\n sub sp, #64\\n add sp, #64\\n 1: sub sp, #16\\n add sp, #16\\n bx lr", 64),
        (
            "push {r4, lr}\\n cmp r0, #0\\n it eq\\n popeq {r4, pc}\\n push {r5}\\n pop {r5}\\n pop {r4, pc}",
            12,
        ),
        # What ldr r0, [sp, #4] reads is on the stack already.
        ("sub sp, #8\\n ldr r0, [sp, #4]\\n str r0, [sp]\\n add sp, #8\\n bx lr", 8),
    ],
)
def test_a_function_s_own_stack(tmp_path: Path, text: str, wanted: int) -> None:
    elf = program(tmp_path, ASSEMBLY.format(name="probe", text=text), "probe();")
    assert StackAnalysis(elf).bound("probe").total_bytes == wanted


def test_the_deepest_chain_of_calls_is_found_and_named(tmp_path: Path) -> None:
    functions = "".join(
        ASSEMBLY.format(name=name, text=text)
        for name, text in (
            ("deep", "sub sp, #400\\n add sp, #400\\n bx lr"),
            ("flat", "sub sp, #40\\n add sp, #40\\n bx lr"),
            # A call below a small stack, another below a large one, and a jump that leaves the function.
            (
                "middle",
                "push {r4, lr}\\n bl deep\\n sub sp, #96\\n bl flat\\n add sp, #96\\n pop {r4, lr}\\n b deep",
            ),
        )
    )
    bound = StackAnalysis(program(tmp_path, functions, "middle();")).bound("middle")
    assert bound.total_bytes == 8 + 400
    assert bound.chain == (("middle", 8), ("deep", 400))
    assert bound.indirect == ()


@pytest.mark.parametrize(("branch", "entry"), [("tbb [pc, r0]", ".byte"), ("tbh [pc, r0, lsl #1]", ".short")])
def test_a_table_of_jumps_is_followed(tmp_path: Path, branch: str, entry: str) -> None:
    """The deep arm is reached through the table alone."""
    text = (
        f"{branch}\\n 9: {entry} (1f - 9b) / 2\\n {entry} (2f - 9b) / 2\\n {entry} (3f - 9b) / 2\\n"
        f" {entry} 0\\n 1: bx lr\\n 2: sub sp, #200\\n add sp, #200\\n bx lr\\n 3: bx lr"
    )
    elf = program(tmp_path, ASSEMBLY.format(name="many", text=text), "many();")
    assert StackAnalysis(elf).bound("many").total_bytes == 200


def test_a_call_through_a_pointer_takes_the_deepest_function_that_it_may_reach(tmp_path: Path) -> None:
    functions = "".join(
        ASSEMBLY.format(name=name, text=f"sub sp, #{size}\\n add sp, #{size}\\n bx lr")
        for name, size in (("one", 24), ("two", 240))
    )
    functions += """typedef void (*action_t)(void);
        static const action_t actions[2] = {one, two};
        __attribute__((noinline)) static void choose(uint32_t n) { actions[n & 1u](); sink[2] = n; }
    """
    bound = StackAnalysis(program(tmp_path, functions, "choose(sink[1]);")).bound()
    assert bound.chain[-1] == ("two", 240)
    assert bound.indirect == ("choose",) or bound.indirect == ("main",)


@pytest.mark.parametrize(
    ("functions", "body", "words"),
    [
        (
            "__attribute__((noinline)) static uint32_t down(uint32_t n) {"
            " volatile uint32_t keep = n; return n < 2u ? n : down(n - 1u) + down(n - 2u) + keep; }\n",
            "sink[0] = down(sink[1]);",
            "recursion, so no bound of the stack: down",
        ),
        (
            "__attribute__((noinline)) static void any(uint32_t n) {"
            " volatile uint8_t *room = __builtin_alloca(n); room[0] = 1u; sink[0] = room[n - 1u]; }\n",
            "any(sink[1]);",
            "any moves its stack pointer by no constant",
        ),
        (
            ASSEMBLY.format(name="grow", text="1: push {r0}\\n b 1b"),
            "grow();",
            "the stack of grow grows in a loop",
        ),
    ],
)
def test_code_without_a_bound_is_refused(tmp_path: Path, functions: str, body: str, words: str) -> None:
    with pytest.raises(ChipError, match=words):
        StackAnalysis(program(tmp_path, functions, body)).bound()


def test_a_function_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ChipError, match="no function 'nothing'"):
        StackAnalysis(program(tmp_path, "", "sink[0] = 1u;")).bound("nothing")


def test_the_bound_holds_for_what_is_seen(tmp_path: Path) -> None:
    """The paint of a firmware that runs through its deepest chain, and its bound, are the same."""
    elf = build([Path(__file__).with_name("driver_echo.c")], tmp_path / "echo.elf", f"-I{BENCH}")
    chip = VirtualChip(elf)
    chip.send(bytes(range(200)) * 4, 3000)
    chip.run_until(200_000)
    bound = StackAnalysis(elf).bound()
    assert 0 < chip.stack_high_water_bytes() <= bound.total_bytes
    assert bound.chain[0][0] == "fk_reset"
