"""What has the same bits on other processors, and what agrees to a number of digits."""

from __future__ import annotations

import contextlib
import io
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import FULL, REPOSITORY, count, from_ci

RODS = """
import numpy as np
from frogkick.der import prepare
from frogkick.effects.acting import program_of
from frogkick.effects.swims import simulate_many
from frogkick.robot import load_robot
rods = prepare(load_robot("frog2022"))
robot = rods.robot
start = np.random.default_rng(1).uniform([0.0, -0.03, -0.5], [0.04, 0.03, 0.5], size=(8, 3))
programs = [program_of(robot, robot.actions[k]) for k in range(8)]
motions = simulate_many(rods, start, programs, [robot.period_s])
print(motions.pose_world.tobytes().hex(), motions.velocity_body.tobytes().hex())
"""
TWIN = """
import hashlib
from frogkick.tables.image import open_image
from frogkick.planner.plan import PlanConfig
from frogkick_codegen.parity import make_cases, python_place
from tests.planner import synthetic
tables, path = open_image(synthetic.image()), synthetic.wave_path()
cases = make_cases(tables, path, 1000, 2022)
rows = python_place(tables, path, PlanConfig())(
    cases.states, cases.depths, cases.limb_use, cases.along_points
)
print(hashlib.sha256(cases.states.tobytes() + rows.tobytes()).hexdigest())
"""
ROWS = """
import numpy as np
from frogkick.library import fit_table, sample_library
from frogkick.robot import load_robot
robot = load_robot("frog2022")
for sampling in ("visited", "planned"):
    print(sample_library(robot, 24, 3, sampling).rows().astype(np.float64).tobytes().hex())
"""
LIBRARY = f"""{ROWS}
print(fit_table(sample_library(robot, 60, 1, "box"), "affine").image.hex())
"""
OTHER_LINEAR_ALGEBRA = {"OPENBLAS_CORETYPE": "Prescott"}
OTHER_MACHINES = {
    "linear algebra": OTHER_LINEAR_ALGEBRA,
    "sine of the C library": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable"},
    "sine of numpy": {"NPY_DISABLE_CPU_FEATURES": "X86_V4 X86_V3"},
}
"""What another x86-64 processor would choose, as this one can be told to."""

x86_only = pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="names x86 processors")


def said(script: str, changed: dict[str, str]) -> str:
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        env={**os.environ, **changed}, cwd=REPOSITORY, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return run.stdout


def said_here(script: str) -> str:
    """What the script prints in this process, which has loaded its packages already."""
    reported = io.StringIO()
    with contextlib.redirect_stdout(reported):
        exec(script, {})
    return reported.getvalue()


def simulated(script: str, processor: str, cache: Path) -> str:
    changed = {"NUMBA_CACHE_DIR": str(cache)}
    if processor:
        changed |= {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": ""}
    return said(script, changed)


@pytest.mark.skipif(not FULL, reason="compiles everything three times: make test-full")
@x86_only
@pytest.mark.parametrize("script", [RODS, TWIN], ids=["rods", "twin"])
@pytest.mark.parametrize("processor", ["x86-64", "haswell"])  # SSE2; AVX2 and FMA
def test_another_processor_computes_the_same_bits(script: str, processor: str, tmp_path: Path) -> None:
    assert simulated(script, processor, tmp_path / processor) == simulated(script, "", tmp_path / "own")


@from_ci
@x86_only
def test_the_planner_has_the_same_bits_with_any_library_beneath_it() -> None:
    """The planner in Python; tests/codegen compares it with the C of every compiler and on the chip."""
    own = said_here(TWIN)
    machines = OTHER_MACHINES
    if count(len(machines), len(machines), 1) == 1:
        machines = {"all at once": {key: value for one in machines.values() for key, value in one.items()}}
    assert {name: said(TWIN, changed) for name, changed in machines.items()} == dict.fromkeys(machines, own)


@from_ci
@x86_only
def test_a_library_and_its_table_have_the_same_bits_with_other_linear_algebra() -> None:
    """Also without AVX-512. On a processor without FMA, from before 2013, sines have other last bits."""
    own = said_here(LIBRARY)
    assert said(LIBRARY, {**OTHER_LINEAR_ALGEBRA, "NPY_DISABLE_CPU_FEATURES": "X86_V4"}) == own
    old = {**OTHER_MACHINES["sine of the C library"], **OTHER_MACHINES["sine of numpy"]}
    one, other = (np.frombuffer(bytes.fromhex("".join(text.split()[:2]))) for text in (own, said(ROWS, old)))
    assert one.size > 2000
    assert np.abs(other - one).max() < 1e-8 * np.abs(one).max()
