"""``run --then``: what it takes, refuses and tells."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cli.commands import frogkick
from tests.runs import rig

import frogkick as fk
from frogkick.core.errors import InputError
from frogkick.front.bench import placed
from frogkick.front.mission import next_paths
from frogkick.paths import line, shape


def taken(then: object) -> list[tuple[str, float, bool]]:
    return [(one.path.name, one.at_s, one.here) for one in next_paths(then, 60.0)]  # type: ignore[arg-type]


def test_what_is_taken(tmp_path: Path) -> None:
    odd = tmp_path / "a@3.csv"
    odd.write_text("x,y\n0,0\n0.2,0\n")
    assert taken(()) == []
    assert taken("sine@7.5") == [("sine", 7.5, False)]
    assert taken(["sine@0", "line@7@here"]) == [("sine", 0.0, False), ("line", 7.0, True)]
    assert taken((line(), 4)) == [("line", 4.0, False)]
    assert taken(("ellipse", 4.0, "here")) == [("ellipse", 4.0, True)]
    assert taken([(line(), 4), ("sine", "5")]) == [("line", 4.0, False), ("sine", 5.0, False)]
    assert taken((("sine", 4), "line@5")) == [("sine", 4.0, False), ("line", 5.0, False)]
    assert [at_s for _, at_s, _ in taken(f"{odd}@9@here")] == [9.0]


@pytest.mark.parametrize(
    ("then", "said"),
    [
        ("line", "--then is 'line': give PATH@SECONDS, and @here behind it"),
        ("@3", "give PATH@SECONDS, and @here"),
        ("line@3@there", "'there' is no time: give PATH@SECONDS"),
        ("line@-1", "'-1' is no time"),
        ("line@nan", "'nan' is no time"),
        ("line@60", "the run ends after 60 s: give an earlier time, or a longer --simulated-time"),
        (["line@9", "sine@9"], "the path before it takes over at 9 s: give later times in turn"),
        ("lime@9", "lime"),
        (("line", 3.0, "there"), "--then is line@3.0@there: give"),
        ((line(), None), "--then line@None: None is no time"),
        ([7], "--then is 7: give PATH@SECONDS"),
    ],
)
def test_what_is_refused_in_one_line(then: object, said: str) -> None:
    with pytest.raises(InputError) as refused:
        next_paths(then, 60.0)  # type: ignore[arg-type]
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_a_path_that_takes_over_is_moved_as_the_first_one_is() -> None:
    then = next_paths(["sine@1", "line@2@here"], 60.0)
    assert placed(line(), then, None, (1.0, 2.0, 3.0))[1] == then
    _, moved = placed(line(), then, "1,2,90", (9.0, 9.0, 9.0))
    assert moved[1] is then[1], "it begins where the robot then is"
    assert moved[0].path.points_m[0] == pytest.approx((1.0, 2.0), abs=1e-6)
    assert moved[0].path.tangent_rad[0] == pytest.approx(shape("sine").tangent_rad[0] + 1.5708, abs=1e-4)


def test_a_run_tells_which_paths_took_over(tmp_path: Path) -> None:
    run = fk.run(rig.small_table(), "line", then=["line@2@here", "line@30"], depth=1, time_limit_s=40.0)
    said = run.as_json()["then"]
    assert said[0] == {"path": "line", "from_s": pytest.approx(2 * rig.PERIOD_S, abs=1e-5)}
    assert len(said) in (1, 2)
    run.save(tmp_path / "run.h5")
    assert fk.load_run(tmp_path / "run.h5").as_json()["then"] == said


def test_the_command_says_what_it_did_not_reach(capsys: pytest.CaptureFixture[str]) -> None:
    done = frogkick(
        capsys, "run", "--robot", "pool", "--tables", rig.small_table(), "--depth", 1, "--json",
        "--then", "line@1", "--then", "sine@110",
    )  # fmt: skip
    assert done.code == 0
    assert [one["path"] for one in done.json["then"]] == ["line"]
    assert "1 of 2 paths of --then took over: the run had ended before the others (completed)" in done.stderr
