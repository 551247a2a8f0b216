"""``frogkick COMMAND``: calls the command, and turns every error into one line and an exit code.

Exit codes: 0 done, 1 a check failed, 2 bad input, 130 interrupted, by Ctrl-C, SIGTERM or a closed terminal.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from contextlib import suppress
from types import FrameType, TracebackType
from typing import Any

from frogkick.core.errors import CheckError, FrogkickError
from frogkick.core.interrupts import STOPS, ctrl_c_waits, interrupt_on_stops

CHECK_FAILED = 1
BAD_INPUT = 2
INTERRUPTED = 130

_INTERRUPTED = "interrupted"
_LONGEST = 1000
"""Largest number of characters of an error, of which only the beginning and the end are shown beyond."""
_NEEDED = {
    "int_parsing": "a whole number of ",
    "int_from_float": "a whole number of ",
    "int_parsing_size": "a whole number of ",
    "float_parsing": "a number of ",
    "finite_number": "a finite number of ",
}
"""What a value of an option must be, by the type of the error."""
_AGAIN_S = 0.01
"""Delay before a Ctrl-C that could not be delivered is raised again."""


def _complain(text: str) -> None:
    line = " ".join(text.split())
    if len(line) > _LONGEST:
        line = f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"
    with suppress(OSError):  # the terminal is closed
        print(f"frogkick: {line}", file=sys.stderr)


def run_command(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code."""
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        _complain(_INTERRUPTED)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of stdout (head, less) has closed it; the interpreter would report this again at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except CheckError as error:
        _complain(str(error))
        return CHECK_FAILED
    except FrogkickError as error:
        _complain(str(error))
    except UnicodeError as error:
        _complain(f"a text in the input is not UTF-8 ({error}): write the file again as UTF-8")
    except EOFError as error:
        _complain(_cut_short(error.__traceback__))
    except OSError as error:
        named = f" {error.filename!r}" if error.filename else ""
        _complain(f"cannot read or write{named}: {error.strerror or error}; check the path and the disk")
    except Exception as error:
        if not _came_of_ctrl_c(error):
            raise
        _complain(_INTERRUPTED)
        return INTERRUPTED
    return BAD_INPUT


def _cut_short(trace: TracebackType | None) -> str:
    """Return what to do about a file that ends too early.

    Until 3.12.8 Python kept a partly written compiled module when the disk became full.
    """
    file = None
    while trace is not None:
        file = trace.tb_frame.f_locals.get("bytecode_path", file)
        trace = trace.tb_next
    named = "a file of a cache" if file is None else f"{file!r}"
    return f"{named} is cut short, for example because the disk was full: delete it, and it is made again"


def _came_of_ctrl_c(error: BaseException | None) -> bool:
    """Return whether the error was raised while a Ctrl-C was being handled, for example by a lock."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def _asked(error: Any) -> str:
    """Return the full name of the command that a usage error is about."""
    context = getattr(error, "ctx", None)
    return context.command_path if context is not None else "frogkick"


def _wrong_value(error: Any) -> str:
    """Return which option or argument has which wrong value and what is allowed; "" if this is another error.

    The command-line library's own text has the range alone, or the type.
    """
    details = getattr(error.__cause__ or error.__context__, "errors", None)
    parameter = getattr(error, "param", None)
    if details is None or parameter is None:
        return ""
    wrong = details()[0]
    low, high = getattr(parameter, "min", None), getattr(parameter, "max", None)
    if wrong["type"] not in _NEEDED and "ctx" in wrong and "error" in wrong["ctx"]:
        needed = f"which {wrong['ctx']['error']}".replace(f"{wrong['input']!r} ", "").rstrip(".")
    elif None not in (low, high):
        needed = f"allowed is {_NEEDED.get(wrong['type'], '')}{low:.10g} to {high:.10g}"
    elif low is not None:
        needed = f"allowed is {_NEEDED.get(wrong['type'], '')}{low:.10g} or more"
    else:
        needed = f"needed is {_NEEDED.get(wrong['type'], wrong['msg']).removesuffix(' of ')}"
    return f"{max(parameter.opts, key=len)} is {wrong['input']!r}, {needed}"


def _run(arguments: list[str] | None) -> int:
    with ctrl_c_waits():  # imported here, so that a Ctrl-C meanwhile prints no traceback
        import typer

        from frogkick.cli.app import app

    try:
        result = app(arguments, prog_name="frogkick", standalone_mode=False)
        sys.stdout.flush()
    except typer.Exit as error:
        return error.exit_code
    except typer.Abort as error:
        if isinstance(error.__cause__, EOFError):
            raise error.__cause__ from None
        raise KeyboardInterrupt from None
    except Exception as error:
        # Usage errors come as the command-line library's own class, which it does not export.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        if type(error).__name__ == "NoArgsIsHelpError":  # no command was given: list them
            print(message(), file=sys.stderr)
        else:
            _complain(f"{_wrong_value(error) or message()} (see '{_asked(error)} --help')")
        return BAD_INPUT
    if result == INTERRUPTED:  # typer returns this after a Ctrl-C and prints nothing
        raise KeyboardInterrupt
    return result if isinstance(result, int) else 0


def main() -> None:
    """Entry point of the ``frogkick`` command."""
    try:
        _open_closed_streams()
        sys.unraisablehook = _raise_again
        if hasattr(signal, "SIGALRM"):
            signal.signal(signal.SIGALRM, _interrupt)
        interrupt_on_stops()
        code = run_command()
        # A Ctrl-C that passed through exec of a text, as making a dataclass does, would make the interpreter
        # end by a signal instead of this exit code; exec of another text takes that back.
        exec("")
        _ignore_signals()  # only the interpreter's own shutdown remains
    except KeyboardInterrupt:  # before the command's first line or after its last
        _ignore_signals()
        _complain(_INTERRUPTED)
        code = INTERRUPTED
    sys.exit(code)


def _open_closed_streams() -> None:
    """Discard what is printed if standard output or error was closed (``>&-``), and escape what cannot be.

    Python would print to the other one of the two, and the next file that is opened would be in its place.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal of cp1252 lacks letters that a file's name has
        sys.stdout.reconfigure(errors="backslashreplace")


def _ignore_signals() -> None:
    for number in (signal.SIGINT, *STOPS):
        signal.signal(number, signal.SIG_IGN)


def _raise_again(unraisable: Any) -> None:
    """Interrupt again a moment later if the interpreter could not deliver a Ctrl-C.

    This happens in a destructor, a callback of a compiler, a weak reference's callback and a function called
    around a fork. There the interpreter would print a traceback and continue.
    """
    if not issubclass(unraisable.exc_type, KeyboardInterrupt) or not hasattr(signal, "setitimer"):
        sys.__unraisablehook__(unraisable)
        return
    signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
