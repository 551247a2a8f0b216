"""``frogkick study verdicts``: planted effects, identified and counted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.options import TablesOption

if TYPE_CHECKING:
    from frogkick_studies.identification_studies import VerdictStudy


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
    the catalogue and with one from outside; 90 % with two at once; or where more than 2 % are wrongly found.
    An effect with a parameter farther off than twice its interval is wrong. How many parameters are inside
    their intervals of 95 % is counted beside it.
    """
    from frogkick_studies.identification_studies import study_verdicts

    found = study_verdicts(
        out,
        planted=kind,
        seeds=seeds,
        cases=cases,
        first=first,
        tables=tables,
        workers=workers,
        progress=True,
    )
    figure = out / "verdicts.png"
    write_picture(found.plot(), figure)
    show({**found.as_json(), "figure": str(figure)}, json, _text(found))
    if not found.passed:
        raise typer.Exit(1)


def _text(found: VerdictStudy) -> str:
    lines = []
    for case, result in found.results.items():
        errors = " / ".join(
            f"{1e3 * position:.2f} mm {57.29578 * heading:.2f} deg"
            for position, heading in (result.before, result.after, result.floor)
        )
        lines.append(
            f"{'ok' if result.right else 'NO'} {case.key}: planted {'; '.join(result.planted) or 'nothing'}; "
            f"{result.verdict}: {'; '.join(result.found) or 'no effect'}; {errors}; {result.cpu_s:.0f} s"
        )
    lines += [
        f"{name}: {group['right']} of {group['cases']} right, {group['wrongly_found']} wrongly found, "
        f"{group['inside']} of {group['parameters']} parameters inside their intervals"
        for name, group in found.groups.items()
    ]
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(verdicts)
