"""``frogkick COMMAND``: finds the command; turns every error into one line and an exit code.

Exit codes: 0 done, 1 a check failed, 2 bad input, 130 interrupted.
"""

from __future__ import annotations

import sys

import typer

from frogkick.cli import (
    codegen,
    demo,
    doctor,
    firmware,
    importing,
    library,
    parity,
    replay,
    run,
    simulate,
    tables,
)
from frogkick.errors import FrogkickError

app = typer.Typer(
    name="frogkick",
    help="Plan for small robots that move by strokes: simulate, tabulate, emit C, flash, run, replay.",
    rich_markup_mode=None,
    no_args_is_help=True,
    add_completion=False,
)
for _module in (demo, doctor, simulate, codegen, run, replay, parity, importing):
    _module.register(app)
app.add_typer(library.app, name="library")
app.add_typer(tables.app, name="tables")
app.add_typer(firmware.app, name="firmware")

BAD_INPUT = 2
INTERRUPTED = 130


def _complain(text: str) -> None:
    print("frogkick: " + " ".join(text.split()), file=sys.stderr)


def run_command(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code."""
    try:
        result = app(arguments, standalone_mode=False)
        return result if isinstance(result, int) else 0
    except FrogkickError as error:
        _complain(str(error))
        return BAD_INPUT
    except typer.Exit as error:
        return error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        _complain("interrupted: nothing half-written was left")
        return INTERRUPTED
    except Exception as error:
        # Usage errors come as the command-line library's own class, which it does not export.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        _complain(f"{message()} (see 'frogkick --help')")
        return BAD_INPUT


def main() -> None:
    """Entry point of the ``frogkick`` command."""
    sys.exit(run_command())


if __name__ == "__main__":
    main()
