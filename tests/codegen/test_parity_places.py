"""The same bits in every place, for both kinds of table: Python, zig's clang, gcc, the virtual chip."""

from __future__ import annotations

import dataclasses
import shutil
from functools import cached_property
from pathlib import Path

import pytest
from tests.codegen import made_up
from tests.conftest import count, from_ci, some
from tests.planner import synthetic

from frogkick.core.files import write_bytes
from frogkick.core.weights import WEIGHTS
from frogkick.link.frames import FrameCollector
from frogkick.link.layout import link_layout
from frogkick.paths import shape
from frogkick.planner.plan import Cost, PlanConfig, config_of
from frogkick.robot import load_robot
from frogkick.runs.chip_check import ChipPlanner
from frogkick.runs.parity_scenario import (
    ParityScenario,
    call_mismatches,
    live_natively,
    live_on_chip,
    record_scenario,
    twin_mismatches,
)
from frogkick.tables.image import Tables, open_image
from frogkick_codegen import firmware, toolchain
from frogkick_codegen.native import NativeLibrary
from frogkick_codegen.parity import compare, make_cases, native_place, python_place
from frogkick_codegen.toolchain import firmware_sources

SEED = 7
DECISIONS = count(200, 200, 80)
ROUTE = config_of(load_robot("frog2022").planner)
CONFIGS = {
    "paper": PlanConfig(),
    "route": dataclasses.replace(ROUTE, transitions_max=0),
    "course": dataclasses.replace(ROUTE, transitions_max=0, turn_lead=0.96, course_weight_per_m=55.8),
    "glide": dataclasses.replace(ROUTE, transitions_max=0, glide_weight_per_m=300.0, glide_lead=0.6),
    "walls": dataclasses.replace(
        ROUTE,
        transitions_max=0,
        glide_weight_per_m=300.0,
        wall_weight_per_m=300.0,
        wall_glide=2.0,
        wall_x_min_m=-0.15,
        wall_x_max_m=0.2,
        wall_y_min_m=-0.05,
        wall_y_max_m=0.1,
    ),
    "budget": dataclasses.replace(ROUTE, transitions_max=150),
}
PATH = shape("ellipse")
FASTEST = toolchain.other("gcc") or toolchain.zig()


@pytest.fixture(scope="module")
def libraries() -> dict[str, NativeLibrary]:
    """The planner by each compiler that there is."""
    found = {"native": NativeLibrary()}
    if (gcc := toolchain.other("gcc")) is not None:
        found["gcc"] = NativeLibrary(compiler=gcc)
    return found


