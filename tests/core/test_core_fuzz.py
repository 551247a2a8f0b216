"""Frames by the million, and inputs guided by coverage under sanitizers: nothing crashes or acts unasked."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from tests.conftest import LEVEL, count, from_ci, some
from tests.core.core import FFI, cases, image, library, source_files

from frogkick.link.auth import words
from frogkick.link.frames import hello
from frogkick.link.layout import AUTH_BIT, Value, link_layout
from frogkick_codegen.toolchain import other, zig

HERE = Path(__file__).parent
COUNTS = ("good", "bad", "answers", "pulses", "repeats")


def fuzz(files: dict[str, bytes], frames: int, seed: int = 1) -> tuple[str, dict[str, int]]:
    """Play frames to a library of these files: what did not hold, and what was counted."""
    table = image()
    aligned = FFI.new("uint64_t[]", (len(table) + 7) // 8)
    FFI.memmove(aligned, table, len(table))
    reported = FFI.new("uint64_t[5]")
    wrong = library(files).fk_fuzz(FFI.cast("uint8_t *", aligned), len(table), seed, frames, reported)
    return (FFI.string(wrong).decode() if wrong else ""), dict(zip(COUNTS, map(int, reported), strict=True))


def test_a_million_frames() -> None:
    frames = cases(100_000, 10_000_000)
    wrong, reported = fuzz(source_files(), frames)
    print(f"{frames} frames: {reported}")
    assert wrong == ""
    assert reported["good"] + reported["bad"] >= frames
    assert min(reported["good"], reported["bad"]) > 0.2 * frames
    assert reported["answers"] == reported["good"]
    assert reported["pulses"] > 1e-4 * frames and reported["repeats"] > 1e-3 * frames


BROKEN = {
    "no checksum": ("fk_frames.c", "if (crc != fk_get_u32(raw + checked)) {", "if (0) {"),
    "half a checksum": (
        "fk_frames.c", "if (crc != fk_get_u32(raw + checked)) {",
        "if ((crc & 0xFFFFu) != (fk_get_u32(raw + checked) & 0xFFFFu) && frame->sequence != raw[1]) {",
    ),
    "a bad frame is noticed": (
        "fk_link.c", "    fk_frame_t frame;\n", "    fk_frame_t frame;\n    robot->now_us = now_us + 1u;\n",
    ),
    "the delimiter is missed": (
        "fk_frames.c", "    collector->length = 0u;\n",
        "    collector->length = (collector->length > 9u) ? 1u : 0u;\n",
    ),
    "unknown commands are ignored": (
        "fk_link.c", "(frame.type & (FK_ANSWER_BIT | FK_EVENT_BIT)) != 0u)", "frame.type > 0x0bu)",
    ),
    "another number is answered": (
        "fk_link.c", "send(robot, type, frame.sequence, answer, answer_length);",
        "send(robot, type, (uint8_t)(frame.sequence & 0x7fu), answer, answer_length);",
    ),
    "a command without a code is taken": (
        "fk_key_commands.c", "(is_owned && fk_frame_needs_code(frame->type))", "(0)",
    ),
    "any code is taken": (
        "fk_key_commands.c",
        "if (!is_owned || fk_auth_check(&robot->auth, frame, robot->now_us) != FK_STATUS_OK) {",
        "frame->type &= (uint8_t)~FK_AUTH_BIT;\n    if (!is_owned) {",
    ),
    "what a stranger sends keeps it armed": ("fk_link.c", "if (!fk_robot_is_owned(robot)) {", "{"),
    "answers are answered": ("fk_link.c", "(FK_ANSWER_BIT | FK_EVENT_BIT)", "FK_EVENT_BIT"),
    "events are answered": ("fk_link.c", "(FK_ANSWER_BIT | FK_EVENT_BIT)", "FK_ANSWER_BIT"),
}  # fmt: skip


@pytest.mark.parametrize("name", some(BROKEN, 4))
def test_what_is_broken_is_seen_by_the_monitor(name: str) -> None:
    files = source_files()
    file, old, new = BROKEN[name]
    text = files[file].decode()
    assert text.count(old) == 1, f"{file} holds {old!r} {text.count(old)} times: correct the mutation"
    files[file] = text.replace(old, new).encode()
    assert fuzz(files, 100_000)[0] != ""


# Guided by coverage, under sanitizers

NOT_FUZZED = ("shim.c", "play.c", "fuzz_main.c")
# In make test what is found is told with fewer words: compiling for more of them takes most of the time.
WORDS, TOLD = (["-O0"], ["-fsanitize-trap=undefined"]) if LEVEL == "quick" else (["-O1", "-g"], [])
SANITIZED = ("-std=c99", *WORDS, "-fno-omit-frame-pointer", "-fno-sanitize-recover=all")
WAYS = {
    "zig": ("-fsanitize=undefined", *TOLD, "-fsanitize-coverage=trace-pc-guard"),
    "gcc": ("-fsanitize=address,undefined", "-fsanitize-coverage=trace-pc"),
}


def seeds() -> bytes:
    """Inputs to begin with: frames of every command, of which most are what a host sends; and raw bytes."""

    def record(what: int, kind: int, sequence: int, payload: bytes = b"") -> bytes:
        return bytes([what, kind, sequence, len(payload)]) + payload

    def frame(name: str, values: dict[str, Value], rows: bytes = b"") -> bytes:
        message = link_layout().messages[name]
        assert message.command is not None
        given = [values[field.name] for field in message.command.fields]
        return record(0, message.id, 7, struct.pack(message.command.format, *given) + rows)

    points = struct.pack("<6f", 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    path = frame("PATH", {"first": 0, "total": 2, "count": 2}, points)
    fix = frame("FIX", {"fix_sequence": 9, "quality": 1, "capture_age_us": 1000,
                        "x_m": 0.2, "y_m": 0.0, "heading_rad": 0.1})  # fmt: skip
    wait = record(3, 200, 10)
    plan = link_layout().messages["PLAN"]
    assert plan.command is not None
    commands = [
        frame("HELLO", hello()), frame("ARM", {}), path, fix, frame("START", {"delay_us": 0}),
        frame("STATUS", {}), frame("STROKE", {"action": 1}), frame("STOP", {}), frame("DISARM", {}),
        frame("LOG", {"offset": 0}), frame("LOG", {"offset": 2**32 - 1}),
        *(frame("PARAM", {"parameter": number, "value": 1.0}) for number in range(1, 21)),
        record(0, plan.id, 8, bytes([2]) + bytes(plan.command.bytes - 1)),
        frame("CHALLENGE", words("nonce", bytes(16))), frame("KEY", words("key", bytes(32))),
        record(0, AUTH_BIT | link_layout().messages["ARM"].id, 9, bytes(12)),
    ]  # fmt: skip
    session = b"".join(commands[:5]) + wait + fix + wait
    inputs = [bytes([state]) + part for state in range(4) for part in (*commands, session)]
    inputs += [bytes([9]) + part for part in commands]  # of a robot with an owner
    inputs += [bytes([1, *record(what, 2, 3, b"abc")]) for what in (1, 2, 0x21, 0x42)]
    inputs += [b"\x05\x06\x02\x01\x02\x03\x04\x00", b"\x06" + b"\xff" * 300, b"\x04" + bytes(20)]
    # As long as a frame may be, and longer by a byte or two.
    inputs += [
        bytes([1, *record(0, 8, 4, b"\x01" * (link_layout().payload_bytes_max + more))]) for more in range(3)
    ]
    return b"".join(struct.pack("<H", len(one)) + one for one in inputs)


def guided(folder: Path, way: str, files: dict[str, bytes], inputs: int, seed: int = 1) -> str:
    """Build and run the fuzzer; what it said when it failed, or its numbers."""
    driver = zig() if way == "zig" else other("gcc")
    assert driver is not None
    (folder / "table.fkt").write_bytes(image())
    (folder / "seeds").write_bytes(seeds())
    files = files | {"fuzz_main.c": (HERE / "fuzz_main.c").read_bytes()}
    for name, content in files.items():
        (folder / name).write_bytes(content)
    sources = sorted(name for name in files if name.endswith(".c") and name not in NOT_FUZZED)
    flags = [*SANITIZED, "-ffp-contract=off", *WAYS[way]]
    # What counts the places is not counted itself.
    driver.run(["-std=c99", "-O2", "-c", "fuzz_main.c", "-o", "fuzz_main.o"], folder=folder)
    driver.run([*flags, "-o", "fuzz", *sources, "fuzz_main.o", "-lm"], folder=folder)
    environment = os.environ | {"FK_FUZZ_TABLE": str(folder / "table.fkt")}
    run = subprocess.run(
        [str(folder / "fuzz"), str(seed), str(inputs), str(folder / "seeds")],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return run.stdout if run.returncode == 0 else f"failed {run.returncode}: {run.stderr[-3000:]}"


NO_GCC = pytest.mark.skipif(
    sys.platform == "win32" or not shutil.which("gcc"),
    reason="no gcc on this machine: no address sanitizer, zig brings that of undefined behaviour only",
)


@from_ci
@pytest.mark.parametrize("way", ["zig", pytest.param("gcc", marks=[NO_GCC, pytest.mark.extra])])
def test_inputs_guided_by_coverage_under_sanitizers(way: str, tmp_path: Path) -> None:
    reported = guided(tmp_path, way, source_files(), count(20_000, 1_000_000, 5000))
    assert not reported.startswith("failed"), reported
    inputs, of_seeds, kept, places = map(int, reported.split())
    print(f"{way}: {inputs} inputs, {of_seeds} kept of the seeds, {kept} in all, {places} places reached")
    assert kept > 2 * of_seeds > 40, "coverage guides"


PLANTED = {
    "a frame longer than its room": ("fk_frames.c", "code - 1u > capacity - to", "0"),
    "a block longer than the frame": ("fk_frames.c", "code - 1u > length - from", "0"),
}


@from_ci
@NO_GCC
@pytest.mark.parametrize("name", some(PLANTED, 1))
def test_a_planted_fault_is_found_by_the_monitor(name: str, tmp_path: Path) -> None:
    files = source_files()
    file, old, new = PLANTED[name]
    text = files[file].decode()
    assert text.count(old) == 1, f"{file} holds {old!r} {text.count(old)} times: correct the mutation"
    files[file] = text.replace(old, new).encode()
    reported = guided(tmp_path, "gcc", files, 20_000)
    assert reported.startswith("failed") and (
        "AddressSanitizer" in reported or "runtime error" in reported
    ), reported


@pytest.mark.extra
def test_libfuzzer_finds_nothing_either(tmp_path: Path) -> None:
    clang = other("clang")
    probe = tmp_path / "probe.c"
    probe.write_text(
        "#include <stdint.h>\n#include <stddef.h>\n"
        "int LLVMFuzzerTestOneInput(const uint8_t *d, size_t n);\n"
        "int LLVMFuzzerTestOneInput(const uint8_t *d, size_t n) { return n > 0 && d[0] > 255; }\n"
    )
    flags = [
        "-g",
        "-O1",
        "-fsanitize=fuzzer,address,undefined",
        "-fno-sanitize-recover=all",
        "-ffp-contract=off",
    ]
    try:
        assert clang is not None
        clang.run([*flags, "-o", "probe", "probe.c"], folder=tmp_path)
    except Exception:
        pytest.skip("no clang with libFuzzer on this machine: the fuzzer of the tests runs without it")
    files = source_files()
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    sources = sorted(name for name in files if name.endswith(".c") and name not in NOT_FUZZED)
    clang.run([*flags, "-std=c99", "-ffp-contract=off", "-o", "fuzz", *sources], folder=tmp_path)
    (tmp_path / "table.fkt").write_bytes(image())
    corpus, runs = tmp_path / "corpus", count(20_000, 10_000_000, 5000)
    corpus.mkdir()
    run = subprocess.run(
        [str(tmp_path / "fuzz"), f"-runs={runs}", "-seed=1", "-max_len=1024", str(corpus)],
        env=os.environ | {"FK_FUZZ_TABLE": str(tmp_path / "table.fkt")},
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-3000:]
