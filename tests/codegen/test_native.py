"""The C on this machine: images, angles, neighbours, and how it is built."""

from __future__ import annotations

import multiprocessing
import platform
import re
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.conftest import count, from_ci
from tests.planner import synthetic

from frogkick.core.errors import InputError
from frogkick.core.files import cache_folder
from frogkick.core.shared_library import load
from frogkick.planner import floats, kernel
from frogkick.planner.plan import PlanConfig, plan_batch
from frogkick.tables import layout
from frogkick.tables.image import TableError, open_image
from frogkick_codegen import toolchain
from frogkick_codegen.native import NativeLibrary, build_shared, planner_files
from frogkick_codegen.toolchain import FLAGS, ToolchainError

IMAGE = synthetic.image(states=41, actions=5)
PATH = synthetic.wave_path()


@pytest.fixture(scope="module")
def library() -> NativeLibrary:
    return NativeLibrary()


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder of the test's own; zig keeps its shared one, which takes seconds to fill."""
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", str(cache_folder("zig")))
    monkeypatch.setenv("ZIG_LOCAL_CACHE_DIR", str(cache_folder("zig")))
    monkeypatch.setenv("FROGKICK_CACHE_DIR", str(tmp_path))
    return tmp_path


def header_numbers() -> dict[str, int]:
    """Return the error codes of fk_tables.h."""
    text = planner_files()["fk_tables.h"].decode()
    return {name: int(value) for name, value in re.findall(r"\b(FK_(?:OK|ERROR_\w+)) = (-?\d+)", text)}


def test_the_twin_has_the_header_s_error_codes_and_limits() -> None:
    numbers = header_numbers()
    assert len(numbers) == len(set(numbers.values())) == 28
    ours = {name: value for name, value in vars(kernel).items() if name.startswith("ERROR_")}
    assert len(ours) == 7
    for name, value in ours.items():
        assert numbers[f"FK_{name}"] == value
    text = "".join(planner_files()[name].decode() for name in ("fk_tables.h", "fk_planner.h"))
    limits = dict(re.findall(r"#define (FK_\w+) ([-+.\w]+)", text))
    assert int(limits["FK_VELOCITY_CODE_MAX"]) == layout.VELOCITY_CODE_MAX
    assert int(limits["FK_MOTION_CODE_MAX"]) == layout.MOTION_CODE_MAX
    assert int(limits["FK_FORMAT_VERSION"].rstrip("U")) == layout.FORMAT_VERSION
    assert int(limits["FK_IMAGE_HEADER_BYTES"].rstrip("U")) == layout.HEADER_BYTES
    assert int(limits["FK_TREE_LEVELS_MAX"].rstrip("U")) == layout.TREE_LEVELS_MAX
    assert int(limits["FK_BLOCK_LEVELS_MAX"].rstrip("U")) == layout.BLOCK_LEVELS_MAX
    assert int(limits["FK_COEFFICIENTS"].rstrip("U")) == layout.COEFFICIENTS
    assert int(limits["FK_LIMB_USE_MAX"].rstrip("U")) == layout.USE_MAX
    assert int(limits["FK_PATH_POINTS_MAX"].rstrip("U")) == kernel.PATH_POINTS_MAX
    assert int(limits["FK_DEPTH_MAX"].rstrip("U")) == kernel.DEPTH_MAX
    assert np.float32(limits["FK_SCALE_MIN"].rstrip("f")) == np.float32(layout.SCALE_MIN)
    assert np.float32(limits["FK_SCALE_MAX"].rstrip("f")) == np.float32(layout.SCALE_MAX)


def test_the_c_refuses_a_damaged_image_with_its_code(library: NativeLibrary) -> None:
    assert library.open_status(IMAGE) == 0
    damaged = bytearray(IMAGE)
    damaged[300] ^= 1
    with pytest.raises(TableError, match=r"fk_error_t -25"):
        library.plan_batch(bytes(damaged), PATH, PlanConfig(), np.zeros((1, 6)))


def test_the_crc_is_zlib_s(library: NativeLibrary) -> None:
    for content in (b"", b"123456789", bytes(range(256)) * 3):
        assert library.crc32(content) == zlib.crc32(content)
        assert library.crc32(content[5:], zlib.crc32(content[:5])) == zlib.crc32(content)


