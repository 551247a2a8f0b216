"""The sweep: what it covers, that it resumes to the same bytes, how it ranks, and the paper's winners."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from tests.conftest import count, from_ci
from tests.der.single import simulate_gait
from tests.identification.made import robot

from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.der import prepare
from frogkick.effects.swims import Gait
from frogkick.report.sweep_page import write_sweep_report
from frogkick.robot import load_robot
from frogkick.validation.gaits import GaitSwim, cost_of_transport, swim_chunks, swim_gaits
from frogkick.validation.sweep import (
    Design,
    Point,
    Sweep,
    SweepPlan,
    by_cost,
    by_speed,
    paper_verdicts,
    plan_sweep,
    rank_designs,
    rank_gaits,
    run_sweep,
)

ROBOT = robot()
SMALL = plan_sweep(ROBOT, [1.9, 2.3], phases=2, egain_percent=[40.0, 50.0])


def chunks_of(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted((folder / "chunks").iterdir())}


def test_by_default_every_measured_design() -> None:
    plan = plan_sweep(ROBOT)
    assert len(plan.designs) == len(ROBOT.profiles) == 48
    assert plan.gaits == 480 and plan.phases[3] == 0.3 and not plan.interpolated and not plan.skipped


def test_between_measured_profiles_is_said_and_outside_is_left_out() -> None:
    plan = plan_sweep(ROBOT, [0.75, 0.8, 3.0], 1, [10.0])
    assert plan.designs == (Design(10.0, 0.75), Design(10.0, 0.8))
    assert plan.interpolated == {Design(10.0, 0.75)}
    assert [skipped.case for skipped in plan.skipped] == ["10pct_3Hz"]
    between = plan_sweep(ROBOT, None, 1, [15.0])
    assert set(between.designs) == between.interpolated
    assert max(design.frequency_hz for design in between.designs) == 1.2  # 10 % was measured up to there


@pytest.mark.parametrize(
    ("frequencies", "phases", "egain"),
    [([9.0], 10, None), (None, 0, None), (None, 10, []), ([0.0], 1, None), ([math.nan], 1, [10.0])],
)
def test_nothing_to_sweep_is_refused(
    frequencies: list[float] | None, phases: int, egain: list[float] | None
) -> None:
    with pytest.raises(InputError):
        plan_sweep(ROBOT, frequencies, phases, egain)


def test_a_gait_here_is_the_gait_of_simulate() -> None:
    gaits = [Gait(30.0, 1.4, 0.5), Gait(10.0, 1.2, 0.1)]
    for gait, swum in zip(gaits, swim_gaits(prepare(ROBOT), ROBOT.profiles, gaits), strict=True):
        assert isinstance(swum, GaitSwim)
        alone = simulate_gait(ROBOT, gait.egain_percent, gait.frequency_hz, gait.phase, 8)
        assert swum.speed_mps == pytest.approx(alone.speed_mps, rel=1e-9)
        assert swum.cost_of_transport == pytest.approx(alone.cost_of_transport, rel=1e-9)
        assert swum.time_s[-1] == pytest.approx(8.0 / gait.frequency_hz)


def test_what_cannot_swim_says_why_and_the_rest_swims() -> None:
    gaits = [Gait(30.0, 9.0, 0.5), Gait(50.0, 2.3, 0.5), Gait(50.0, 2.3, 1.5)]
    far, good, late = swim_gaits(prepare(ROBOT), ROBOT.profiles, gaits)
    assert isinstance(far, str) and "not extrapolated" in far
    assert isinstance(late, str) and "phase" in late
    assert isinstance(good, GaitSwim)


def test_workers_must_be_in_range() -> None:
    with pytest.raises(InputError, match="workers"):
        list(swim_chunks(ROBOT, ROBOT.profiles, [[Gait(50.0, 2.3, 0.5)]], 0))


def test_cost_of_transport_by_hand() -> None:
    weight_n = ROBOT.mass_kg * 9.80665
    by_hand = 4 * ROBOT.pulse_energy_j / (weight_n * 0.05 / 2.0)  # 25 mm in a cycle
    assert cost_of_transport(ROBOT, 2.0, 0.05) == pytest.approx(by_hand)
    assert cost_of_transport(ROBOT, 2.0, -0.01) == math.inf


def test_the_same_bytes_for_any_workers(tmp_path: Path) -> None:
    one = run_sweep(SMALL, tmp_path / "one", workers=1)
    two = run_sweep(SMALL, tmp_path / "two", workers=2)
    assert one.points == two.points and len(one.points) == 6  # 40 % was measured up to 1.9 Hz
    assert chunks_of(tmp_path / "one") == chunks_of(tmp_path / "two")


def test_a_stopped_sweep_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    plan = plan_sweep(ROBOT, [2.1, 2.2, 2.3], phases=8, egain_percent=[50.0])
    whole = run_sweep(plan, tmp_path / "whole", workers=1)

    def stop(done: int, total: int) -> None:
        if done >= 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sweep(plan, tmp_path / "cut", workers=1, progress=stop)
    assert list(chunks_of(tmp_path / "cut")) == ["50pct_2.1Hz.json"]
    reported: list[int] = []
    again = run_sweep(plan, tmp_path / "cut", workers=1, progress=lambda done, _: reported.append(done))
    assert reported == [8, 16, 24]  # the first chunk was not made again
    assert again.points == whole.points
    assert chunks_of(tmp_path / "cut") == chunks_of(tmp_path / "whole")


@pytest.mark.parametrize("spoil", ["cut off", "foreign", "other phases"])
def test_a_chunk_that_does_not_fit_is_made_again(tmp_path: Path, spoil: str) -> None:
    plan = plan_sweep(ROBOT, [2.3], phases=2, egain_percent=[50.0])
    run_sweep(plan, tmp_path, workers=1)
    ((name, sound),) = chunks_of(tmp_path).items()
    file = tmp_path / "chunks" / name
    if spoil == "cut off":
        file.write_bytes(sound[:-20])
    elif spoil == "foreign":
        file.write_text(json.dumps({**json.loads(sound), "made_from": "another robot"}))
    else:
        run_sweep(plan_sweep(ROBOT, [2.3], phases=3, egain_percent=[50.0]), tmp_path, workers=1)
    assert len(run_sweep(plan, tmp_path, workers=1).points) == 2
    assert chunks_of(tmp_path) == {name: sound}


def test_a_changed_robot_makes_its_own_chunks(tmp_path: Path) -> None:
    plan = plan_sweep(ROBOT, [2.3], phases=1, egain_percent=[50.0])
    run_sweep(plan, tmp_path, workers=1)
    before = chunks_of(tmp_path)
    run_sweep(replace(plan, robot=replace(ROBOT, title="another")), tmp_path, workers=1)
    assert chunks_of(tmp_path) != before


def test_changed_code_makes_its_own_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frogkick's own, and that of an effect which a user wrote."""
    own = tmp_path / "mine.py"
    own.write_text("class Mine:\n    def stroke(self, stroke, history, rng):\n        stroke.gain *= 0.9\n")
    mine = replace(ROBOT, effects=({"file": "mine.py"},), folder=tmp_path)
    plan = replace(plan_sweep(ROBOT, [2.3], phases=1, egain_percent=[50.0]), robot=mine)
    run_sweep(plan, tmp_path, workers=1)
    found = [chunks_of(tmp_path)]
    own.write_text(own.read_text().replace("0.9", "0.8"))
    run_sweep(plan, tmp_path, workers=1)
    found.append(chunks_of(tmp_path))
    monkeypatch.setattr("frogkick.validation.sweep.code_stamp", lambda: "of another version")
    run_sweep(plan, tmp_path, workers=1)
    assert len({content for chunks in (*found, chunks_of(tmp_path)) for content in chunks.values()}) == 3


