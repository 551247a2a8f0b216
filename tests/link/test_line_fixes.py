"""Lines of a tracker become fixes; other lines are refused with their number."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np
import pytest

from frogkick.core.errors import InputError
from frogkick.runs.text_robot import fire_line, limb_numbers, pulse_line
from frogkick.runs.tracked_fixes import LineFixes, parse_line


@pytest.fixture
def pipe() -> Iterator[tuple[LineFixes, Callable[[bytes], None], Callable[[], None]]]:
    reading, writing = os.pipe()
    ends = [writing]

    def end() -> None:
        while ends:
            os.close(ends.pop())

    yield LineFixes(reading, "the pipe"), lambda data: os.write(writing, data) and None, end
    end()


def test_lines(
    pipe: tuple[LineFixes, Callable[[bytes], None], Callable[[], None]], capfd: pytest.CaptureFixture[str]
) -> None:
    fixes, write, end = pipe
    write(b"\xef\xbb\xbf# after a byte order mark\n\n0.1 0.2 3.5\n0.3, 0.4, -1, 0.5\n0.5 0.6")
    fixes.wait_first(120.0)
    taken = fixes.advance(100.0)
    while len(taken) < 2:
        taken += fixes.advance(100.0)
    first, second = taken
    assert first.pose_world == pytest.approx([0.1, 0.2, 3.5 - 2 * np.pi], abs=1e-6)
    assert first.pose_world.dtype == np.float32
    assert second.pose_world == pytest.approx([0.3, 0.4, -1.0], abs=1e-6)
    assert (first.sequence, second.sequence) == (0, 1)
    assert first.capture_s - second.capture_s == pytest.approx(0.5, abs=0.1)
    assert first.capture_s <= first.arrival_s == 100.0
    write(b" 0\nnan nan nan\n0 NaN 0 0.1\n0 0 0 5.0\n")  # the rest of a line; one that is too old
    while not (taken := fixes.advance(101.0)):
        pass
    assert taken[0].pose_world == pytest.approx([0.5, 0.6, 0.0]) and len(taken) == 1
    end()
    assert fixes.advance(102.0) == []
    assert fixes.next_event_s > 102.0
    deadline_s, output = time.monotonic() + 120.0, ""
    while not output and time.monotonic() < deadline_s:
        output = capfd.readouterr().err
    assert output == "the pipe has ended after 4 position fixes: no more will come from it\n"


def test_a_bad_line_is_named(pipe: tuple[LineFixes, Callable[[bytes], None], Callable[[], None]]) -> None:
    fixes, write, _ = pipe
    write(b"0 0 0\nhello\n")
    deadline_s = time.monotonic() + 120.0
    with suppress(InputError):
        while time.monotonic() < deadline_s:
            fixes.wait_first(1.0)
    with pytest.raises(InputError, match="the pipe line 2: 'hello' is not a position fix"):
        fixes.advance(1.0)


def test_no_fix(pipe: tuple[LineFixes, Callable[[bytes], None], Callable[[], None]]) -> None:
    fixes, _, end = pipe
    with pytest.raises(InputError, match=r"no position fix came from the pipe within 0.1 s: start"):
        fixes.wait_first(0.1)
    end()
    with pytest.raises(InputError, match=r"no position fix came from the pipe and it has ended: start"):
        fixes.wait_first(120.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2", "is not a position fix"),
        ("1 2 3 4 5", "is not a position fix"),
        ("nan 0 0", "x_m is nan"),
        ("0 inf 0", "y_m is inf"),
        ("0 1001 0", "y_m is 1001.0, allowed is -1000 to 1000: check the tracker's units"),
        ("0 0 nan", "heading_rad is nan"),
        ("0 0 0 -0.1", "age is -0.1 s"),
        ("0 0 0 80", "age is 80.0 s, allowed is 0 to 10: give it in seconds"),
        ("0 0 0 nan", "age is nan"),
    ],
)
def test_limits(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_line(text)


def test_the_authors_lines() -> None:
    assert pulse_line(80_000) == b"p 80\n"
    assert fire_line([1, 0]) == b"h 0 1\n" and fire_line([3]) == b"h 3\n"
    numbers = limb_numbers(["front_right", "front_left", "rear_left", "rear_right"])
    assert numbers == (1, 0, 2, 3)
    with pytest.raises(InputError, match="not 'tail'"):
        limb_numbers(["front_left", "tail"])
    with pytest.raises(InputError, match="80500 us, dialect frog2022 takes whole ms"):
        pulse_line(80_500)
