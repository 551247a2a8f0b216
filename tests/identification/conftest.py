"""Runs that several files of tests share."""

from __future__ import annotations

import pytest
from made import WORN, make_swim

from frogkick.identification.segments import Segments


@pytest.fixture(scope="module")
def worn() -> list[Segments]:
    return [make_swim([WORN], seed, 14) for seed in (1, 2)]


@pytest.fixture(scope="module")
def whole() -> list[Segments]:
    return [make_swim([], seed, 14) for seed in (3, 4)]
