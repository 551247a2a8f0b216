"""A table by UARTE frames into the virtual chip's flash; it then plans by it, also after a loss of power."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_build import build_text
from tests.planner import synthetic

from frogkick.core.files import write_bytes
from frogkick.library import BUDGET_BYTES
from frogkick.link.layout import Value, link_layout
from frogkick.paths import shape
from frogkick.planner.plan import config_of, plan
from frogkick.pool.chip import ChipError, VirtualChip
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import load_robot
from frogkick.runs.decision import LIMB_USE_FIELDS
from frogkick.runs.pushing import UploadError, upload
from frogkick.runs.session import Session
from frogkick.tables.image import open_image
from frogkick_codegen import firmware
from frogkick_codegen.firmware import Firmware

OLD, NEW = synthetic.affine_image(20, 9, 1), synthetic.affine_image(24, 9, 2)
"""Two pages of flash each."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Firmware:
    folder = tmp_path_factory.mktemp("update")
    write_bytes(folder / "t.fkt", OLD)
    return firmware.build("bench", folder / "t.fkt", load_robot("frog2022"), folder / "out")


def power_on(bench: Firmware, flash: bytes | None = None) -> Session:
    """A session with a robot whose limbs have rested."""
    session = Session(VirtualRobot(bench.image, 4, flash))
    session.step(0.7)
    return session


def test_one_update(bench: Firmware) -> None:
    session = power_on(bench)
    reported = session.handshake(open_image(OLD))
    assert reported["table_crc"] == open_image(OLD).crc32
    done = upload(session, NEW)
    assert (done.bytes_sent, done.resumed_at, done.table_crc) == (len(NEW), 0, open_image(NEW).crc32)
    session.handshake(open_image(NEW))
    flash = chip_of(session).flash
    # And BEGIN, PAGE, COMMIT, each twice and with a mark, and the mark of the journal's other page.
    assert flash.words_written == len(NEW) // 4 + 3 * (2 * 27 + 1) + 1
    assert sorted(flash.erases.values()) == [1, 1, 1]  # two pages of the slot, one of the journal
    assert upload(session, NEW).bytes_sent == 0
    again = power_on(bench, flash.content())
    again.handshake(open_image(NEW))
    status = again.request("TABLE_STATUS")
    assert (status["running"], status["active"], status["slots"], status["erases_1"]) == (1, 1, 2, 1)
    # And back.
    again.request("TABLE_ROLLBACK", {"table_crc": status["built_in_crc"]})
    again.handshake(open_image(OLD))


def test_plans_by_the_new_table_as_the_twin_does(bench: Firmware) -> None:
    robot, path, dice = load_robot("frog2022"), shape("ellipse"), np.random.default_rng(3)
    session = power_on(bench)
    states = [
        dice.uniform((-0.3, -0.3, -3.0, -0.03, -0.03, -0.3), (0.3, 0.3, 3.0, 0.03, 0.03, 0.3))
        for _ in range(6)
    ]
    decided = []
    for image in (OLD, NEW):
        tables = open_image(image)
        upload(session, image)
        session.send_path(path)
        for state in states:
            state = state.astype(np.float32)
            names = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_rad_s")
            values: dict[str, Value] = dict(zip(names, (float(value) for value in state), strict=True))
            values |= {"depth": 2, "along_points": 0.0, **dict.fromkeys(LIMB_USE_FIELDS, 0)}
            answer = session.request("PLAN", values)
            twin = plan(tables, path, replace(config_of(robot.planner), depth=2), state)
            predicted = np.array([answer[name] for name in names], dtype=np.float32)
            assert (answer["action"], answer["nearest_state"]) == (twin.action, twin.nearest_state)
            assert np.float32(answer["cost"]) == twin.cost
            assert (predicted == twin.predicted).all()
            decided.append((twin.action, float(twin.cost)))
    assert decided[:6] != decided[6:]


def test_power_lost_in_the_middle(bench: Firmware) -> None:
    """The old table, and the next upload goes on behind the page that was whole."""
    session = power_on(bench)
    chip = chip_of(session)

    class Lost(Exception):
        pass

    def stop(done: int, _all: int) -> None:
        if done >= 4096 + 256:
            raise Lost

    with pytest.raises(Lost):
        upload(session, NEW, stop)
    again = power_on(bench, chip.flash.content())
    again.handshake(open_image(OLD))
    assert upload(again, NEW).resumed_at == 4096
    again.handshake(open_image(NEW))