def made_up(rows: list[tuple[float, float, float, float, float]]) -> Sweep:
    """A sweep from (EGaIn, frequency, phase, speed, cost)."""
    designs = tuple(dict.fromkeys(Design(egain, hz) for egain, hz, *_ in rows))
    phases = tuple(sorted({phase for _, _, phase, _, _ in rows}))
    points = tuple(Point(Gait(egain, hz, phase), speed, cost) for egain, hz, phase, speed, cost in rows)
    return Sweep(SweepPlan(ROBOT, designs, phases, frozenset(), ()), points)


def test_phases_that_the_model_cannot_tell_apart_are_listed_nearest_to_half_a_cycle() -> None:
    sweep = made_up(
        [
            (30.0, 1.3, 0.0, 0.0504, 255.0),
            (30.0, 1.3, 0.5, 0.0500, 257.0),  # 0.4 mm/s slower: a tie
            (30.0, 1.4, 0.0, 0.0512, 270.0),
            (30.0, 1.4, 0.5, 0.0506, 275.0),  # 0.6 mm/s slower: none
        ]
    )
    assert [(p.gait.frequency_hz, p.gait.phase) for p in rank_designs(sweep, by_speed)] == [
        (1.4, 0.0),
        (1.3, 0.5),
    ]
    assert [p.gait.frequency_hz for p in rank_designs(sweep, by_cost, 0.5)] == [1.3, 1.4]
    assert [p.speed_mps for p in rank_gaits(sweep, by_speed)] == [0.0512, 0.0506, 0.0504, 0.0500]


def test_failed_gaits_are_in_no_ranking_and_standing_still_costs_most() -> None:
    sweep = made_up([(10.0, 0.4, 0.5, 0.02, 200.0), (10.0, 0.5, 0.5, -0.001, math.inf)])
    failed = Point(Gait(10.0, 0.4, 0.0), math.nan, math.nan, "rods did not converge")
    sweep = replace(sweep, points=(failed, *sweep.points))
    assert [p.gait.frequency_hz for p in rank_designs(sweep, by_cost)] == [0.4, 0.5]
    assert failed not in rank_gaits(sweep, by_speed)


