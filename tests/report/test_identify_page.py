"""The report of an identification: complete, in one file; and its arithmetic."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tests.conftest import from_ci
from tests.identification.made import known_outcome, make_swim, robot
from tests.report.test_report import self_contained

from frogkick.identification.experiment import Experiment
from frogkick.identification.fit import derivatives
from frogkick.identification.outcome import Outcome, identify
from frogkick.identification.screening import Column
from frogkick.identification.search import CandidateScore
from frogkick.identification.terms import catalogue
from frogkick.identification.verdict import UNEXPLAINED
from frogkick.report.identify_figures import (
    by_action_figure,
    candidates_figure,
    error_figure,
    place_figure,
    time_figure,
    track_figure,
    unexplained_figure,
)
from frogkick.report.identify_page import write_identify_page
from frogkick.report.identify_residuals import by_limb, explained_shares, residuals_of

WORN = {"name": "limb_wear", "limb": "rear_left", "gain": 0.7}
TITLE = "limb_wear rear_left"
TURNS = [
    [CandidateScore(TITLE, 210.0, 65.36, True, True), CandidateScore("steady_wrench", 22.0, 3.21, True),
     *(CandidateScore("warm_up", gain, float("nan"), False) for gain in (7.0, 6.0))],
    [CandidateScore("warm_up", 9.0, float("nan"), False)],
]  # fmt: skip


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    """An outcome with a worn robot's runs, at the true values."""
    train, test = [make_swim([WORN], 31, 9)], [make_swim([WORN], 32, 7), make_swim([WORN], 33, 6)]
    known = known_outcome(train, test, TITLE, (0.7, 0.0, 1.0))
    assert known.found is not None
    plain = next(each for each in catalogue(robot()) if each.title == TITLE)
    at_start = replace(known.found.nominal.model, terms=(plain,))
    (started,) = derivatives([at_start], known.found.data)
    columns = [Column(plain, started.jacobian)]
    found = replace(
        known.found, iterations=TURNS, confounded_with=[["group_gain rear"]], sensitivities=columns
    )
    return replace(known, found=found)


def figures(outcome: Outcome) -> dict[str, Figure]:
    residuals = residuals_of(outcome)
    return {
        "track": track_figure(outcome, residuals),
        "error": error_figure(outcome),
        "time": time_figure(outcome, residuals),
        "cause": by_action_figure(outcome, residuals),
        "place": place_figure(residuals),
        "tried": candidates_figure(TURNS),
        "rest": unexplained_figure(outcome),
    }


@from_ci
def test_every_axis_says_what_it_is_and_in_which_unit(outcome: Outcome) -> None:
    no_unit = {"limb", "action and its number of periods", "periods ahead", ""}
    for name, figure in figures(outcome).items():
        renderer = FigureCanvasAgg(figure).get_renderer()
        figure.draw_without_rendering()
        for axes in figure.axes:
            assert axes.get_title(loc="left"), name
            for label in (axes.get_xlabel(), axes.get_ylabel()):
                assert label in no_unit or label.endswith(("(mm)", "(deg)", "(cm)", "(s)", "(%)", "(1)")), (
                    label
                )
            for text in (axes._left_title, axes.xaxis.label, axes.yaxis.label):
                box = text.get_window_extent(renderer)
                assert not text.get_text() or (box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.width), (
                    name,
                    text.get_text(),
                )


