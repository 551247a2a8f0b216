"""An owner's key on the chip: kept in flash, its nonces from RNG, and what proving it costs."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.loop import rig

from frogkick.link.layout import Value, link_layout
from frogkick.loop.pushing import own
from frogkick.loop.session import LinkError, Session
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import load_robot
from frogkick_codegen.firmware import Build, build

PARAM: dict[str, Value] = {"parameter": link_layout().parameter["LEVEL_WEIGHT"], "value": 0.5}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Build:
    return build("bench", rig.small_table(), load_robot("frog2022"), tmp_path_factory.mktemp("owner") / "out")


def power_on(bench: Build, key_file: Path, flash: bytes | None = None) -> Session:
    session = Session(VirtualRobot(bench.image, 4, flash), key_file=key_file)
    session.step(0.7)
    return session


def flash_of(session: Session) -> bytes:
    """What is left when it loses its supply."""
    assert isinstance(session.port, VirtualRobot)
    return session.port.chip.flash.content()


def test_its_owner_commands_it_also_after_a_loss_of_power(bench: Build, tmp_path: Path) -> None:
    session = power_on(bench, tmp_path / "owner.key")
    own(session)
    session.request("ARM")
    again = power_on(bench, tmp_path / "owner.key", flash_of(session))
    with pytest.raises(LinkError, match=r"refuses PARAM .*: AUTH, as it takes commands from its owner alone"):
        again.request("PARAM", PARAM)
    again.authenticate()
    again.request("PARAM", PARAM)
    session.request("DISARM")
    own(session, release=True)
    open_again = power_on(bench, tmp_path / "none.key", flash_of(session))
    open_again.authenticate()
    open_again.request("PARAM", PARAM)
