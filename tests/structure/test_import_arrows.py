"""The import arrows of the architecture page (host/docs) hold, and the check finds what would break them."""

from __future__ import annotations

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from tests.conftest import REPOSITORY
from tests.structure.arrows import ARROWS, CODEGEN, STUDIES, c_arrows, circle, unknown, unused, violations
from tests.structure.wheel import repository_files

from frogkick.front.tables import MADE_BY


def plant(root: Path, files: dict[str, str]) -> list[str]:
    """Make a small tree of the real one's shape and return what breaks the arrows in it."""
    sound = {
        "host/frogkick/__init__.py": '__version__ = "0"\n',
        "host/frogkick/core/errors.py": "",
        "host/frogkick/planner/kernel.py": "import numba\nfrom frogkick.core.errors import InputError\n",
        "host/frogkick/library/build.py": "from ..tables import image\n",
        "host/frogkick/front/running.py": "from frogkick.planner import kernel\n",
        "host/frogkick/cli/run.py": "import frogkick as fk\nfrom frogkick.front.running import run\n",
        "codegen/frogkick_codegen/emit.py": "from frogkick import planner\n",
        "host/studies/frogkick_studies/loop.py": "import frogkick\nfrom frogkick.der import rods\n",
    }
    for name, text in {**sound, **files}.items():
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return violations(root)


def test_the_arrows_hold() -> None:
    assert violations(REPOSITORY) == []


def test_each_arrow_is_needed() -> None:
    """Else a room may come to import what it never did, and no row would change."""
    assert unused(REPOSITORY) == [(STUDIES, "__init__")]  # as a notebook may


def test_every_module_that_is_imported_exists(tmp_path: Path) -> None:
    assert unknown(REPOSITORY) == []
    late = "def f():\n    from frogkick.core.mistakes import InputError\n"
    plant(
        tmp_path,
        {"host/frogkick/der/mesh.py": late, "host/frogkick/der/rods.py": "from frogkick import der\n"},
    )
    assert unknown(tmp_path) == [
        f"{place} does not exist"
        for place in (
            "host/frogkick/der/mesh.py:2 frogkick.core.mistakes.InputError",
            "host/frogkick/library/build.py:1 frogkick.tables.image",
        )
    ]


def test_the_arrows_run_one_way() -> None:
    """Nothing imports cli, and no two rooms may import each other, directly or round a corner."""
    assert not any("cli" in allowed for allowed in ARROWS.values())
    reach = {room: set(allowed) for room, allowed in ARROWS.items()}
    for _ in ARROWS:
        for seen in reach.values():
            seen |= {far for near in seen for far in reach[near]}
    assert [room for room, seen in reach.items() if room in seen] == []


def test_kept_tables_are_told_apart_by_all_code_that_makes_them() -> None:
    makers, package = {"library"}, REPOSITORY / "host/frogkick"
    for _ in ARROWS:
        for room in sorted(makers):
            for file in (package / room).glob("*.py"):
                makers |= set(
                    re.findall(r"(?:from|import) frogkick\.(\w+)", file.read_text(encoding="utf-8"))
                )
    assert makers == set(MADE_BY)


def test_a_sound_tree_has_no_violation(tmp_path: Path) -> None:
    assert plant(tmp_path, {}) == []


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("host/frogkick/robot/load.py", "\nfrom frogkick.der import mesh\n", ":2 robot imports der"),
        ("host/frogkick/der/mesh.py", "import frogkick.library.store\n", ":1 der imports library"),
        ("host/frogkick/der/mesh.py", "from frogkick import library\n", ":1 der imports library"),
        ("host/frogkick/der/deep/mesh.py", "from ...runs import replay\n", ":1 der imports runs"),
        ("host/frogkick/der/mesh.py", "from .. import runs\n", ":1 der imports runs"),
        ("host/frogkick/pool/pool.py", "def f():\n    import frogkick_codegen.emit\n", ":2 pool imports"),
        (
            "host/frogkick/runs/run.py",
            "import importlib\nimportlib.import_module('frogkick.cli')\n",
            ":2 runs",
        ),
        ("host/frogkick/ring.py", "from frogkick.report import page\n", ":1 ring imports report"),
        ("host/frogkick/report/page.py", "from frogkick.cli.main import app\n", ":1 report imports cli"),
        ("host/frogkick/tables/image.py", "import h5py\n", ":1 tables imports h5py"),
        ("host/frogkick/paths/path.py", "import h5py\n", ":1 paths imports h5py"),
        ("host/frogkick/paths/path.py", "from frogkick.planner import image\n", ":1 paths imports planner"),
        ("host/frogkick/link/frames.py", "import numpy as np\n", ":1 link imports numpy"),
        (
            "host/frogkick/core/errors.py",
            "from frogkick.core.files import x\nimport frogkick.robot\n",
            ":2 core imports",
        ),
        ("codegen/frogkick_codegen/emit.py", "from frogkick.library import store\n", f":1 {CODEGEN} imports"),
        ("host/frogkick/vision/tag.py", "import scipy\n", ":1 vision imports scipy"),
        ("host/frogkick/vision/tag.py", "from frogkick.pool import camera\n", ":1 vision imports pool"),
        (
            "host/frogkick/cli/run.py",
            "def f():\n    from frogkick.validation import sweep\n",
            ":2 cli imports validation",
        ),
        ("host/frogkick/cli/run.py", "if x:\n    from ..robot import Robot\n", ":2 cli imports robot"),
        ("host/frogkick/cli/run.py", "import frogkick_codegen.emit\n", f":1 cli imports {CODEGEN}"),
        ("host/frogkick/der/mesh.py", "import frogkick\n", ":1 der imports __init__"),
        (
            "codegen/frogkick_codegen/emit.py",
            "from frogkick import __version__\n",
            f":1 {CODEGEN} imports __version__ of the front door",
        ),
        ("host/frogkick/radio/tag.py", "import numpy\n", ":1 'radio' has no row"),
        ("host/studies/frogkick_studies/loop.py", "import frogkick.cli.app\n", ":1 studies imports cli"),
        ("host/frogkick/front/gaits.py", "import frogkick_studies.loop\n", ":1 front imports studies"),
    ],
)
def test_a_wrong_import_is_found(tmp_path: Path, name: str, text: str, found: str) -> None:
    lines = plant(tmp_path, {name: text})
    assert len(lines) == 1, lines
    assert lines[0].startswith(name + found), lines