@from_ci
def test_the_page_tells_all(outcome: Outcome, tmp_path: Path) -> None:
    target, row = tmp_path / "what.html", ("G", "B", "E")
    told_apart = replace(outcome)
    told_apart.__dict__["horizons"] = outcome.horizons
    told_apart.__dict__["experiment"] = Experiment((TITLE, "group_gain rear"), row, (0.0, 0.0, 0.0), 12.0)
    write_identify_page(target, told_apart)
    links = self_contained(target.read_text(encoding="utf-8"))
    assert len(links.found) == 7
    for reported in (
        "Verdict: found (limb_wear rear_left)", "noise floor", "5 periods ahead", "by action, limb, time "
        "and place",
        "fixed at the nominal value", "cannot distinguish limb_wear rear_left from group_gain rear",
        "limb_wear rear_left was accepted with a gain of 210, and of 65.36 for each held-out period; the "
        "next best was steady_wrench",
        "no effect was accepted; the best, warm_up, gains 9", "A decisive experiment: to distinguish "
        "limb_wear rear_left from",
        "record from rest: GBE (3 periods, 12.0 sigma apart)", "Unexplained residuals", "made31", "made33",
    ):  # fmt: skip
        assert reported in links.text, reported
    for each in outcome.parameters[0]:  # also of what is fixed, as in the command's JSON
        assert f"{each.low:.4g} to {each.high:.4g}" in links.text, each
    before, after = outcome.tested.before, outcome.tested.after
    assert f"{1e3 * before.position_rmse_m:.2f}" in links.text
    assert f"{1e3 * after.position_rmse_m:.2f}" in links.text
    assert "nan" not in links.text.lower().split() and str(tmp_path) not in links.text


@from_ci
def test_a_page_without_effects_or_without_data_is_one_too(outcome: Outcome, tmp_path: Path) -> None:
    assert outcome.found is not None
    found = replace(outcome.found, fitted=outcome.found.nominal, iterations=TURNS[1:], confounded_with=[])
    nothing = replace(
        outcome, verdict=UNEXPLAINED, found=found, parameters=[], rollouts=outcome.nominal_rollouts
    )
    write_identify_page(tmp_path / "nothing.html", nothing)
    links = self_contained((tmp_path / "nothing.html").read_text(encoding="utf-8"))
    assert "No effect was accepted" in links.text and "Verdict: unexplained (no effect)" in links.text
    few = identify(outcome.train, outcome.test, robot())
    write_identify_page(tmp_path / "few.html", few)
    links = self_contained((tmp_path / "few.html").read_text(encoding="utf-8"))
    assert "11 periods more" in links.text and not links.found


def test_rows_are_the_periods_with_what_was_done_in_them(outcome: Outcome) -> None:
    residuals = residuals_of(outcome)
    assert residuals.run.tolist() == [0] * 7 + [1] * 6 and residuals.period[7:].tolist() == list(range(6))
    swim = outcome.test[0]
    bits = [robot().actions[a].first_mask | robot().actions[a].second_mask for a in swim.action]
    assert residuals.limbs[:7].tolist() == [[mask >> limb & 1 for limb in range(4)] for mask in bits]
    world, body = residuals.residual_world("nominal"), residuals.residual_body("nominal")
    assert np.hypot(*world[:, :2].T) == pytest.approx(np.hypot(*body[:, :2].T))
    assert np.sqrt((world[:, :2] ** 2).sum(axis=1).mean()) == pytest.approx(
        outcome.tested.before.position_rmse_m
    )


def test_what_a_limbs_stroke_misses_is_told_from_the_others(outcome: Outcome) -> None:
    rng = np.random.default_rng(0)
    limbs = rng.integers(0, 2, (40, 4))
    limbs[:, 3] = 0
    truth = np.array([[1.0, 0.0, 0.2], [0.0, -2.0, 0.0], [0.0, 0.0, 0.0]])
    each, error = by_limb(limbs[:, :3] @ truth + 0.5 + rng.normal(0.0, 0.01, (40, 3)), limbs)
    assert each[:3] == pytest.approx(truth, abs=0.02) and np.isnan(each[3]).all()
    assert (np.abs(each[:3] - truth) < 4.0 * error[:3]).all() and (error[:3] < 0.01).all()
    always = np.ones((10, 1), dtype=np.int64)  # no rest to tell strokes from: they take all
    assert by_limb(np.full((10, 3), 2.0), always)[0] == pytest.approx(np.full((1, 3), 2.0))


def test_what_was_found_can_make_its_own_change(outcome: Outcome) -> None:
    ((title, share),) = explained_shares(outcome)
    assert title == TITLE and 0.8 < share <= 1.0
    assert outcome.found is not None
    blind = replace(
        outcome.found.sensitivities[0], jacobian=np.zeros_like(outcome.found.sensitivities[0].jacobian)
    )
    other = replace(outcome, found=replace(outcome.found, sensitivities=[blind]))
    assert explained_shares(other)[0][1] == pytest.approx(0.0)
