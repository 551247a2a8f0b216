"""All commands in one place."""

from __future__ import annotations

import typer

from frogkick.cli import (
    camera,
    chip_log,
    codegen,
    demo,
    doctor,
    firmware,
    identify,
    importing,
    library,
    log,
    parity,
    push,
    replay,
    retune,
    robot,
    run,
    simulate,
    study,
    sweep,
    tables,
    validate,
)

app = typer.Typer(
    name="frogkick",
    help="Plan for small robots that move by strokes: simulate, tabulate, emit C, flash, run, replay.",
    rich_markup_mode=None,
    no_args_is_help=True,
    add_completion=False,
)
for _module in (
    demo, doctor, simulate, sweep, validate, codegen, run, replay, parity, importing, identify, retune, push,
    log, chip_log,
):  # fmt: skip
    _module.register(app)
app.add_typer(robot.app, name="robot")
app.add_typer(camera.app, name="camera")
app.add_typer(log.app, name="log")
app.add_typer(library.app, name="library")
app.add_typer(tables.app, name="tables")
app.add_typer(firmware.app, name="firmware")
app.add_typer(study.app, name="study")
