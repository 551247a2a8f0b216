"""An owner's key on the chip: kept in flash, its nonces from RNG, and what proving it costs."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.runs import rig

from frogkick.link import auth
from frogkick.link.layout import Value, link_layout
from frogkick.link.wire import BYTE_S
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import load_robot
from frogkick.runs.pushing import own
from frogkick.runs.session import LinkError, Session
from frogkick_codegen.firmware import Firmware, build

PARAM: dict[str, Value] = {"parameter": link_layout().parameter["LEVEL_WEIGHT"], "value": 0.5}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Firmware:
    return build("bench", rig.small_table(), load_robot("frog2022"), tmp_path_factory.mktemp("owner") / "out")


def power_on(bench: Firmware, key_file: Path | None, flash: bytes | None = None) -> Session:
    session = Session(VirtualRobot(bench.image, 4, flash), key_file=key_file)
    session.step(0.7)
    return session


def flash_of(session: Session) -> bytes:
    """What is left when it loses its supply."""
    assert isinstance(session.port, VirtualRobot)
    return session.port.chip.flash.content()


def test_its_owner_commands_it_also_after_a_loss_of_power(bench: Firmware, tmp_path: Path) -> None:
    session = power_on(bench, tmp_path / "owner.key")
    own(session)
    session.request("ARM")
    again = power_on(bench, tmp_path / "owner.key", flash_of(session))
    with pytest.raises(LinkError, match=r"refuses PARAM .*: AUTH: it takes commands only from its owner"):
        again.request("PARAM", PARAM)
    again.authenticate()
    again.request("PARAM", PARAM)
    session.request("DISARM")
    own(session, release=True)
    open_again = power_on(bench, None, flash_of(session))
    open_again.authenticate()
    open_again.request("PARAM", PARAM)


def took_ms(session: Session, name: str, values: dict[str, Value]) -> float:
    """From the command's first byte to its answer's last one."""
    begin_s, sequence = session.time_s, session.post(name, values)
    while True:
        session.step(session.time_s + 1e-3)
        for arrival in session.take(name):
            if arrival.frame.sequence == sequence:
                return 1e3 * (arrival.time_s - begin_s)


def test_what_a_code_costs(bench: Firmware, tmp_path: Path) -> None:
    """Beyond its 12 bytes on the wire; of CHALLENGE beyond its frame and its answer."""
    session = power_on(bench, tmp_path / "owner.key")
    plain_ms = took_ms(session, "PARAM", PARAM)
    own(session)
    session.request("PARAM", PARAM)
    code_ms = took_ms(session, "PARAM", PARAM) - plain_ms - 12e3 * BYTE_S
    nonce = auth.words("nonce", bytes(16))
    wire_ms = 1e3 * BYTE_S * (16 + 33 + 2 * 8)
    challenge_ms = took_ms(session, "CHALLENGE", nonce) - wire_ms
    print(f"a short command's code {code_ms:.2f} ms, CHALLENGE {challenge_ms:.2f} ms")
    assert 0.1 < code_ms < 0.5 and 0.5 < challenge_ms < 2.0
