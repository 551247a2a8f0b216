"""The list of all commands: the purpose of each, and the module that is loaded when it is called."""

from __future__ import annotations

import importlib
from typing import Annotated, Any, ClassVar

import typer
import typer.main
from typer.core import TyperGroup

import frogkick
from frogkick.core.interrupts import ctrl_c_waits

ROBOT_COMMANDS = {
    "list": "start:list_robots",
    "new": "start:new_robot",
    "fit-stroke": "start:fit_stroke",
    "show": "start:show_robot",
    "frames": "start:draw_frames",
}
LIBRARY_COMMANDS = {"build": "make:build_library", "info": "make:show_library"}
TABLES_COMMANDS = {"build": "make:build_table", "info": "make:show_table"}
FIRMWARE_COMMANDS = {
    "build": "make:build_firmware",
    "size": "make:measure_firmware",
    "flash": "make:flash_firmware",
    "test": "make:check_firmware",
}
CAMERA_COMMANDS = {
    "calibrate": "camera:calibrate",
    "check": "camera:check",
    "track": "camera:track",
    "picture": "camera:picture",
    "tag": "camera:tag_page",
}
LOG_COMMANDS = {
    "show": ("log:show_run", "Show a run in numbers and in one picture."),
    "compare": ("log:compare", "Compare two runs side by side."),
    "fetch": ("log:fetch", "Fetch the log that a robot keeps in its RAM."),
    "replay": ("log:replay_fetched", "Repeat the decisions of a fetched log and compare them."),
}
STUDY_COMMANDS = {
    "tables": ("research", "Compare the error of both kinds of table with their size."),
    "history": ("research", "Measure a table's error with and without limb use as input."),
    "estimator": ("research", "Estimate states from late, lost, duplicate and wrong fixes."),
    "loop": ("research", "Compare the paper's planner with the robot's in the pool."),
    "twin": ("research", "Compare both planners on a robot fitted to recorded runs."),
    "ceiling": ("research", "Compare one planner with tables or the rods as its model."),
    "foresight": ("research", "Compute the offline bound: how close to a path a plan stays."),
    "weights": ("research", "Tune the planner's weights on random paths, by simulation."),
    "verdicts": ("research", "Put synthetic effects in pools and identify them from logs."),
    "wake": ("research", "Predict the speed over phase offset with a wake model."),
    "water": ("research", "Test theory about added mass and inertia on measurements."),
    "shared": ("research", "Fit one drag of the water to swims and recorded runs."),
    "openloop": ("research", "Fit effects to some measured swims and predict the others."),
    "heldout": ("research", "Cross-validate: predict each run from all other runs."),
    "convergence": ("research", "Measure the error of the rods against their time step."),
    "chip": ("research", "Measure how many cycles a decision takes on the chip."),
}
SECTIONS: dict[str, dict[str, tuple[Any, str]]] = {
    "Start": {
        "demo": ("start:demo", "Run all stages once on the virtual chip and write a report."),
        "doctor": ("start:doctor", "Show what this machine has, and what to install for more."),
        "robot": (ROBOT_COMMANDS, "List and show robots, and write the file of a new one."),
    },
    "Make": {
        "simulate": ("make:simulate", "Simulate a gait, or a sequence of actions."),
        "library": (LIBRARY_COMMANDS, "Simulate transitions for many initial velocities."),
        "tables": (TABLES_COMMANDS, "Make the robot's table image from a library."),
        "codegen": ("make:codegen", "Generate C99 from a table and the planner."),
        "firmware": (FIRMWARE_COMMANDS, "Build, measure, flash and test the robot's firmware."),
    },
    "Run": {
        "pool": ("robots:serve_pool", "Serve a simulated robot at a serial port, with a camera over it."),
        "camera": (CAMERA_COMMANDS, "Calibrate and check the camera, and track or print the tag."),
        "scan": ("robots:scan", "List the robots in Bluetooth range: signal, table and state."),
        "run": ("run:run", "Follow a path in closed loop, from position fixes to strokes."),
        "push": ("robots:push", "Send a robot another table by Bluetooth or serial line."),
        "own": ("robots:own", "Restrict a robot to the commands of its owner."),
        "log": (LOG_COMMANDS, "Show and compare runs, and fetch a robot's own log."),
        "export": ("log:export", "Export a run as CSV or as MCAP."),
    },
    "Learn": {
        "import": ("log:import_", "Import recorded runs and repair or mark their faults."),
        "replay": ("log:replay", "Replay a run's fixes and compare each decision."),
        "identify": ("identify:identify", "Identify the physical effects that a robot's model lacks."),
        "retune": ("identify:retune", "Make a new table for a worn robot."),
    },
    "Research": {
        "parity": ("research:parity", "Check that Python, native C and the chip decide the same bits."),
        "validate": ("research:validate", "Compare the model with simulated and measured swims."),
        "sweep": ("research:sweep", "Simulate every EGaIn fraction, frequency and phase."),
        "study": (STUDY_COMMANDS, "Run a study of the method and draw its figure."),
    },
}
"""Section of the help -> its commands by their names: the place in this package, and one line of help.

The place is ``module:name`` of a function, the module of all studies, or the commands of a group. A command
of a group that has no line of its own is listed with the first sentence of its help.
"""
COMMANDS = {name: command for section in SECTIONS.values() for name, command in section.items()}
LONGER = {
    "camera": "Calibrate and check the camera over the pool, and track or print the robot's tag.",
}
"""Help of a group itself, if it is longer than its line."""


class LazyGroup(TyperGroup):
    """A group that loads a command only when it is called, or listed without a line of its own."""

    table: ClassVar[dict[str, Any]] = {}

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = dict.fromkeys(self.table)  # the names that a typo is compared with

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Load a command and return it, or None if no command has that name."""
        if cmd_name not in self.table:
            return None
        place, text = _entry(self.table[cmd_name])
        if isinstance(place, dict):
            return typer.main.get_command(_group(cmd_name, LONGER.get(cmd_name, text), place))
        name, _, attribute = place.partition(":")
        with ctrl_c_waits():
            from frogkick.cli.options import with_options

            module = importlib.import_module(f"frogkick.cli.{name}")
        parent = typer.Typer(rich_markup_mode=None, add_completion=False)
        parent.callback()(lambda: None)
        found = getattr(module, attribute) if attribute else module.command(cmd_name)
        parent.command(cmd_name, cls=getattr(module, "Command", None))(with_options(found))
        return typer.main.get_group(parent).commands[cmd_name]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the names and the lines of help from the table; the root's are grouped by section."""
        sections = SECTIONS if self.table is COMMANDS else {"Commands": self.table}
        for title, commands in sections.items():
            with formatter.section(title):
                formatter.write_dl(
                    [
                        (name, _entry(entry)[1] or self.get_command(ctx, name).get_short_help_str(limit=200))
                        for name, entry in commands.items()
                    ]
                )


def _entry(entry: str | tuple[Any, str]) -> tuple[Any, str]:
    """Return the place and the line of help of a command."""
    return (entry, "") if isinstance(entry, str) else entry


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
    "Simulate, plan for, flash, run and identify small robots that swim by strokes.",
    COMMANDS,
)


def _print_version(asked: bool) -> None:
    if asked:
        print(f"frogkick {frogkick.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    _version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version),
    ] = False,
) -> None:
    return None