def test_files_import_each_other_in_no_circle() -> None:
    assert circle(REPOSITORY) == []


@pytest.mark.parametrize(
    "back",
    ["from frogkick.der.mesh import Mesh\n", "def f():\n    from .mesh import Mesh\n",
     "if TYPE_CHECKING:\n    import frogkick.der.mesh\n", "from frogkick.der import mesh\n"],
)  # fmt: skip
def test_a_circle_of_files_is_found(tmp_path: Path, back: str) -> None:
    files = {
        "host/frogkick/der/mesh.py": "from frogkick.der import rods\n",
        "host/frogkick/der/rods.py": "from frogkick.der.water import drag\n",
        "host/frogkick/der/water.py": "import math\n",
    }
    assert plant(tmp_path, files) == [] and circle(tmp_path) == []
    (tmp_path / "host/frogkick/der/water.py").write_text(back)
    found = circle(tmp_path)
    assert found[0] == found[-1]
    assert set(found) == {f"frogkick.der.{name}" for name in ("mesh", "rods", "water")}


C_FOLDERS = ("firmware/core", "codegen/frogkick_codegen/planner")


def test_c_files_lean_on_each_other_in_no_circle() -> None:
    files = {
        path.name: path.read_text() for folder in C_FOLDERS for path in (REPOSITORY / folder).glob("*.c")
    }
    arrows = c_arrows(files)
    assert {"fk_commands.c", "fk_events.c"} <= arrows["fk_link.c"] | arrows["fk_robot.c"], "calls are found"
    assert sum(map(len, arrows.values())) > 50
    order = list(TopologicalSorter(arrows).static_order())
    assert order[-1] == "fk_link.c", "nothing calls it but the port"


def test_a_circle_is_found() -> None:
    files = {
        "a.c": "void fk_a(void)\n{\n    fk_b();\n}\n",
        "b.c": "/* fk_none() */\nvoid fk_b(void) { fk_c(1); }\n",
        "c.c": "static void in(void);\nint32_t fk_c(int32_t one)\n{\n    return one ? 0 : (fk_a(), 1);\n}\n",
    }
    with pytest.raises(CycleError):
        TopologicalSorter(c_arrows(files)).prepare()


def test_ports_do_not_look_into_the_robot() -> None:
    """They give it its memory, and know its functions alone."""
    public = (REPOSITORY / "firmware/core/fk_robot.h").read_text()
    assert "struct fk_robot {" not in public
    ports = [file for file in repository_files() if file.startswith("firmware/") and file.endswith("/main.c")]
    assert len(ports) >= 2
    for port in ports:
        text = (REPOSITORY / port).read_text()
        assert re.findall(r"\brobot(?:\.|->)\w+", text) == []
        called = set(re.findall(r"\b(fk_robot_\w+)\(", text))
        assert called and all(f" {name}(" in public for name in called)


SAME_BITS = ("core", "der", "effects", "estimator", "library", "paths", "planner", "pool", "robot", "tables")


def of_blas(text: str) -> list[int]:
    """Lines with a product or a solution whose last bits depend on the processor."""
    return [
        node.lineno
        for node in ast.walk(ast.parse(text))
        if (isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult))
        or (isinstance(node, ast.Attribute) and node.attr in ("linalg", "dot", "inner", "tensordot"))
    ]


def test_no_room_that_makes_tables_or_runs_leaves_its_bits_to_blas() -> None:
    """BLAS has kernels for each kind of processor; products of whole numbers are the same by each."""
    whole = {"tables/coding.py": 3, "tables/image.py": 1}  # products of int64 arrays
    found = {
        str(file.relative_to(REPOSITORY / "host/frogkick")): len(lines)
        for room in SAME_BITS
        for file in (REPOSITORY / "host/frogkick" / room).rglob("*.py")
        if (lines := of_blas(file.read_text(encoding="utf-8")))
    }
    assert found == whole
    assert sorted(of_blas("a @ b\nnp.linalg.solve(a, b)\nnp.dot(a, b)\ndot(a, b)\n")) == [1, 2, 3]
