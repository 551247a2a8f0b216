"""Whatever image the C accepts, it plans with: nothing is read beside it, nothing overflows."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import LEVEL, count
from tests.planner import synthetic

from frogkick_codegen.native import planner_files
from frogkick_codegen.toolchain import other, zig

HERE = Path(__file__).parent
IMAGES = (
    synthetic.image(7, 2),
    synthetic.image(41, 5),
    synthetic.image(120, 1),
    synthetic.affine_image(1, 1),
    synthetic.affine_image(41, 5),
    synthetic.affine_image(41, 5, limb_wear=synthetic.wear_curves(4, 3, 1)),
    synthetic.affine_image(
        20, 2, limbs=3, action_rows=[("A", 7, 0), ("B", 1, 6)], history=np.ones((2, 3, 6)) * 1e-3
    ),
)
WAYS = {
    "zig": ["-fsanitize=undefined"],
    "gcc": ["-fsanitize=address,undefined,float-cast-overflow"],
}
NO_ADDRESSES = pytest.mark.skipif(
    sys.platform == "win32" or other("gcc") is None,
    reason="no gcc on this machine: no address sanitizer, zig brings that of undefined behaviour only",
)


@pytest.mark.parametrize("way", ["zig", pytest.param("gcc", marks=[NO_ADDRESSES, pytest.mark.extra])])
def test_what_is_accepted_is_planned_with(way: str, tmp_path: Path) -> None:
    driver = zig() if way == "zig" else other("gcc")
    assert driver is not None
    files = planner_files() | {"hostile_images.c": (HERE / "hostile_images.c").read_bytes()}
    files |= {f"{number}.fkt": image for number, image in enumerate(IMAGES)}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    words = ["-O0", "-fsanitize-trap=undefined"] if way == "zig" and LEVEL == "quick" else ["-O1", "-g"]
    sources = sorted(name for name in files if name.endswith(".c"))
    flags = ["-std=c99", "-ffp-contract=off", *WAYS[way], "-fno-sanitize-recover=all", *words]
    driver.run([*flags, "-o", "hostile", *sources, "-lm"], folder=tmp_path)
    images = count(20_000, 1_000_000, 3000)
    bases = sorted(name for name in files if name.endswith(".fkt"))
    run = subprocess.run(
        [str(tmp_path / "hostile"), "1", str(images), *bases],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, f"{run.returncode}: {run.stderr[-3000:]}"
    accepted, plans = map(int, run.stdout.split())
    print(f"{way}: {accepted} of {images} images accepted, {plans} plans")
    assert accepted > 0.2 * images
