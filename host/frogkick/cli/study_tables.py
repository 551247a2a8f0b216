"""``frogkick study tables``, ``study history``: what a table's bytes and its inputs are worth."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, SeedOption, show, write_picture
from frogkick.cli.library import Sampling
from frogkick.files import require_writable
from frogkick.progress import progress_bar

_PictureOption = Annotated[Path | None, typer.Option(help="Picture to write (PNG).")]


def tables(
    library: Annotated[Path, typer.Argument(help="HDF5 file of 'library build', the larger the better.")],
    out: _PictureOption = None,
    test_states: Annotated[int, typer.Option(min=4, max=10000, help="Unseen states of each sampling.")] = 200,
    swims: Annotated[
        Sampling, typer.Option(help="How unseen states of swims are drawn, as for 'library build'.")
    ] = Sampling.planned,
    seed: SeedOption = 1,
    json: JsonOption = False,
) -> None:
    """Error of tables of both kinds against their size, and against the library's."""
    from frogkick.library import read_library
    from frogkick.report.table_size_figure import table_size_figure
    from frogkick.study.table_size import least_bytes_as_good, over_full_nearest, slope, table_sizes

    content = read_library(library)
    require_writable(out)
    with progress_bar("tables") as progress:
        sizes = table_sizes(content, test_states, seed, progress, swims.value)
    if out is not None:
        write_picture(table_size_figure(sizes), out)
    affine = tuple(p for p in sizes.by_size if p.kind == "affine")
    show(
        {
            "by_size": [dataclasses.asdict(point) for point in sizes.by_size],
            "by_library": [dataclasses.asdict(point) for point in sizes.by_library],
            "affine_bytes_as_good_as_nearest": least_bytes_as_good(sizes),
            "affine_64_kib_over_full_nearest": over_full_nearest(sizes),
            "affine_exponent": {
                name: round(slope(affine, name), 3) for name in ("position_m", "heading_rad")
            },
            "seed": seed,
        },
        json,
    )


def history(
    robot: Annotated[str, typer.Argument(help="TOML file or built-in name.")] = "frog2022",
    out: _PictureOption = None,
    states: Annotated[int, typer.Option(min=50, max=65535, help="States of each library.")] = 400,
    test_states: Annotated[int, typer.Option(min=4, max=10000, help="Unseen states.")] = 100,
    seed: SeedOption = 1,
    json: JsonOption = False,
) -> None:
    """Error of affine tables with and without limb use as an input, for this robot and tiring ones."""
    from frogkick.report.history_figure import history_figure
    from frogkick.robot import load_robot
    from frogkick.study.history import history_worth

    described = load_robot(robot)
    require_writable(out)
    with progress_bar("limb history") as progress:
        results = history_worth(described, states, test_states, seed, progress)
    if out is not None:
        write_picture(history_figure(results), out)
    show({"robots": [dataclasses.asdict(result) for result in results], "seed": seed}, json)


def register(app: typer.Typer) -> None:
    """Add the commands to ``frogkick study``."""
    app.command()(tables)
    app.command()(history)
