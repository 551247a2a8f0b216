"""``frogkick log fetch`` and ``log replay``: a robot's log as a file, decided again; what they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import pytest
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.front.replaying import fetch_from
from frogkick.link.log import ChipLog, Stretch
from frogkick.paths import shape
from frogkick.runs.chip_log import FetchedLog, read_log, write_log
from frogkick.runs.session import Session


@pytest.fixture(scope="module")
def fetched() -> FetchedLog:
    """Of a robot that a camera tells all the while where it should be."""
    session, path = Session(rig.port("virtual")), shape("line")
    session.handshake(rig.tables())
    session.send_path(path)
    session.request("ARM")
    for number in range(60):
        session.step(session.time_s + 0.08)
        x_m = float(path.x_m[0]) + 0.02 * session.time_s
        pose = {"x_m": x_m, "y_m": float(path.y_m[0]), "heading_rad": 0.0}
        session.request("FIX", {"fix_sequence": number, "quality": 1, "capture_age_us": 5000, **pose})
        if number == 10:
            session.request("START", {"delay_us": 100_000})
    session.request("DISARM")
    return fetch_from(session)


def words(file: Path, *more: str) -> list[str]:
    return ["log", "replay", str(file), "--tables", str(rig.small_table()), *more, "--json"]


def test_a_file_keeps_what_was_fetched(fetched: FetchedLog, tmp_path: Path) -> None:
    write_log(tmp_path / "a.h5", fetched)
    assert read_log(tmp_path / "a.h5") == fetched
    write_log(tmp_path / "b.h5", fetched)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    gap = FetchedLog("frog2022", 7, ChipLog((Stretch(2**32 - 1, b"ab"), Stretch(9, b"")), 3))
    write_log(tmp_path / "c.h5", gap)
    assert read_log(tmp_path / "c.h5") == gap


def test_what_is_in_it(fetched: FetchedLog) -> None:
    reported = fetched.summary()
    assert (reported["robot_id"], reported["gaps"], reported["lost"], reported["faults"]) == (
        "frog2022",
        0,
        0,
        [],
    )
    assert reported["starts"] == ["POWER"]
    kinds = reported["kinds"]
    assert (kinds["FIX"], kinds["START"], kinds["DISARM"]) == (60, 1, 1)
    assert kinds["DECISION"] >= 2
    assert reported["seconds"] == pytest.approx(60 * 0.08, abs=2.0)


def test_replay(fetched: FetchedLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_log(tmp_path / "a.h5", fetched)
    assert run_command(words(tmp_path / "a.h5")) == 0
    output = json.loads(capsys.readouterr().out)
    assert (output["mismatches"], output["segments"]) == (0, 1)
    assert output["decisions"] == len(output["actions"]) == fetched.summary()["kinds"]["DECISION"]


def test_a_wrong_bit_is_exit_1(
    fetched: FetchedLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (stretch,) = fetched.log.stretches
    record = next(r for r in fetched.log.records()[0] if r.name == "DECISION")
    raw = bytearray(stretch.content)
    raw[record.offset - stretch.offset + 60] ^= 4
    changed = ChipLog((Stretch(stretch.offset, bytes(raw)),), 0)
    write_log(tmp_path / "a.h5", FetchedLog(fetched.robot_id, fetched.table_crc, changed))
    assert run_command(words(tmp_path / "a.h5")) == 1
    output = json.loads(capsys.readouterr().out)
    assert output["mismatches"] >= 1
    assert output["first_mismatch"]["place"] == "log"


def test_what_is_refused(fetched: FetchedLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for content, text in ((b"no HDF5", "not a chip log or is damaged"), (b"", "is empty")):
        (tmp_path / "a.h5").write_bytes(content)
        assert run_command(words(tmp_path / "a.h5")) == 2
        assert text in capsys.readouterr().err
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.attrs["format"] = "frogkick run"
    with pytest.raises(InputError, match="expected 'frogkick chip log' version 1"):
        read_log(tmp_path / "b.h5")
    write_log(tmp_path / "c.h5", FetchedLog("hexapod", fetched.table_crc, fetched.log))
    assert run_command(words(tmp_path / "c.h5")) == 2
    assert "the log is of robot 'hexapod'" in capsys.readouterr().err
    write_log(tmp_path / "d.h5", FetchedLog("frog2022", 7, ChipLog()))
    assert run_command(words(tmp_path / "d.h5")) == 2
    assert "can be repeated with table" in capsys.readouterr().err
    write_log(tmp_path / "e.h5", FetchedLog("frog2022", fetched.table_crc, ChipLog()))
    assert run_command(words(tmp_path / "e.h5")) == 2
    assert "no decision in 'e.h5' can be repeated, because it has no ARM" in capsys.readouterr().err
    (tmp_path / "e.h5").unlink()
    for target in ("virtual", "tcp:1", "serail:x"):
        assert run_command(["log", "fetch", "--robot", target, "--out", str(tmp_path / "e.h5")]) == 2
        assert "is not the target of a robot: choose ble:NAME, serial:PORT" in capsys.readouterr().err
    assert not (tmp_path / "e.h5").exists()