def test_a_chunk_keeps_failures_and_infinite_costs(tmp_path: Path) -> None:
    from frogkick.validation.sweep import _chunk_text, _point_of

    points = [
        Point(Gait(10.0, 0.4, 0.0), math.nan, math.nan, "why"),
        Point(Gait(10.0, 0.4, 0.5), -0.001, math.inf),
        Point(Gait(10.0, 0.4, 0.7), 0.1 + 0.2, 1.0 / 3.0),
    ]
    again = [_point_of(row, ROBOT) for row in json.loads(_chunk_text("key", points))["points"]]
    assert again[1:] == points[1:]
    assert again[0].failure == "why" and math.isnan(again[0].speed_mps)


@from_ci
def test_the_paper_s_winners_are_found(tmp_path: Path) -> None:
    """Fastest 30 % at 1.3 and 1.4 Hz, most efficient 10 % at 0.4 and 0.5 Hz, among every measured design.

    Four phases of each in .ci/run: limbs together, half a cycle apart and between; ten in make test-full.
    """
    whole = load_robot("frog2022")
    sweep = run_sweep(plan_sweep(whole, phases=count(4, 10)), tmp_path, workers=2)
    fastest, cheapest = rank_designs(sweep, by_speed), rank_designs(sweep, by_cost)
    assert {(p.gait.egain_percent, p.gait.frequency_hz) for p in fastest[:2]} == {(30.0, 1.3), (30.0, 1.4)}
    assert {(p.gait.egain_percent, p.gait.frequency_hz) for p in cheapest[:2]} == {(10.0, 0.4), (10.0, 0.5)}
    assert {p.gait.phase for p in (*fastest[:2], *cheapest[:2])} == {0.5}
    verdicts = paper_verdicts(sweep)
    assert [verdict.agrees for verdict in verdicts] == [True] * 4
    for verdict in verdicts:
        if verdict.winner.speed_mps is not None:  # the paper's figure is the mean over all of a run
            assert verdict.mean_speed_mps == pytest.approx(verdict.winner.speed_mps, abs=1.2e-3)
            assert "24 cycles" in verdict.why
        else:
            assert verdict.ours.cost_of_transport == pytest.approx(verdict.winner.cost_of_transport, rel=0.05)
            assert "pulse energy" in verdict.why


def test_another_robot_has_no_winners_of_the_paper(tmp_path: Path) -> None:
    sweep = made_up([(30.0, 1.3, 0.5, 0.05, 255.0), (30.0, 1.4, 0.5, 0.05, 255.0)])
    other = replace(sweep, plan=replace(sweep.plan, robot=replace(ROBOT, id="other")))
    assert paper_verdicts(other) == []


@from_ci
def test_the_report_is_the_same_bytes_again(tmp_path: Path) -> None:
    sweep = run_sweep(SMALL, tmp_path, workers=1)
    first = [file.read_bytes() for file in write_sweep_report(tmp_path / "a", sweep, [])]
    second = [file.read_bytes() for file in write_sweep_report(tmp_path / "b", sweep, [])]
    assert first == second and len(first) == 3
    assert b"Cost of transport = electrical energy" in first[2]
    assert b"50pct_" not in first[2] and b"40pct_2.3Hz" in first[2]  # what was left out


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    options = ["sweep", "--frequencies", "1.85,1.9", "--egain", "40", "--phases", "2", "--workers", "1"]
    assert run_command([*options, "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert {"egain_percent", "frequency_hz", "phase", "speed_mps", "cost_of_transport"} == set(
        result["fastest"][0]
    )
    assert result["interpolated"] == [{"egain_percent": 40.0, "frequency_hz": 1.85}]
    assert result["gaits"] == 4 and "weight in air" in result["energy_model"]
    assert (out / "sweep.csv").read_text().count("\n") == 5
    before = {file.name: file.read_bytes() for file in out.glob("*.*")}
    assert run_command([*options, "--out", str(out), "--json"]) == 0  # all chunks are there
    assert {file.name: file.read_bytes() for file in out.glob("*.*")} == before
    capsys.readouterr()
    assert run_command(["sweep", "--frequencies", "fast", "--out", str(out)]) == 2
    assert "--frequencies" in capsys.readouterr().err
    assert run_command(["sweep", "--frequencies", "9", "--out", str(out)]) == 2


def test_a_report_of_designs_without_a_result(tmp_path: Path) -> None:
    """One failed, one only goes back: warnings would be errors here."""
    sweep = made_up([(10.0, 0.4, 0.5, 0.02, 200.0), (10.0, 0.5, 0.5, -0.001, math.inf)])
    failed = Point(Gait(10.0, 0.4, 0.5), math.nan, math.nan, "rods did not converge")
    for points in ((failed, sweep.points[1]), (failed, replace(failed, gait=sweep.points[1].gait))):
        write_sweep_report(tmp_path, replace(sweep, points=points), ())
        assert "rods did not converge" in (tmp_path / "sweep.html").read_text()
