"""Before a robot is armed: what is refused, and what is not."""

from __future__ import annotations

import numpy as np
import pytest
from tests.conftest import REPOSITORY

from frogkick.cli.lab import Sight, parse_begin
from frogkick.errors import InputError
from frogkick.loop.start_checks import check_start, look
from frogkick.paths import shape
from frogkick.pool.camera import Fix

POOL_M = (1.2, 0.9)


def fixes(*places: tuple[float, float]) -> list[Fix]:
    return [Fix(k, 0.1 * k, 0.1 * k, np.array([*xy, 0.3], dtype=np.float32)) for k, xy in enumerate(places)]


AT_REST = fixes(*[(0.3, 0.4)] * 10)
LINE = Sight("stdin", begin="0.3,0.4,20").placed(shape("line"), (0.0, 0.0, 0.0))


def test_a_robot_on_its_path_in_the_pool_may_swim() -> None:
    assert check_start(AT_REST, LINE, POOL_M) == [
        "position fixes: 10 in 1 s, at most 0.0 mm apart",
        "path: inside the pool, 0 mm from the robot",
        "battery: not measured by this robot (host/FIRST_DAY.md: how to, by hand)",
    ]
    assert "not looked at, the pool's size is not known" in check_start(AT_REST, LINE, None)[1]


def test_what_the_start_check_says_of_batteries_the_first_day_explains() -> None:
    """No firmware here has a pin for it: the page has to say how a person does it."""
    page = (REPOSITORY / "host/FIRST_DAY.md").read_text(encoding="utf-8")
    assert "battery: not measured by this robot" in page and "11.1 V" in page
    assert not any(
        "saadc" in file.read_text("utf-8").lower() for file in (REPOSITORY / "firmware").rglob("*.[ch]")
    )


@pytest.mark.parametrize(
    ("seen", "path", "complaint"),
    [
        (AT_REST[:1], LINE, r"1 position fixes came in 1 s, 2 are needed"),
        (fixes((0.3, 0.4), (0.3, 0.4), (0.35, 0.4)), LINE, r"jump by 50 mm while the robot rests, 20 are"),
        (AT_REST, shape("line"), r"path reaches from \(0\.00, .* the pool is 1\.2 x 0\.9 m"),
        (fixes(*[(1.0, 0.8)] * 3), LINE, r"the robot is 0\.[0-9]+ m from its path, 0\.3 are allowed"),
    ],
)
def test_what_can_only_fail_is_refused(seen: list[Fix], path: object, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        check_start(seen, path, POOL_M)


@pytest.mark.parametrize("name", ["line", "sine", "ellipse"])
def test_a_path_begins_where_and_as_it_is_told(name: str) -> None:
    path = Sight("stdin", begin="0.5,0.2,90").placed(shape(name), (9.0, 9.0, 9.0))
    assert path.points_m[0] == pytest.approx([0.5, 0.2], abs=1e-6)
    assert float(path.tangent_rad[0]) == pytest.approx(np.pi / 2.0, abs=1e-6)
    assert path.length_m == pytest.approx(shape(name).length_m, rel=1e-5)
    here = Sight("stdin", begin="here").placed(shape(name), (0.1, 0.3, -1.0))
    assert here.points_m[0] == pytest.approx([0.1, 0.3], abs=1e-6)
    assert float(here.tangent_rad[0]) == pytest.approx(-1.0, abs=1e-6)
    same = Sight("stdin").placed(shape(name), (0.1, 0.3, -1.0))
    assert np.array_equal(same.points_m, shape(name).points_m)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "a,b,c", "nan,0,0", "1e9,0,0"])
def test_where_a_path_begins_must_be_three_numbers(text: str) -> None:
    with pytest.raises(InputError, match="--begin is"):
        parse_begin(text)
    with pytest.raises(InputError, match="--begin is"):
        Sight("stdin", begin=text)


def test_a_look_takes_what_comes_in_a_second() -> None:
    now_s = [0.0]

    class Source:
        def advance(self, until_s: float) -> list[Fix]:
            return AT_REST[:1]

    def wait(seconds: float) -> None:
        now_s[0] += seconds

    assert 95 <= len(look(Source(), lambda: now_s[0], wait)) <= 105
