"""A library built on a real Dask cluster: the same bytes as here, whatever dies on the way."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.chunks.test_chunks import Cluster, kill_one, needs_distributed
from tests.conftest import count, from_ci
from tests.identification.made import robot

from frogkick.core.errors import FrogkickError
from frogkick.library import build_library

ROBOT = robot()
STATES, SEED = count(66, 100), 5  # half of them simulated, 4 parts or 3


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """The first test kills a worker of it, the second all."""
    running = Cluster(tmp_path_factory.mktemp("cluster"))
    yield running
    running.close()


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The library built in this process."""
    out = tmp_path_factory.mktemp("here") / "here.h5"
    build_library(ROBOT, STATES, SEED, 1, out, record_s=0.0)
    return out.read_bytes()


@from_ci
@needs_distributed
def test_a_killed_worker_changes_no_byte(cluster: Cluster, here: bytes, tmp_path: Path) -> None:
    reported: list[int] = []

    def kill_in_the_middle(done: int, _all: int) -> None:
        reported.append(done)
        if len(reported) == 2:  # the first part is done
            kill_one(cluster)

    out = tmp_path / "far.h5"
    build_library(ROBOT, STATES, SEED, 1, out, kill_in_the_middle, record_s=0.0, cluster=cluster.address)
    assert reported[0] == 0
    assert reported[-1] == STATES * 9
    assert out.read_bytes() == here
    cluster.workers += [cluster.add_worker() for _ in range(count(0, 1))]


@from_ci
@needs_distributed
def test_what_a_lost_cluster_had_finished_is_kept(cluster: Cluster, here: bytes, tmp_path: Path) -> None:
    out = tmp_path / "out.h5"

    def lose(done: int, _all: int) -> None:
        if done:
            cluster.close()

    with pytest.raises(FrogkickError, match="failed"):
        build_library(ROBOT, STATES, SEED, 1, out, lose, record_s=0.0, cluster=cluster.address)
    assert not out.exists()
    reported: list[int] = []
    build_library(ROBOT, STATES, SEED, 1, out, lambda done, _all: reported.append(done), record_s=0.0)
    assert reported[0] > 0
    assert out.read_bytes() == here
