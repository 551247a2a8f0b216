"""``frogkick study tables``, ``study history``: what a table's bytes and its inputs are worth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, SeedOption, show, write_picture
from frogkick.cli.library import Sampling
from frogkick.core.files import require_writable

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
    from frogkick_studies.table_studies import study_tables

    require_writable(out)
    found = study_tables(library, test_states=test_states, swims=swims.value, seed=seed, progress=True)
    if out is not None:
        write_picture(found.plot(), out)
    show(found.as_json(), json)


def history(
    robot: Annotated[str, typer.Argument(help="TOML file or built-in name.")] = "frog2022",
    out: _PictureOption = None,
    states: Annotated[int, typer.Option(min=50, max=65535, help="States of each library.")] = 400,
    test_states: Annotated[int, typer.Option(min=4, max=10000, help="Unseen states.")] = 100,
    seed: SeedOption = 1,
    json: JsonOption = False,
) -> None:
    """Error of affine tables with and without limb use as an input, for this robot and tiring ones."""
    from frogkick_studies.table_studies import study_history

    require_writable(out)
    found = study_history(robot, states=states, test_states=test_states, seed=seed, progress=True)
    if out is not None:
        write_picture(found.plot(), out)
    show(found.as_json(), json)


def register(app: typer.Typer) -> None:
    """Add the commands to ``frogkick study``."""
    app.command()(tables)
    app.command()(history)
