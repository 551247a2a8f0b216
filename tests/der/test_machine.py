"""The same bits on other processors: with narrower vectors, and without fused multiply-add."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
from tests.conftest import FULL

SCRIPT = """
import numpy as np
from frogkick.der import prepare, program_of, simulate_many
from frogkick.robot import load_robot
rods = prepare(load_robot("frog2022"))
robot = rods.robot
start = np.random.default_rng(1).uniform([0.0, -0.03, -0.5], [0.04, 0.03, 0.5], size=(8, 3))
programs = [program_of(robot, robot.actions[k]) for k in range(8)]
motions = simulate_many(rods, start, programs, [robot.period_s])
print(motions.pose_world.tobytes().hex(), motions.velocity_body.tobytes().hex())
"""


def simulated(processor: str, cache: Path) -> str:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    if processor:
        environment |= {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": ""}
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True
    )
    return run.stdout


@pytest.mark.skipif(not FULL, reason="compiles everything three times: make test-full")
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="names x86 processors")
@pytest.mark.parametrize("processor", ["x86-64", "haswell"])  # SSE2; AVX2 and FMA
def test_another_processor_computes_the_same_bits(processor: str, tmp_path: Path) -> None:
    assert simulated(processor, tmp_path / processor) == simulated("", tmp_path / "own")
