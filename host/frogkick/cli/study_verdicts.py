"""``frogkick study verdicts``: planted effects, identified and counted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.options import TablesOption
from frogkick.errors import InputError
from frogkick.files import require_writable
from frogkick.progress import progress_bar
from frogkick.study.planted import NULL, ONE, OUTSIDE, TWO

if TYPE_CHECKING:
    from frogkick.study.verdicts import Case, Result

LEAST = {NULL: 0.95, ONE: 0.95, TWO: 0.90, OUTSIDE: 0.95}
"""Share of the cases of a group that must be right."""


def verdicts(
    out: Annotated[Path, typer.Option(help="Folder for results and figure; resumes there.")],
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Cases of each kind.")] = 5,
    cases: Annotated[
        int | None,
        typer.Option(min=1, max=10000, help="Cases of each group, its kinds in turn, instead of --seeds."),
    ] = None,
    first: Annotated[int, typer.Option(min=0, help="First seed.")] = 0,
    kind: Annotated[
        list[str] | None, typer.Option(help="Kinds to plant; may be given again; default: all.")
    ] = None,
    tables: TablesOption = None,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 1,
    json: JsonOption = False,
) -> None:
    """Plant effects in simulated pools, identify them from the runs, and count what comes out.

    Exit 1 where a group has fewer right verdicts than asked: 95 % with nothing planted, with one effect of
    the catalogue (its parameters inside their intervals) and with one from outside; 90 % with two at once.
    """
    from frogkick.front.places import robot_of_table, table_image
    from frogkick.report.verdicts_figure import verdicts_figure
    from frogkick.study.planted import kinds
    from frogkick.study.verdicts import run_cases
    from frogkick_codegen.firmware import require_tools

    known = kinds()
    for name in kind or []:
        if name not in known:
            raise InputError(f"--kind is {name!r}: choose from {', '.join(known)}")
    require_tools("native")
    require_writable(out, folder=True)
    image = table_image(tables, None)
    robot = robot_of_table(image, None)
    names = kind or list(known)
    wanted = cases_of(names, first, seeds, cases)
    with progress_bar("cases") as progress:
        results = run_cases(robot, image, wanted, out, workers, progress)
    groups: dict[str, dict[str, Any]] = {}
    for group, least in LEAST.items():
        some = [result for case, result in results.items() if known[case.kind].group == group]
        if some:
            right = sum(result.right for result in some)
            groups[group] = {
                "cases": len(some),
                "right": right,
                "wrongly_found": sum(result.wrong for result in some),
                "passed": right >= least * len(some),
            }
    figure = out / "verdicts.png"
    write_picture(verdicts_figure(results), figure)
    rows = [_row(case, result) for case, result in results.items()]
    show({"groups": groups, "cases": rows, "figure": str(figure)}, json, _text(results, groups))
    if not all(group["passed"] for group in groups.values()):
        raise typer.Exit(1)


def cases_of(names: Sequence[str], first: int, seeds: int, each: int | None) -> list[Case]:
    """Cases of some kinds: so many seeds of each kind, or so many of each group, its kinds in turn."""
    from frogkick.study.planted import kinds
    from frogkick.study.verdicts import Case

    if each is None:
        return [Case(name, seed) for seed in range(first, first + seeds) for name in names]
    found = []
    for group in LEAST:
        some = [name for name in names if kinds()[name].group == group]
        found += [Case(some[k % len(some)], first + k // len(some)) for k in range(each if some else 0)]
    return found


def _row(case: Case, result: Result) -> dict[str, Any]:
    return {
        "kind": case.kind,
        "seed": case.seed,
        "verdict": result.verdict,
        "right": result.right,
        "planted": result.planted,
        "found": result.found,
        "before": result.before,
        "after": result.after,
        "noise_floor": result.floor,
        "cpu_s": round(result.cpu_s, 1),
    }


def _text(results: dict[Case, Result], groups: dict[str, dict[str, Any]]) -> str:
    lines = []
    for case, result in results.items():
        errors = " / ".join(
            f"{1e3 * position:.2f} mm {57.29578 * heading:.2f} deg"
            for position, heading in (result.before, result.after, result.floor)
        )
        lines.append(
            f"{'ok' if result.right else 'NO'} {case.key}: planted {'; '.join(result.planted) or 'nothing'}; "
            f"{result.verdict}: {'; '.join(result.found) or 'no effect'}; {errors}; {result.cpu_s:.0f} s"
        )
    lines += [
        f"{name}: {group['right']} of {group['cases']} right, {group['wrongly_found']} wrongly found"
        for name, group in groups.items()
    ]
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(verdicts)
