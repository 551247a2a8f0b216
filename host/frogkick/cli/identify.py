"""``frogkick identify``: what a robot's model lacks; ``retune``: a new table for a robot that has changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

import frogkick as fk
from frogkick.cli import options as opt
from frogkick.cli.common import Result, save, say_left_out, undone
from frogkick.cli.robots import text_of

if TYPE_CHECKING:
    from frogkick.front.identifying import Horizon, Outcome
    from frogkick.front.retuning import Retuning

STATES = 800
"""The value of frogkick.front.retuning, repeated so that a command's help does not load that module."""
STATES_LEAST = 46
"""The value of WHOLE_MIN of frogkick.library.fitting, repeated for the same reason."""


def horizon_line(horizon: Horizon) -> str:
    """Return the multi-step prediction errors as a line of text."""
    before, after = horizon.before, horizon.after
    return f"{horizon.periods} periods ahead: {before} before, {after} after ({before.count} starts)"


def _effect_lines(outcome: Outcome) -> list[str]:
    """Return a line for each effect that was found, with the interval of each parameter."""
    lines = []
    for term, row in zip(outcome.terms, outcome.parameters, strict=True):
        lines.append(f"effect {term.title}: {', '.join(map(str, row))}")
    return lines


def _identified(outcome: Outcome) -> str:
    from frogkick.report.laws import sentence_of

    lines = [f"verdict: {outcome.verdict}" + (f" ({outcome.reason})" if outcome.reason else "")]
    for line, term in zip(_effect_lines(outcome), outcome.terms, strict=True):
        lines.append(line)
        effect = term.effect()
        if isinstance(effect, fk.effects.Law):
            lines.append(f"  {sentence_of(effect)}")
    if not outcome.reason:
        for name, error in (
            ("before", outcome.tested.before),
            ("after", outcome.tested.after),
            ("noise floor", outcome.tested.noise_floor),
        ):
            lines.append(f"{name}: {error} RMS one period ahead")
        lines += _further_lines(outcome)
        lines += [horizon_line(each) for each in outcome.horizons if each.periods > 1]
        lines.append(str(outcome.diagnostics["text"]))
        lines += [] if outcome.experiment is None else [outcome.experiment.text]
    return "\n".join(lines)


def _further_lines(outcome: Outcome) -> list[str]:
    """Return the lines about log score, repeatability, drift, and effects not tried or dropped."""
    tested, lines = outcome.tested, []
    if tested.gain is not None:
        gain = tested.gain
        lines.append(f"log score gain: {gain.value:.2f} [{gain.low:.2f}, {gain.high:.2f}] nats per period")
    if tested.repeatability.count:
        lines.append(f"repeatability: {tested.repeatability} RMS between strokes from similar states")
    if outcome.followed is not None:
        followed = outcome.followed
        both = f"{followed.before} before, {followed.after} after"
        lines.append(f"with the drift of each run estimated: {both}")
    if outcome.ended_early:
        lines.append(
            f"the search ended by its bound, after {outcome.evaluations} simulations of the training runs: "
            "effects may be missing"
        )
    lines += outcome.untried
    if outcome.dropped:
        lines.append(
            f"dropped, because the test runs are no more likely with them: {', '.join(outcome.dropped)}"
        )
        lines += [outcome.few_tested] if outcome.few_tested else []
    return lines


def identify(
    train: Annotated[list[Path], "Runs to fit to: logs, or recorded runs (.csv)."],
    test: Annotated[list[Path], "Runs to predict; nothing is fitted to them."],
    out: Annotated[Path, "Robot TOML file to write: the nominal robot with the identified effects."],
    effects: Annotated[Path | None, "Python file with your own effects, which are tried as well."] = None,
    robot: opt.Nominal = None,
    predictions: Annotated[
        Path | None, "CSV file to write, with the prediction of each period of the test runs."
    ] = None,
    report: Annotated[Path | None, "HTML report to write."] = None,
    measured: Annotated[
        bool,
        "Start fits of many effects from built-in robots that were calibrated before. With --no-measured "
        "the fits start from the same effects at nominal values.",
    ] = True,
    laws: opt.Laws = True,
) -> Result:
    """Identify the physical effects that a robot's model lacks. The exit code is 0 for any verdict."""
    found = opt.call(fk.identify, locals(), runs=train, progress=True)
    say_left_out(found.outcome.left_out)
    save(found.robot.save, out)
    if predictions is not None:
        save(found.predictions, predictions)
    if report is not None:
        save(found.report, report)
    return Result(found.as_json(), [_identified(found.outcome)])