def test_sine_and_cosine_have_the_twin_s_bits_and_float32_accuracy(library: NativeLibrary) -> None:
    rng = np.random.default_rng(13)
    angles = np.concatenate(
        [
            np.linspace(-np.pi, np.pi, count(100_000, 1_000_000, 20_000)),
            rng.uniform(-2100, 2100, count(100_000, 1_000_000, 20_000)),
            np.arange(-1336, 1337) * np.pi / 2,
            10.0 ** rng.uniform(-45, 0, 1000),
            [0.0, -0.0, 2100.0, -2100.0],
        ]
    ).astype(np.float32)
    sines, cosines = library.sincos(angles)
    assert np.abs(sines - np.sin(angles.astype(float))).max() <= 1.6 * 2**-24
    assert np.abs(cosines - np.cos(angles.astype(float))).max() <= 1.6 * 2**-24
    some = np.concatenate([angles[:: count(101, 11)], angles[-1004:]])
    some = np.concatenate([some, np.array([2100.2, np.inf, -np.inf, np.nan], dtype=np.float32)])
    twin = np.array([floats.sincos(angle) for angle in some], dtype=np.float32)
    native = np.stack(library.sincos(some), axis=1)
    np.testing.assert_array_equal(np.isnan(native), np.isnan(twin))
    numbers = ~np.isnan(native)
    np.testing.assert_array_equal(native.view(np.uint32)[numbers], twin.view(np.uint32)[numbers])


@given(st.floats(width=32))
def test_wrapped_angles_have_the_twin_s_bits(library: NativeLibrary, angle: float) -> None:
    native = library.wrap_angle([angle])[0]
    twin = np.float32(floats.wrap_angle(np.float32(angle)))
    assert native.tobytes() == twin.tobytes() or (np.isnan(native) and np.isnan(twin))


def test_the_tree_finds_the_exact_neighbour_and_the_lowest_row_of_a_tie(library: NativeLibrary) -> None:
    tables = synthetic.grid_tables(states=700)
    rng = np.random.default_rng(14)
    low, high = tables.states.min(axis=0) - 900, tables.states.max(axis=0) + 900
    codes = rng.integers(low, high, (count(8000, 80000, 2000), 3))
    codes[::2] = codes[::2] // 400 * 400
    codes[:50] = rng.choice([-16383, 16383], (50, 3))
    states = np.zeros((len(codes), 6))
    states[:, 3:] = codes * tables.velocity_scale.astype(float)
    rows = library.plan_batch(tables.image, PATH, PlanConfig(), states)
    edge = np.clip(
        codes, tables.states.min(axis=0), tables.states.max(axis=0)
    )  # a velocity beyond counts as there
    distance2 = ((tables.states.astype(np.int64)[None] - edge[:, None]) ** 2).sum(axis=2)
    ties = (distance2 == distance2.min(axis=1, keepdims=True)).sum(axis=1)
    assert (ties > 1).sum() > 500
    np.testing.assert_array_equal(rows["nearest_state"], distance2.argmin(axis=1))


def test_shapes_that_do_not_fit_are_refused(library: NativeLibrary) -> None:
    with pytest.raises(InputError, match=r"\(3, 5\)"):
        library.plan_batch(IMAGE, PATH, PlanConfig(), np.zeros((3, 5)))
    with pytest.raises(InputError, match="depths"):
        library.plan_batch(IMAGE, PATH, PlanConfig(), np.zeros((3, 6)), [1, 2])


@pytest.mark.parametrize(
    "config",
    [
        *(PlanConfig(depth=depth) for depth in (-1, 0, 5, 257)),
        PlanConfig(level_weight=-0.0),
        PlanConfig(progress_weight=float("inf")),
    ],
)
def test_unusable_configurations_have_one_status_in_both(library: NativeLibrary, config: PlanConfig) -> None:
    states = np.zeros((1, 6))
    ours = plan_batch(open_image(IMAGE), PATH, config, states)
    assert ours["status"][0] < 0
    assert library.plan_batch(IMAGE, PATH, config, states).tobytes() == ours.tobytes()


@pytest.mark.parametrize("kind", ["affine", "nearest"])
@pytest.mark.parametrize("depth", [1, 3])
def test_plans_with_worn_limbs_are_alike_in_both(library: NativeLibrary, kind: str, depth: int) -> None:
    curves = synthetic.wear_curves(4, 8, 7)
    image = (
        synthetic.affine_image(60, 5, limb_wear=curves)
        if kind == "affine"
        else synthetic.pack(*synthetic.transitions(60, 5, 1), limb_wear=curves)
    )
    lost = [0, 30000, 32767, 9000]
    tables, states = open_image(image), np.random.default_rng(8).normal(0.0, 0.05, (count(200, 5000), 6))
    config = PlanConfig(depth=depth)
    ours = plan_batch(tables.worn(lost), PATH, config, states)
    assert (ours["cost"] != plan_batch(tables, PATH, config, states)["cost"]).mean() > 0.9
    given = [*lost, 0, 0, 0, 0]
    assert library.plan_batch(image, PATH, config, states, lost=given).tobytes() == ours.tobytes()