def test_only_at_rest(bench: Firmware) -> None:
    session = power_on(bench)
    session.request("ARM")
    with pytest.raises(UploadError, match="refuses TABLE_BEGIN with STATE: disarm it"):
        upload(session, NEW)
    session.request("STROKE", {"action": 1})
    session.step(session.time_s + 0.05)
    session.request("DISARM")
    with pytest.raises(UploadError, match="STATE"):
        upload(session, NEW)
    assert chip_of(session).flash.words_written == 0
    session.step(session.time_s + 0.6)
    answer = session.request("TABLE_BEGIN", {"length": len(NEW)} | {f"hash_{i}": i for i in range(8)})
    assert answer["next_offset"] == 0
    assert link_layout().status_name(int(session.ask("ARM")["status"])) == "STATE"
    session.request("TABLE_ROLLBACK", {"table_crc": answer["table_crc"]})
    session.request("ARM")


def chip_of(session: Session) -> VirtualChip:
    assert isinstance(session.port, VirtualRobot)
    return session.port.chip


def test_what_the_robot_refuses(bench: Firmware) -> None:
    session = power_on(bench)
    with pytest.raises(UploadError, match="has room for 65536"):
        upload(session, bytes(65540))
    other = synthetic.affine_image(20, 9, 1, robot_id="another")
    with pytest.raises(
        UploadError, match=re.escape("TABLE_COMMIT with TABLE (fk_error_t -9): make the table")
    ):
        upload(session, other)
    session.handshake(open_image(OLD))


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("FK_REGISTER(0x20000u) = 1u;", "write of 4 bytes to flash at 0x00020000"),
        ("NVMC_CONFIG = 2u; FK_REGISTER(0x20000u) = 1u;", "write of 4 bytes to flash at 0x00020000"),
        ("NVMC_ERASEPAGE = 0x20000u;", "NVMC.CONFIG does not enable erasing"),
        ("NVMC_CONFIG = 1u; NVMC_ERASEPAGE = 0x20000u;", "NVMC.CONFIG does not enable erasing"),
        ("NVMC_CONFIG = 2u; NVMC_ERASEPAGE = 0x20004u;", "no page of flash begins there"),
        ("NVMC_CONFIG = 2u; NVMC_ERASEPAGE = 0x80000u;", "no page of flash begins there"),
        ("NVMC_CONFIG = 3u;", "write of 0x3 to NVMC.CONFIG"),
        ("NVMC_READY = 1u;", "it cannot be written"),
        (
            "NVMC_CONFIG = 1u; FK_REGISTER(0x20000u) = 0xFFFFFFF0u; FK_REGISTER(0x20000u) = 0xFFFFFFF1u;",
            "which holds 0xfffffff0: only an erase turns bits to 1",
        ),
        ("NVMC_CONFIG = 1u; *(volatile uint8_t *)0x20001u = 1u;", "only aligned words are taken"),
        (
            "NVMC_CONFIG = 1u; for (uint32_t i = 0u; i < 182u; ++i) { FK_REGISTER(0x20000u) = 1u; }",
            "more than 181 in its 512 bytes",
        ),
    ],
)  # fmt: skip
def test_flash_refuses(tmp_path: Path, body: str, words: str) -> None:
    source = f'#include "nrf52832_regs.h"\nint main(void);\nint main(void) {{ {body} for (;;) {{ }} }}\n'
    chip = VirtualChip(build_text(source, tmp_path, drivers=True))
    with pytest.raises(ChipError, match=re.escape(words)):
        chip.run_until(200_000)


def test_slots_beside_a_table() -> None:
    assert firmware.slots_for(5000) == (2, 65536)
    # The default table goes to any robot by radio, and leaves room for two more where it is built in.
    assert firmware.SLOT_BYTES_MIN == BUDGET_BYTES
    assert firmware.slots_for(BUDGET_BYTES) == (2, BUDGET_BYTES)
    assert firmware.slots_for(65_540) == (2, 69_632)
    assert firmware.slots_for(181_592) == (1, 184_320)
