"""The viewer's state during a run: the planner's own predictions, also by the command."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
import urllib.request
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.error import HTTPError

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.runs import rig
from tests.runs.rig import without_plan

import frogkick as fk
from frogkick.core.local_server import HOST
from frogkick.front.viewing import viewed
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig, plan
from frogkick.report.live_page import ASKS, page, served
from frogkick.runs.closed_loop import STOPPED
from frogkick.runs.live_view import LiveView, fan_of, tree_of
from frogkick.runs.record import RunOptions
from frogkick.runs.runlog import RunLog

CONFIG = PlanConfig(depth=3)
OUTLINE = rig.robot().frame.corners_m


def test_the_fan_is_what_the_planner_predicts() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        state = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(-3, 3), 0.02, 0.0, 0.1], dtype=np.float32)
        planned = plan(rig.tables(), shape("sine"), CONFIG, state)
        fan = fan_of(rig.tables(), state, (0,) * 8)
        assert len(fan) == len(rig.tables().actions)
        assert fan[planned.action, :2] == pytest.approx(planned.predicted[:2], abs=1e-5)
        turned = np.angle(np.exp(1j * (fan[planned.action, 2] - float(planned.predicted[2]))))
        assert abs(turned) < 1e-5


def test_the_tree_begins_with_the_decision_and_is_as_deep_as_the_plan() -> None:
    recording = rig.swim("pool", "sine", 6.0)
    decision = recording.decisions[-1]
    tree = tree_of(rig.tables(), shape("sine"), CONFIG, decision)
    assert len(tree.branch) == 4 and len(tree.fans) == len(tree.names) == 3
    assert tree.names[0] == rig.tables().actions[decision.action].name
    assert tree.branch[:2] == [decision.estimate[:3].tolist(), decision.predicted[:3].tolist()]
    actions = [row.name for row in rig.tables().actions]
    for level, fan in enumerate(tree.fans):  # the branch goes on along one of each node's actions
        end = fan[actions.index(tree.names[level])]
        assert end[:2] == pytest.approx(tree.branch[level + 1][:2], abs=1e-5)
    alone = tree_of(rig.tables(), shape("sine"), PlanConfig(depth=1), decision)
    assert len(alone.branch) == 2 and len(alone.fans) == 1


def test_the_newest_state_is_told() -> None:
    recording = rig.swim("pool", "sine", 6.0)
    pool, view = recording.pool, LiveView(OUTLINE)
    assert json.loads(view.text) == {} and pool is not None
    view.show(replace(recording, options=replace(recording.options, config=CONFIG)))
    output = json.loads(view.text)
    assert len(output["path"]) == 100 and len(output["decisions"]) == len(recording.decisions)
    assert len(output["branch"]) == 4 and len(output["fan"]) == 3 * len(rig.tables().actions)
    assert output["track"][-1] == pytest.approx(pool.truth.pose_world[-1], abs=1e-4)
    assert len(output["letters"]) == len(output["decisions"]) and set("".join(output["letters"])) <= set(
        "ABCDEFGHI"
    )
    assert output["camera"] is None
    *corners, centre, foremost = output["robot"]
    assert centre == pytest.approx(pool.truth.pose_world[-1][:2], abs=1e-4) and len(corners) == len(OUTLINE)
    ahead = np.array(foremost) - centre
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(pool.truth.pose_world[-1][2], abs=5e-3)
    apart = np.hypot(*(np.array(corners) - centre).T)
    assert apart == pytest.approx(np.hypot(*np.array(OUTLINE).T), abs=2e-4)
    assert output["fix_age_s"] == pytest.approx(0.08, abs=0.05)


def test_a_run_without_a_decision_is_drawn_too() -> None:
    view = LiveView(OUTLINE)
    view.show(rig.recording(shape("line"), RunOptions(CONFIG)))
    output = json.loads(view.text)
    assert (output["fixes"], output["decisions"], output["branch"], output["fix_age_s"]) == ([], [], [], None)


def fetched(address: str) -> str:
    with urllib.request.urlopen(address, timeout=60.0) as answer:
        return str(answer.read().decode())


def test_the_page_is_served_here_alone() -> None:
    with served(lambda: '{"newest": 1}') as address:
        assert address.startswith(f"http://{HOST}:") and HOST == "127.0.0.1"
        assert fetched(address) == page()
        assert fetched(address + "state.json") == '{"newest": 1}'
        for name in ("etc/passwd", "picture.jpg"):
            with pytest.raises(HTTPError, match="404"):
                fetched(address + name)
    assert not re.search(r"https?:|src=|@import|url[(]", page()), "it needs no other file"


@from_ci
def test_the_command_draws_a_run(tmp_path: Path) -> None:
    """In real time: a run takes at least its simulated time."""
    began = time.monotonic()
    process = subprocess.Popen(
        [
            sys.executable, "-m", "frogkick.cli.main", "run", "--robot", "pool", "--path", "line", "--view",
            "--tables", str(rig.small_table()), "--simulated-time", "3", "--json",
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert process.stderr is not None and process.stdout is not None
    address = ""
    while not address:
        line = process.stderr.readline()
        assert line, "it ended without an address"
        found = re.search(r"the run is drawn at (http://\S+)", line)
        address = found[1] if found else ""
    seen: list[dict[str, Any]] = []
    while process.poll() is None:
        try:
            output = json.loads(fetched(address + "state.json"))
        except OSError:
            break
        if output:
            seen.append(output)
        time.sleep(0.1)
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0 and json.loads(out)["decisions"] >= 2
    assert time.monotonic() - began > 3.0
    counts = [len(output["decisions"]) for output in seen]
    assert counts == sorted(counts) and counts[-1] >= 2 and len(set(counts)) >= 2
    assert seen[-1]["branch"] and len(seen[-1]["track"]) > 10


@from_ci
def test_the_page_s_button_stops_a_run_and_no_other_page_does(capsys: pytest.CaptureFixture[str]) -> None:
    answers: list[int] = []
    reported: list[int] = []
    address = ""

    def press(headers: dict[str, str]) -> None:
        nonlocal address
        address = address or re.findall(r"http://\S+", capsys.readouterr().err)[0]
        asked = urllib.request.Request(address + "stop", data=b"", headers=headers, method="POST")
        try:
            with urllib.request.urlopen(asked, timeout=60.0) as answer:
                answers.append(answer.status)
        except HTTPError as error:
            answers.append(error.code)

    def progress(done: int, _whole: int) -> None:
        reported.append(done)
        if len(reported) == 3:
            press({})
        if len(reported) == 4:
            press({ASKS: "stop"})

    began_s = time.monotonic()
    found = fk.run(rig.small_table(), "sine", view=True, time_limit_s=600.0, progress=progress)
    assert answers == [404, 204], "a page from elsewhere cannot send the header"
    assert found.ended == STOPPED and 3 <= len(found.actions) <= 6 and time.monotonic() - began_s < 300.0
    assert "<button" in page(stops=True) and "<button" not in page()


@from_ci
def test_a_log_is_played(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fk.run(rig.small_table(), "sine", time_limit_s=6.0, out=tmp_path / "run.h5")
    log = fk.load_run(tmp_path / "run.h5").log
    process = subprocess.Popen(
        [
            sys.executable, "-m", "frogkick.cli.main", "log", "show", str(tmp_path / "run.h5"),
            "--view", "--speed", "2", "--json",
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    address = re.findall(r"is played at (http://\S+)", process.stderr.readline())[0]
    seen, began_s = [json.loads(fetched(address + "state.json"))], time.monotonic()
    while process.poll() is None and not seen[-1]["ended"]:
        time.sleep(0.05)
        seen.append(json.loads(fetched(address + "state.json")))
    took_s = time.monotonic() - began_s
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0 and json.loads(out)["decisions"] == len(log.decisions)
    assert took_s >= 0.5 * (log.fixes.time_s.max() - log.fixes.time_s.min())
    assert seen[-1]["ended"] == log.notes
    counts = [len(state["decisions"]) for state in seen]
    assert counts == sorted(counts) and counts[0] == 0 and counts[-1] == len(log.decisions)
    assert seen[-1]["letters"] == [log.action_names[index] for index in log.decisions.action]
    reported = log.decisions
    assert reported.estimate is not None and reported.predicted is not None and log.truth is not None
    assert seen[-1]["branch"] == [
        pytest.approx(rows[-1, :3].tolist(), abs=1e-4) for rows in (reported.estimate, reported.predicted)
    ]
    assert seen[-1]["track"][-1] == pytest.approx(log.truth.pose_world[-1].tolist(), abs=1e-4)
    assert len(seen[-1]["robot"]) == len(rig.robot().frame.corners_m) + 2
    with pytest.raises(fk.InputError, match="speed 0"):
        fk.Run(**vars(log)).play(0.0)


def test_a_recorded_run_is_played_by_its_fixes(frog2022_dir: Path) -> None:
    log = fk.load_run(frog2022_dir / "control" / "line1.csv").log
    view = LiveView([])
    view.show_log(log, float(log.decisions.time_s[3]))
    output = json.loads(view.text)
    assert (
        len(output["decisions"]) == len(output["letters"]) == 4
        and not output["branch"]
        and not output["ended"]
    )
    view.show_log(log, 1e6)
    assert len(json.loads(view.text)["decisions"]) == len(log.decisions)


def shown(run: RunLog, time_s: float) -> dict[str, Any]:
    """The state that the page gets, which is JSON as a browser reads it: without NaN."""
    view = LiveView(OUTLINE)
    view.show_log(run, time_s)
    state: dict[str, Any] = json.loads(view.text, parse_constant=pytest.fail)
    return state


def test_decisions_without_a_plan_are_not_drawn() -> None:
    log = without_plan(rig.swim("pool", "sine", 6.0).log(), (1, -1))
    times_s = log.decisions.time_s
    assert len(shown(log, times_s[1])["decisions"]) == 1 and not shown(log, times_s[1])["branch"]
    then = shown(log, times_s[2])
    assert len(then["decisions"]) == len(then["letters"]) == len(then["branch"]) == 2 and then["cost"] > 0.0
    ended = shown(log, 1e6)
    assert len(ended["decisions"]) == len(times_s) - 2 and not ended["branch"] and "cost" not in ended


def test_decisions_before_the_first_fix_have_no_place() -> None:
    log = rig.swim("pool", "sine", 6.0).log()
    quality = np.where(log.fixes.time_s < log.decisions.time_s[2], 0, 1)
    bare = replace(log.decisions, estimate=None, predicted=None)
    late = replace(log, decisions=bare, fixes=replace(log.fixes, quality=quality))
    assert not shown(late, log.decisions.time_s[1])["decisions"]
    assert len(shown(late, 1e6)["decisions"]) in (len(bare) - 2, len(bare) - 3)


def test_a_real_run_is_drawn_by_a_thread_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    """The run hands its recording over and does no more: fixes do not wait for drawing."""
    recording = rig.swim("pool", "sine", 4.0)
    real = replace(recording, pool=None, options=RunOptions(CONFIG))
    with viewed(True, real) as keep:
        address = re.findall(r"http://\S+", capsys.readouterr().err)[0]
        keep(real)
        deadline_s = time.monotonic() + 120.0
        while not (output := json.loads(fetched(address + "state.json"))).get("decisions"):
            assert time.monotonic() < deadline_s, "nobody draws"
            time.sleep(0.02)
    assert len(output["decisions"]) == sum(one.status == 0 for one in recording.decisions)