@pytest.mark.parametrize("points", [1, 2, 100, 101, 65538])
def test_every_count_of_path_points_has_one_status_in_both(library: NativeLibrary, points: int) -> None:
    route, states = synthetic.wave_path(points), np.zeros((1, 6))
    ours = plan_batch(open_image(IMAGE), route, PlanConfig(), states)
    assert (ours["status"][0] == 0) == (2 <= points <= 100)
    assert library.plan_batch(IMAGE, route, PlanConfig(), states).tobytes() == ours.tobytes()


def _build(number: int) -> str:
    """Build one small library in another process."""
    source = b"int fk_answer(void);\nint fk_answer(void) { return 42; }\n"
    return build_shared("race", {"race.c": source}).name


@from_ci
def test_two_processes_may_build_at_once_and_content_is_built_once(own_cache: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(2) as pool:  # which inherits the environment
        names = pool.map(_build, [0, 1], chunksize=1)
    assert names[0] == names[1]
    built = [entry.name for entry in (own_cache / "native").iterdir() if entry.suffix == ".so"]
    assert built == [names[0]]


def test_a_cached_library_is_not_built_again(own_cache: Path) -> None:
    source = {"a.c": b"int fk_a(void);\nint fk_a(void) { return 1; }\n"}
    first = build_shared("a", source)
    stamp = first.stat().st_mtime_ns
    assert build_shared("a", source).stat().st_mtime_ns == stamp
    other = build_shared("a", {"a.c": source["a.c"].replace(b"1", b"2")})
    assert other != first


def test_a_change_of_one_character_is_compiled(own_cache: Path) -> None:
    """Builds share a folder, where the compiler itself decides what is old."""
    header, caller = (
        b"int fk_a(void);\n",
        b'#include "a.h"\nint fk_b(void);\nint fk_b(void) { return fk_a(); }\n',
    )
    for answer in (b"1", b"2", b"3", b"1"):
        source = b'#include "a.h"\nint fk_a(void) { return ' + answer + b"; }\n"
        files = {"a.c": source, "b.c": caller, "a.h": header + b"#define ANSWER " + answer + b"\n"}
        assert load(build_shared("a", files))[1].fk_b() == int(answer)
        files["a.c"] = source.replace(b"return " + answer, b"return ANSWER + 3")
        assert load(build_shared("a", files))[1].fk_b() == int(answer) + 3


def test_a_missing_compiler_wheel_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ziglang", None)
    with pytest.raises(ToolchainError, match=r"'ziglang', which is not installed: pip install 'frogkick\[f"):
        toolchain.zig()


def test_unknown_targets_and_compilers_are_refused() -> None:
    with pytest.raises(ToolchainError, match=r"'chips' is not one of host, chip \(did you mean 'chip'\?\)"):
        toolchain.zig("chips")
    with pytest.raises(ToolchainError, match="'gc' is not known"):
        toolchain.other("gc")


def test_a_refused_source_names_the_place(own_cache: Path) -> None:
    with pytest.raises(ToolchainError, match=r"bad\.c:1:"):
        build_shared("bad", {"bad.c": b"int fk_bad(void) { return 1; }\n"})  # no prototype
    assert not list((own_cache / "native").glob("bad*"))


def test_a_folder_that_cannot_be_a_cache_is_said_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("x")
    monkeypatch.setenv("FROGKICK_CACHE_DIR", str(blocker / "cache"))
    with pytest.raises(InputError, match="set it to a folder that can be written"):
        cache_folder()


def test_without_a_home_things_are_kept_where_nobody_else_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("FROGKICK_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "c.txt" / "nobody"))
    (tmp_path / "c.txt").write_text("a file, no folder")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    kept = cache_folder("native")
    assert kept.parent.parent == tmp_path.resolve() and kept.parent.stat().st_mode & 0o777 == 0o700
    assert cache_folder("native") == kept
    kept.parent.chmod(0o777)  # what is loaded as code from there could be anybody's
    with pytest.raises(InputError, match="not a folder of this user alone"):
        cache_folder("native")


@pytest.mark.extra
@pytest.mark.skipif(platform.machine() != "x86_64", reason="asks for an x86 instruction")
def test_a_build_that_fuses_is_refused_when_it_runs() -> None:
    gcc = toolchain.other("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed")
    if " fma " not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this processor has no fused multiply-add")
    fusing = toolchain.Compiler(gcc.name, gcc.command, ("-mfma", "-ffp-contract=fast"), gcc.version)
    flags = [flag for flag in FLAGS if not flag.startswith("-ffp-contract")]
    files = dict(planner_files())
    library = NativeLibrary(files, fusing, flags)
    assert library.open_status(IMAGE) == header_numbers()["FK_ERROR_FLOAT_RULES"]


def test_fast_math_does_not_compile() -> None:
    with pytest.raises(ToolchainError, match="without -ffast-math"):
        NativeLibrary(flags=[*FLAGS, "-ffast-math"])
