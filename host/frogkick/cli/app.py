"""All commands in one place: what each is for, and the module that is loaded when it is called."""

from __future__ import annotations

import importlib
from typing import Annotated, Any, ClassVar

import typer
import typer.main
from typer.core import TyperGroup

import frogkick
from frogkick.core.interrupts import ctrl_c_waits

LOG_COMMANDS = {
    "show": ("log", "A run in numbers and in one picture."),
    "compare": ("log", "Two runs side by side."),
    "fetch": ("chip_log", "Get from a robot what it wrote down."),
    "replay": ("chip_log", "Decide again, from a fetched log, what the robot decided."),
}
STUDY_COMMANDS = {
    "tables": ("study", "Error of tables of both kinds against their size."),
    "history": ("study", "Error of tables with and without limb use as an input."),
    "estimator": ("study", "States from late, lost, doubled and wrong fixes."),
    "loop": ("study", "Distance and progress: the paper's planner and the robot's."),
    "twin": ("study", "The paper's planner and the robot's, in a worn twin's pool."),
    "ceiling": ("study", "One planner told by tables, by rods, by the pool itself."),
    "foresight": ("study", "How near to a path any plan could stay, and how fast."),
    "verdicts": ("study", "Plant effects in pools, identify them from the logs."),
    "openloop": ("study", "Fit effects to some measured swims, predict the others."),
    "heldout": ("study", "Predict each run with what all other runs show."),
    "convergence": ("study", "Error of the rods against their time step."),
    "chip": ("study", "How long the chip plans, in cycles of the image."),
}
START, MAKE, RUN, LEARN, RESEARCH = "Start", "Make", "Run", "Learn", "Research"
SECTIONS = {
    "demo": START, "doctor": START, "robot": START,
    "simulate": MAKE, "library": MAKE, "tables": MAKE, "codegen": MAKE, "firmware": MAKE,
    "camera": RUN, "scan": RUN, "run": RUN, "push": RUN, "own": RUN, "log": RUN, "export": RUN,
    "import": LEARN, "replay": LEARN, "identify": LEARN, "retune": LEARN,
    "parity": RESEARCH, "validate": RESEARCH, "sweep": RESEARCH, "study": RESEARCH,
}  # fmt: skip
"""Command -> where the help lists it, in this order."""
COMMANDS = {
    "demo": ("demo", "The whole ring once, on the virtual chip, and its report."),
    "doctor": ("doctor", "What this machine has, and what to install for more."),
    "simulate": ("simulate", "Simulate a gait, or a sequence of actions."),
    "sweep": ("sweep", "Simulate every EGaIn fraction, frequency and phase."),
    "validate": ("validate", "Compare the model with simulated and measured swims."),
    "codegen": ("codegen", "Emit a table and the planner as C99."),
    "run": ("run", "Follow a path: position fixes in, strokes out."),
    "replay": ("replay", "Plan a run's states again and compare each decision."),
    "parity": ("parity", "Decide in every place and count differing bits."),
    "import": ("importing", "Read recorded runs, repair or mark what is wrong."),
    "identify": ("identify", "Trace what a robot's model lacks to physical effects."),
    "retune": ("retune", "Make a worn robot new tables."),
    "scan": ("push", "Robots in range by Bluetooth: signal, table, state."),
    "push": ("push", "Give a robot another table, by radio or line."),
    "own": ("push", "Let a robot take commands from its owner alone."),
    "export": ("log", "Write a run as CSV or as MCAP."),
    "robot": ("robot", "Which robots there are, what one looks like, and a file for a new one."),
    "camera": ("camera", "Calibrate the camera over the pool, check it, track the tag, print it."),
    "log": (LOG_COMMANDS, "Look at runs; fetch what a robot wrote down."),
    "library": ("library", "Simulate transitions for many initial velocities."),
    "tables": ("tables", "Make of a library the robot's table image."),
    "firmware": ("firmware", "Build, measure, flash and test the robot's image."),
    "study": (STUDY_COMMANDS, "Questions about the method, answered with figures."),
}
"""Name -> (module of this package, or a group's own commands; one line of help)."""


class LazyGroup(TyperGroup):
    """Commands of which one is loaded when it is called: ``--help`` and a typo wait for none of them."""

    table: ClassVar[dict[str, Any]] = {}

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = dict.fromkeys(self.table)  # their names: what a typo may have meant

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Load a command, None where there is none of that name."""
        if cmd_name not in self.table:
            return None
        place, text = self.table[cmd_name]
        if isinstance(place, dict):
            return typer.main.get_command(_group(cmd_name, text, place))
        with ctrl_c_waits():
            module = importlib.import_module(f"frogkick.cli.{place}")
        parent = typer.Typer(rich_markup_mode=None, add_completion=False)
        parent.callback()(lambda: None)
        if hasattr(module, "app"):
            parent.add_typer(module.app, name=cmd_name)
        else:
            module.register(parent)
        return typer.main.get_group(parent).commands[cmd_name]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write names and lines of help, from the table; those of the root by what they are for."""
        places = {name: SECTIONS[name] if self.table is COMMANDS else "Commands" for name in self.table}
        names = list(SECTIONS) if self.table is COMMANDS else list(self.table)
        for section in dict.fromkeys(places[name] for name in names):
            with formatter.section(section):
                formatter.write_dl([(name, self.table[name][1]) for name in names if places[name] == section])


def _group(name: str, text: str, table: dict[str, Any]) -> typer.Typer:
    made = typer.Typer(
        name=name,
        help=text,
        cls=type("Commands", (LazyGroup,), {"table": table}),
        rich_markup_mode=None,
        no_args_is_help=True,
        add_completion=table is COMMANDS,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    made.callback()(lambda: None)
    return made


app = _group(
    "frogkick",
    "Plan for small robots that move by strokes: simulate, tabulate, emit C, flash, run, replay.",
    COMMANDS,
)


def _tell_version(asked: bool) -> None:
    if asked:
        print(f"frogkick {frogkick.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    _version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_tell_version),
    ] = False,
) -> None:
    return None