def test_every_cost_and_every_weight_is_compared() -> None:
    """Else the places may differ by it, and nothing below would tell."""
    assert {config.cost for config in CONFIGS.values()} == set(Cost)
    for name, weight in WEIGHTS.items():
        unused = getattr(PlanConfig(), name) if weight.least < 0.0 else 0.0
        assert any(getattr(config, name) != unused for config in CONFIGS.values()), name


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("kind", made_up.KINDS)
def test_compilers_give_the_twin_s_bits(kind: str, config: str, libraries: dict[str, NativeLibrary]) -> None:
    tables, settings = open_image(made_up.image(kind)), CONFIGS[config]
    cases = make_cases(tables, PATH, count(51_000, 510_000, 6000) // len(CONFIGS), SEED)
    places = {"python": python_place(tables, PATH, settings)}
    for name, library in libraries.items():
        places[name] = native_place(library, tables, PATH, settings)
    for pair in compare(cases, places):
        assert pair.mismatches == 0, pair.first_failure


class Built:
    """One table's firmware for every place, built where it is asked for."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.folder, self.file = folder, folder / f"{kind}.fkt"
        write_bytes(self.file, made_up.image(kind, limb_wear=synthetic.bent_curves()))
        self.tables: Tables = open_image(self.file.read_bytes())

    @cached_property
    def bench(self) -> Path:
        return firmware.build("bench", self.file, load_robot("frog2022"), self.folder / "bench").image

    @cached_property
    def native(self) -> dict[str, Path]:
        return {
            name: firmware.build(
                "native", self.file, load_robot("frog2022"), self.folder / name, compiler
            ).image
            for name in some(("native", "gcc"), 1)
            if (compiler := toolchain.zig() if name == "native" else toolchain.other(name)) is not None
        }


@pytest.fixture(scope="module", params=some(made_up.KINDS, 1))
def built(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Built:
    return Built(tmp_path_factory.mktemp(request.param), request.param)


@pytest.mark.parametrize("config", CONFIGS)
def test_the_chip_gives_the_twin_s_bits(built: Built, config: str) -> None:
    settings = CONFIGS[config]
    cases = make_cases(built.tables, PATH, count(80, 20_000, 34), SEED)
    chip = ChipPlanner(built.bench)
    chip.configure(PATH, settings)
    for lost in ([0, 0, 0, 0], [9000, 0, 32767, 20_000]):
        chip.wear(lost)
        places = {
            "python": python_place(built.tables.worn(lost), PATH, settings),
            "chip": lambda *given: chip.plan(*given)[0],
        }
        (pair,) = compare(cases, places)
        assert pair.mismatches == 0, pair.first_failure


@from_ci
@pytest.mark.parametrize("config", CONFIGS)
def test_so_it_does_over_very_many_states(built: Built, config: str) -> None:
    """The same instructions, not counted: very many states, few of them deep."""
    settings = CONFIGS[config]
    number = -(-count(50_000, 1_000_000, 5000) // (len(made_up.KINDS) * len(CONFIGS)))
    cases = make_cases(built.tables, PATH, number, SEED + 1, (0.7, 0.295, 0.005, 0.0))
    chip = ChipPlanner(built.bench)
    chip.configure(PATH, settings)
    places = {
        "python": python_place(built.tables, PATH, settings),
        "chip": lambda *given: chip.plan(*given, counted=False)[0],
    }
    (pair,) = compare(cases, places)
    assert pair.mismatches == 0, pair.first_failure
    some = (cases.states[:40], cases.depths[:40], cases.limb_use[:40], cases.along_points[:40])
    counted, again = chip.plan(*some)[0], chip.plan(*some, counted=False)[0]
    assert counted.tobytes() == again.tobytes()


_LOOPS: dict[tuple[object, ...], ParityScenario] = {}


def loop_of(built: Built, config: PlanConfig, decisions: int = DECISIONS, seed: int = SEED) -> ParityScenario:
    """The loop that a library lives through; its file is named for its content."""
    asked = (built.native["native"].name, config, decisions, seed)
    if asked not in _LOOPS:
        _LOOPS[asked] = record_scenario(built.native["native"], built.tables, PATH, config, decisions, seed)
    return _LOOPS[asked]


@pytest.mark.parametrize(("config", "depth"), [("paper", 2), ("route", 1), ("budget", 3)])
def test_a_whole_loop_is_the_same_everywhere(built: Built, config: str, depth: int) -> None:
    settings, decisions = dataclasses.replace(CONFIGS[config], depth=depth), count(80, 200, 15)
    for seed in range(SEED, SEED + count(1, 5)):
        loop = loop_of(built, settings, decisions, seed)
        assert len(loop.decisions) == decisions
        assert twin_mismatches(loop, built.tables, PATH, settings) == []
        for library in built.native.values():
            assert call_mismatches(loop, live_natively(library, built.tables, loop.calls)) == []
        assert call_mismatches(loop, live_on_chip(built.bench, loop.calls)) == []


@from_ci
@pytest.mark.parametrize("built", ["affine"], indirect=True)
def test_a_run_started_again_after_its_fixes_were_lost_begins_at_the_path_s_start(built: Built) -> None:
    settings = dataclasses.replace(CONFIGS["route"], depth=1)
    loops = (loop_of(built, settings, 40, SEED + k) for k in range(20))
    loop = next(each for each in loops if any(event.lost for event in each.events))
    assert twin_mismatches(loop, built.tables, PATH, settings) == []
    # Who is not told of the lost run seeks its place near the one before.
    untold = dataclasses.replace(loop, events=[event for event in loop.events if not event.lost])
    fields = {name for _, names in twin_mismatches(untold, built.tables, PATH, settings) for name in names}
    assert "along_points" in fields


def test_a_loop_has_what_makes_estimates_hard(built: Built) -> None:
    loop = loop_of(built, PlanConfig())
    frames = FrameCollector().feed(b"".join(call.stream for call in loop.calls))
    names = link_layout().status_name
    answer = {names(int(frame.values["status"])) for frame in frames if frame.name == "FIX"}
    assert {"OK", "DOUBLE", "OUTLIER"} <= answer
    assert any(any(decision.lost) for decision in loop.decisions)
    made = {names(int(frame.values["status"])) for frame in frames if frame.name == "DECISION"}
    assert made == {"OK", "STALE"}
    assert len({decision.action for decision in loop.decisions}) > 3
    assert len({decision.fixes for decision in loop.decisions}) > 10
    assert sum(event.pose_world is not None for event in loop.events) > 5 * DECISIONS
    assert any(call.outputs[0] for call in loop.calls)  # limbs were driven


# The loop is a test only if it fails where a core differs


LOOP_MUTATIONS = {
    "weight of a period": ("fk_track.c", "0.25f, 0.2f}", "0.25f, 0.21f}"),
    "what a limb must explain": ("fk_wear.c", "FK_WEAR_PENALTY 9.0f", "FK_WEAR_PENALTY 60.0f"),
    "a decision knows nothing of the stroke before": (
        "fk_robot.c", "fk_track_end_period(&robot->estimator.track, robot->next_decision_us);", "",
    ),
    "a duplicate fix counts twice": ("fk_estimator.c", "return FK_STATUS_DOUBLE;", "break;"),
    "a fix is stale earlier": ("fk_estimator.h", "FK_FIX_STALE_US 500000", "FK_FIX_STALE_US 300000"),
}  # fmt: skip


@from_ci
@pytest.mark.parametrize("built", ["nearest"], indirect=True)
@pytest.mark.parametrize("name", some(LOOP_MUTATIONS, 1))
def test_a_changed_core_is_found_by_the_loop(
    name: str, built: Built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, before, after = LOOP_MUTATIONS[name]
    source = tmp_path / "firmware" / "core" / file
    shutil.copytree(firmware_sources(), tmp_path / "firmware")
    text = source.read_text()
    assert before in text, "the rule moved: correct the mutation"
    source.write_text(text.replace(before, after))
    monkeypatch.setattr(firmware, "firmware_sources", lambda: tmp_path / "firmware")
    mutant = firmware.build("native", built.file, load_robot("frog2022"), tmp_path / "out", FASTEST).image
    settings = PlanConfig()
    loop = loop_of(built, settings)
    assert call_mismatches(loop, live_natively(mutant, built.tables, loop.calls))
    other = record_scenario(mutant, built.tables, PATH, settings, DECISIONS, SEED)
    assert twin_mismatches(other, built.tables, PATH, settings)


def test_a_changed_byte_of_the_table_is_found_by_the_loop(built: Built) -> None:
    settings, image = PlanConfig(), built.tables.image
    loop = loop_of(built, settings)
    assert twin_mismatches(loop, built.tables, PATH, settings) == []
    sections = built.tables.sections
    # Of the first action's way forward, in every look-up: a coefficient's byte, or the least value's.
    place = sections.columns + 6 if built.tables.kind == "affine" else sections.models + 4
    changed = open_image(synthetic.resealed(image, place, bytes([image[place] ^ 0x10])))
    assert twin_mismatches(loop, changed, PATH, settings)
