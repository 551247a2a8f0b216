"""The generated files are what the one layout says today, and its numbers are the planner's."""

from __future__ import annotations

import re

import pytest
from tests.conftest import REPOSITORY

from frogkick.core.weights import COSTS, WEIGHTS
from frogkick.link.layout import link_layout
from frogkick.planner.plan import Cost
from frogkick_codegen import frames
from frogkick_codegen.native import planner_files

RUN = "run: python -m frogkick_codegen.frames"


def test_the_header_is_up_to_date() -> None:
    assert frames.HEADER.read_text(encoding="utf-8") == frames.layout_header(), RUN


def test_the_planner_s_weights_are_up_to_date() -> None:
    text = frames.PLANNER_HEADER.read_text(encoding="utf-8")
    assert frames.planner_header(text) == text, RUN
    assert {name.upper() for name in WEIGHTS} <= link_layout().parameter.keys()
    assert {cost.name.lower(): cost.value for cost in Cost} == {name: n for n, name in enumerate(COSTS)}


def test_the_documentation_has_every_frame() -> None:
    page = (REPOSITORY / "host/docs/pages/reference/link.md").read_text(encoding="utf-8")
    gaps = {"{{ link_frames }}", "{{ link_numbers }}", "{{ log_records }}", "{{ supervisor }}"}
    assert gaps <= set(page.splitlines())
    layout, numbers = link_layout(), "\n".join(frames.number_tables())
    assert all(f"| {name} |" in frames.layout_table() for name in layout.messages)
    assert all(f"### {name}\n" in "\n".join(frames.field_tables()) for name in layout.messages)
    for named in ("status", "state", "fault", "reset", "supply", "owner", "parameter", "learn"):
        assert f"### `{named}`\n" in numbers
        assert all(f"| {number} | {name} |" in numbers for name, number in getattr(layout, named).items())


def test_statuses_are_the_planner_s_errors_and_never_collide() -> None:
    header = planner_files()["fk_tables.h"].decode()
    errors = {name: int(value) for name, value in re.findall(r"FK_ERROR_(\w+) = (-\d+)", header)}
    status = link_layout().status
    shared = set(errors) & set(status)
    assert shared == {"NOT_FINITE", "RANGE", "DEPTH", "WEIGHT", "PATH_COUNT", "PATH_POINT"}
    for name in shared:
        assert status[name] == errors[name]
    own = {number for name, number in status.items() if name not in shared and name != "OK"}
    assert not own & set(errors.values())
    assert all(-128 <= number <= 0 for number in (*status.values(), *errors.values())), "they travel as i8"


@pytest.mark.parametrize("message", link_layout().messages.values(), ids=link_layout().messages)
def test_sizes_in_the_header_are_those_of_the_host(message: object) -> None:
    text = frames.HEADER.read_text(encoding="utf-8")
    for kind in ("command", "answer", "event"):
        payload = getattr(message, kind)
        if payload is not None:
            define = f"#define FK_{message.name}_{kind.upper()}_BYTES {payload.bytes}u"
            assert define in text
