"""Whole loops on a Cortex-M4 that is not ours: QEMU's core, ARM gcc's code, the native core's every byte."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from tests.codegen import made_up
from tests.conftest import count
from tests.extra.test_qemu import BOARD, COMPILERS, boot
from tests.extra.tools import chip_compiler, emitted_firmware, program

from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.pool.native_robot import COLD_LIMBS, CoreCall
from frogkick.robot import load_robot
from frogkick.runs.parity_scenario import ParityScenario, call_mismatches, record_scenario
from frogkick.tables.image import open_image
from frogkick_codegen import firmware
from frogkick_codegen.emit import SOURCES
from frogkick_codegen.toolchain import FLAGS, firmware_sources

pytestmark = pytest.mark.extra

SEED = 11
PORT = Path(firmware.__file__).parent / "templates" / "native_port.c"


def calls_header(loop: ParityScenario) -> str:
    """Return calls.h: the turns' times and frames."""
    offsets, frames = [], b""
    for call in loop.calls:
        offsets.append(len(frames))
        frames += call.frame

    def values(name: str, kind: str, numbers: list[int]) -> str:
        return f"static const {kind} {name}[{len(numbers)}u] = {{{', '.join(map(str, numbers))}}};\n"

    *on_us, crc = struct.unpack("<9I", COLD_LIMBS)
    return (
        "/* Made by tests/extra/test_qemu_loop.py. Do not edit. */\n#include <stdint.h>\n"
        f"#define FK_CALLS {len(loop.calls)}u\n"
        f"#define FK_COLD_LIMBS {{{', '.join(f'{each}u' for each in on_us)}}}, {crc}u\n"
        + values("fk_call_times_us", "uint64_t", [call.now_us for call in loop.calls])
        + values("fk_call_offsets", "uint32_t", offsets)
        + values("fk_call_lengths", "uint32_t", [len(call.frame) for call in loop.calls])
        + values("fk_call_frames", "uint8_t", list(frames))
    )


def lived(lines: list[str], loop: ParityScenario) -> list[CoreCall]:
    """Turn the UART's lines into calls."""
    assert lines[-1:] == ["done"], lines[-3:]
    found = []
    for call, line in zip(loop.calls, lines[:-1], strict=True):
        words = [int(word, 16) for word in line.split()]
        mask, all_off, pulse_us, low, high = words[:5]
        stream, rest = b"", words[5:]
        while rest[0]:
            length, count_words = rest[0], (rest[0] + 3) // 4
            stream += b"".join(word.to_bytes(4, "little") for word in rest[1 : 1 + count_words])[:length]
            rest = rest[1 + count_words :]
        found.append(CoreCall(call.now_us, call.frame, (mask, all_off, pulse_us, high << 32 | low), stream))
    return found


@pytest.mark.parametrize("kind", made_up.KINDS)
@pytest.mark.parametrize("name", COMPILERS)
def test_qemu_lives_through_the_same_loop(name: str, kind: str, tmp_path: Path) -> None:
    program("qemu-system-arm", "qemu-system-arm")
    driver, libraries = chip_compiler(name)
    image, robot = made_up.image(kind), load_robot("frog2022")
    file = tmp_path / "t.fkt"
    file.write_bytes(image)
    native = firmware.build("native", file, robot, tmp_path / "native").image
    config = PlanConfig(depth=2)
    loop = record_scenario(native, open_image(image), shape("ellipse"), config, count(100, 1000), SEED)
    emitted, settings = emitted_firmware(image, tmp_path)
    (tmp_path / "calls.h").write_text(calls_header(loop))
    core = firmware_sources() / "core"
    elf = tmp_path / "loop.elf"
    driver.run(
        [
            *FLAGS, "-ffreestanding", "-nostdlib", f"-I{tmp_path}", f"-I{emitted}", f"-I{settings}",
            f"-I{core}", f"-I{BOARD}", f"-Wl,-T,{BOARD / 'board.ld'}", "-Wl,--entry=fk_reset",
            BOARD / "startup.c", BOARD / "loop_main.c", BOARD / "memory.c", PORT, *sorted(core.glob("*.c")),
            *(emitted / source for source in SOURCES), *libraries, "-o", elf,
        ]
    )  # fmt: skip
    code, lines = boot(elf)
    assert code == 0, lines[-3:]
    assert call_mismatches(loop, lived(lines, loop)) == []
    assert sum(len(call.stream) for call in loop.calls) > 10_000
