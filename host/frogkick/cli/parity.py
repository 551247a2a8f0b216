"""``frogkick parity``: the same bits from Python, native C and the chip."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, SeedOption, show
from frogkick.cli.options import DepthOption, PlannerName, PlannerOption, TablesOption
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.paths import Path as SwimPath
    from frogkick.planner.image import Tables
    from frogkick.planner.plan import PlanConfig
    from frogkick_codegen.parity import PairReport, Place
    from frogkick_codegen.toolchain import Compiler

LOOP_DECISIONS = 200


def parity(
    states: Annotated[
        int, typer.Option(min=10, max=10_000_000, help="States for Python and native C.")
    ] = 100_000,
    chip_states: Annotated[
        int | None,
        typer.Option(min=0, max=10_000_000, help="States of them for the virtual chip.  [default: all]"),
    ] = None,
    loop_decisions: Annotated[
        int, typer.Option(min=0, max=100_000, help="Decisions of a whole loop, fixes in, decisions out.")
    ] = LOOP_DECISIONS,
    tables: TablesOption = None,
    model: Annotated[str | None, typer.Option(help="Robot TOML or name; default: the table's robot.")] = None,
    planner: PlannerOption = PlannerName.paper,
    depth: DepthOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Decide in every place and count differing bits. Exit 1 if there are any.

    Single decisions from states of every kind, at depth 1 to 4, and a whole loop at --depth. Places: Python,
    native C by zig's clang (native), by gcc where this machine has it, and the virtual chip.
    """
    from frogkick.front.places import plan_config, robot_of_table, table_image
    from frogkick.planner.image import read_image
    from frogkick_codegen.firmware import build, require_tools
    from frogkick_codegen.parity import KINDS
    from frogkick_codegen.toolchain import other, zig

    require_tools("bench")
    image = table_image(tables, model)
    described = robot_of_table(image, model)
    opened, config = read_image(image), plan_config(described, planner.value, depth)
    compilers = {"native": zig("host"), **({"gcc": gcc} if (gcc := other("gcc")) else {})}
    with tempfile.TemporaryDirectory(prefix="frogkick-parity-") as folder:
        bench = build("bench", image, described, Path(folder) / "bench").image
        with progress_bar("virtual chip") as progress:
            on_chip = states if chip_states is None else min(chip_states, states)
            reports = _single(opened, config, compilers, bench, (states, on_chip, seed), progress)
        loops: dict[str, int] = {}
        if loop_decisions:
            libraries = {
                name: build("native", image, described, Path(folder) / name, compiler).image
                for name, compiler in compilers.items()
            }
            loops = _loops(libraries, bench, opened, config, loop_decisions, seed)
    mismatches = {f"{report.first}-{report.second}": report.mismatches for report in reports}
    result: dict[str, Any] = {
        "states": states,
        "chip_states": on_chip,
        "mismatches": mismatches,
        "loop_decisions": loop_decisions,
        "loop_mismatches": loops,
        "places": {"python": "twin", **{name: one.version for name, one in compilers.items()}},
        "fields": {f"{r.first}-{r.second}": dict(r.fields) for r in reports},
        "kinds": list(KINDS),
        "seed": seed,
        "failures": [report.first_failure for report in reports if report.first_failure],
    }
    show(result, json)
    if any(mismatches.values()) or any(loops.values()):
        raise typer.Exit(1)


def _single(
    tables: Tables,
    config: PlanConfig,
    compilers: dict[str, Compiler],
    bench: Path,
    counts: tuple[int, int, int],
    progress: Callable[[int, int], None],
) -> list[PairReport]:
    """Compare single decisions: all places but the chip on all states, the chip on the first of them."""
    from frogkick.loop.chip_planner import ChipPlanner
    from frogkick.paths import shape
    from frogkick_codegen.native import NativeLibrary
    from frogkick_codegen.parity import compare, make_cases, native_place, python_place

    states, chip_states, seed = counts
    path = shape("sine")
    cases = make_cases(tables, path, states, seed)
    places: dict[str, Place] = {"python": python_place(tables, path, config)}
    for name, compiler in compilers.items():
        places[name] = native_place(NativeLibrary(compiler=compiler), tables, path, config)
    reports = compare(cases, places)
    if chip_states:
        chip = ChipPlanner(bench)
        chip.configure(path, config)

        def told(done: int) -> None:
            if done % 100 == 0 or done == chip_states:
                progress(done, chip_states)

        places["chip"] = lambda queries, depths, use, along: chip.decide(queries, depths, use, along, told)
        reports += [one for one in compare(cases.head(chip_states), places) if one.second == "chip"]
    return reports


def _loops(
    libraries: dict[str, Path],
    bench: Path,
    tables: Tables,
    config: PlanConfig,
    decisions: int,
    seed: int,
) -> dict[str, int]:
    """Compare a whole loop: the twin by decisions, other builds by all that their core puts out."""
    from frogkick.loop.rehearsal import (
        call_mismatches,
        live_natively,
        live_on_chip,
        rehearse,
        twin_mismatches,
    )
    from frogkick.paths import shape

    path: SwimPath = shape("ellipse")
    first, *more = libraries
    loop = rehearse(libraries[first], tables, path, config, decisions, seed)
    found = {f"python-{first}": len(twin_mismatches(loop, tables, path, config))}
    for name in more:
        lived = live_natively(libraries[name], tables, loop.calls)
        found[f"{first}-{name}"] = len(call_mismatches(loop, lived))
    found[f"{first}-chip"] = len(call_mismatches(loop, live_on_chip(bench, loop.calls)))
    return found


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(parity)