class Command(TyperCommand):
    """A command whose --train and --test take several runs: ``--train a b`` is ``--train a --train b``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, spread(args))


def spread(args: list[str]) -> list[str]:
    """Repeat --train and --test before each of the values that follow them."""
    flat: list[str] = []
    option, first = "", True
    for argument in args:
        if argument.startswith("-"):
            option, first = argument if argument in ("--train", "--test") else "", True
            flat.append(argument)
            continue
        flat += [argument] if first or not option else [option, argument]
        first = False
    return flat


def retune(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="The robot's last runs: logs, or recorded runs (.csv). The last one is the test run."
        ),
    ],
    out: Annotated[
        Path, "New folder for the robot's TOML file, library, table and firmware.", opt.With(folder=True)
    ],
    robot: Annotated[
        str | None,
        "TOML file or built-in name that the robot's table was made from; default: the robot in the logs.",
        opt.With(names=opt.FILE),
    ] = None,
    tables: Annotated[
        Path | None, "Table image that the robot carries (.fkt), to compare with; default: made from --robot."
    ] = None,
    states: Annotated[
        int, "Number of states of the simulated libraries.", opt.With(STATES_LEAST, 65535)
    ] = STATES,
    workers: opt.Workers = 0,
    push: Annotated[
        str | None,
        "Send the new table, if it is better, to ble:NAME, serial:PORT or virtual. The robot keeps the old "
        "one.",
        opt.With(metavar="TARGET"),
    ] = None,
    key: opt.Key = None,
    laws: opt.Laws = True,
    seed: opt.Seed = 0,
) -> Result:
    """Make a new table for a worn robot.

    The exit code is 1 if the new table predicts held-out periods no better, if paths are followed worse with
    it in a simulated pool with the identified effects, or if the runs are too short.
    """
    from frogkick.front.retuning import TABLES, retune

    made = opt.call(retune, locals(), table=tables, left_out=say_left_out, progress=True)
    if made.not_pushed is not None:
        undone.append(
            f"the new table was made but not sent: {made.not_pushed}; then send it with 'frogkick push "
            f"{out / TABLES} --robot {push}'"
        )
    remarks = [] if made.done else [made.reason]
    return Result(made.as_json(), [printed(made, push)], made.done, remarks)


def printed(made: Retuning, push: str | None = None) -> str:
    """Return the result as text for people; ``push`` is the robot that the table was sent to."""
    lines = [f"verdict: {made.outcome.verdict}", f"held out: {made.held_out}"]
    lines += _effect_lines(made.outcome)
    for name, error in (("old", made.before), ("new", made.after)):
        if error.count:
            lines.append(
                f"{name} table, held-out periods: {error} RMS one period ahead ({error.count} periods)"
            )
    for name, error in zip(("old", "new"), made.on_runs or (), strict=False):
        lines.append(
            f"{name} table, states of all runs: {error} RMS from the rods with the identified effects "
            f"({error.count} periods)"
        )
    if made.loop is not None:
        for name, tracked in zip(("old", "new"), made.loop, strict=True):
            lines.append(
                f"{name} table in closed loop, in a simulated pool with the identified effects: "
                f"{1e3 * tracked.mean_distance_m:.1f} mm from the path, "
                f"{1e3 * tracked.progress_mps:.1f} mm/s along it, "
                f"{tracked.completed} of {tracked.runs} runs completed"
            )
    if made.lost is not None:
        lines.append(f"no table can contain: {', '.join(made.lost.effects)}")
        apart = (1e3 * each.mean_distance_m for each in (made.lost.with_them, made.lost.without))
        lines.append(
            "the robot's table in closed loop: {:.1f} mm from the path with these in the pool, {:.1f} mm "
            "without them".format(*apart)
        )
    lines += [f"table, {horizon_line(each)}" for each in made.horizons if each.periods > 1]
    if made.done and made.reason:
        lines.append(made.reason)
    if made.better and made.tables is not None:
        lines.append(f"new table: {made.tables['file']}, firmware: {made.out / 'firmware'}")
        lines.append(f"old table, to return to: {made.out / 'before.fkt'}")
    if push is not None and made.pushed is not None:
        lines.append(text_of(made.pushed, push))
    return "\n".join(lines)
