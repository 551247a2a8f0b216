"""A library built on a real Dask cluster: the same bytes as here, whatever dies on the way."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.chunks.test_chunks import Cluster, kill_one, needs_distributed

from frogkick.errors import FrogkickError
from frogkick.library import build_library
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
STATES, SEED = 100, 5  # 50 simulated, 4 parts


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    (tmp_path / "cluster").mkdir()
    running = Cluster(tmp_path / "cluster")
    yield running
    running.close()


@needs_distributed
def test_a_killed_worker_changes_no_byte(cluster: Cluster, tmp_path: Path) -> None:
    told: list[int] = []

    def kill_in_the_middle(done: int, _all: int) -> None:
        told.append(done)
        if len(told) == 2:  # one of four parts is done
            kill_one(cluster)

    out = tmp_path / "far.h5"
    build_library(ROBOT, STATES, SEED, 1, out, kill_in_the_middle, record_s=0.0, cluster=cluster.address)
    assert told[0] == 0
    assert told[-1] == STATES * 9
    build_library(ROBOT, STATES, SEED, 1, tmp_path / "here.h5", record_s=0.0)
    assert out.read_bytes() == (tmp_path / "here.h5").read_bytes()


@needs_distributed
def test_what_a_lost_cluster_had_finished_is_kept(cluster: Cluster, tmp_path: Path) -> None:
    out = tmp_path / "out.h5"

    def lose(done: int, _all: int) -> None:
        if done:
            cluster.close()

    with pytest.raises(FrogkickError, match="failed"):
        build_library(ROBOT, STATES, SEED, 1, out, lose, record_s=0.0, cluster=cluster.address)
    assert not out.exists()
    told: list[int] = []
    build_library(ROBOT, STATES, SEED, 1, out, lambda done, _all: told.append(done), record_s=0.0)
    assert told[0] > 0
    build_library(ROBOT, STATES, SEED, 1, tmp_path / "here.h5", record_s=0.0)
    assert out.read_bytes() == (tmp_path / "here.h5").read_bytes()
