"""Decisions made by Python, native C and the chip, compared bit by bit."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from frogkick.core.progress import Progress, shown
from frogkick.front.places import plan_config
from frogkick.front.tables import Table, load_table
from frogkick.paths import Path as SwimPath
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.robot import Robot
from frogkick.tables.image import Tables
from frogkick_codegen.firmware import build, require_tools
from frogkick_codegen.native import NativeLibrary
from frogkick_codegen.parity import KINDS, PairReport, Place, compare, make_cases, native_place, python_place
from frogkick_codegen.toolchain import other, zig

LOOP_DECISIONS = 200


@dataclass(frozen=True, eq=False)
class Parity:
    """The differences between the places that decide; see ``compare_places`` for the numbers."""

    states: int
    chip_states: int
    pairs: Sequence[PairReport]  # for each pair: the number of different decisions, their fields, the first
    loop_decisions: int
    loop_mismatches: dict[str, int]  # pair, such as "python-native" -> different decisions or outputs
    places: dict[str, str]  # name -> the compiler's version, or "twin"
    seed: int

    @property
    def mismatches(self) -> dict[str, int]:
        """Pair of places, such as "python-native" -> single decisions that differ in any bit."""
        return {f"{pair.first}-{pair.second}": pair.mismatches for pair in self.pairs}

    @property
    def same(self) -> bool:
        """Whether every place gave the same bits throughout."""
        return not any(self.mismatches.values()) and not any(self.loop_mismatches.values())

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``parity``."""
        return {
            "states": self.states,
            "chip_states": self.chip_states,
            "mismatches": self.mismatches,
            "loop_decisions": self.loop_decisions,
            "loop_mismatches": self.loop_mismatches,
            "places": self.places,
            "fields": {f"{pair.first}-{pair.second}": dict(pair.fields) for pair in self.pairs},
            "kinds": list(KINDS),
            "seed": self.seed,
            "failures": [pair.first_failure for pair in self.pairs if pair.first_failure],
        }


def compare_places(
    table: Table | Path | str | None = None,
    *,
    robot: Robot | str | None = None,
    states: int = 100_000,
    chip_states: int | None = None,
    loop_decisions: int = LOOP_DECISIONS,
    planner: str = "paper",
    depth: int | None = None,
    seed: int = 0,
    progress: Progress = False,
) -> Parity:
    """Make the same decisions in every place and count differing bits.

    Single decisions start from states of every kind, at depth 1 to 4; the chip makes the first
    ``chip_states`` of them. A closed loop follows, from fixes to decisions. The places are Python, native C
    by zig's clang ("native"), native C by gcc if this machine has it, and the virtual chip. The arguments are
    the options of the command ``parity``.
    """
    require_tools("bench")
    used = load_table(table, robot)
    config = plan_config(used.robot, planner, depth)
    compilers = {"native": zig("host"), **({"gcc": gcc} if (gcc := other("gcc")) else {})}
    on_chip = states if chip_states is None else min(chip_states, states)
    tables, path = used.tables, shape("sine")
    cases = make_cases(tables, path, states, seed)
    loops: dict[str, int] = {}
    places: dict[str, Place] = {"python": python_place(tables, path, config)}
    for name, compiler in compilers.items():
        places[name] = native_place(NativeLibrary(compiler=compiler), tables, path, config)
    with used.file() as image, tempfile.TemporaryDirectory(prefix="frogkick-parity-") as folder:
        bench = build("bench", image, used.robot, Path(folder) / "bench").image
        with shown(progress, "virtual chip") as tell:
            pairs = compare(cases, places)
            if on_chip:
                places["chip"] = _chip_place(bench, path, config, on_chip, tell)
                there = compare(cases.part(0, on_chip), places)
                pairs += [one for one in there if one.second == "chip"]
        if loop_decisions:
            libraries = {
                name: build("native", image, used.robot, Path(folder) / name, compiler).image
                for name, compiler in compilers.items()
            }
            loops = _loops(libraries, bench, tables, config, loop_decisions, seed)
    versions = {"python": "twin", **{name: one.version for name, one in compilers.items()}}
    return Parity(states, on_chip, pairs, loop_decisions, loops, versions, seed)


def _chip_place(
    bench: Path, path: SwimPath, config: PlanConfig, states: int, progress: Callable[[int, int], None]
) -> Place:
    from frogkick.runs.chip_check import ChipPlanner  # it cannot be loaded without the extra

    chip = ChipPlanner(bench)
    chip.configure(path, config)

    def show_progress(done: int) -> None:
        if done % 100 == 0 or done == states:
            progress(done, states)

    return lambda queries, depths, use, along: chip.plan(
        queries, depths, use, along, show_progress, counted=False
    )[0]


def _loops(
    libraries: dict[str, Path], bench: Path, tables: Tables, config: PlanConfig, decisions: int, seed: int
) -> dict[str, int]:
    """Compare a closed loop: the twin by its decisions, the C builds by all outputs of their core."""
    from frogkick.runs.parity_scenario import (
        call_mismatches,
        live_natively,
        live_on_chip,
        record_scenario,
        twin_mismatches,
    )

    path = shape("ellipse")
    first, *more = libraries
    loop = record_scenario(libraries[first], tables, path, config, decisions, seed)
    found = {f"python-{first}": len(twin_mismatches(loop, tables, path, config))}
    for name in more:
        lived = live_natively(libraries[name], tables, loop.calls)
        found[f"{first}-{name}"] = len(call_mismatches(loop, lived))
    found[f"{first}-chip"] = len(call_mismatches(loop, live_on_chip(bench, loop.calls)))
    return found
