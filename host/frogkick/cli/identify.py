"""``frogkick identify``: the effects that the model lacks, identified from runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

import frogkick as fk
from frogkick.cli.common import JsonOption, LawsOption, NominalOption, say_left_out, show
from frogkick.core.files import require_writable

if TYPE_CHECKING:
    from frogkick.front.identifying import Horizon, Outcome


def horizon_line(horizon: Horizon) -> str:
    """Return the multi-step prediction errors as a line of text."""
    before, after = horizon.before, horizon.after
    return f"{horizon.periods} periods ahead: {before} before, {after} after ({before.count} starts)"


def _text(outcome: Outcome) -> str:
    from frogkick.report.law_words import sentence_of

    lines = [f"verdict: {outcome.verdict}" + (f" ({outcome.reason})" if outcome.reason else "")]
    for term, row in zip(outcome.terms, outcome.parameters, strict=True):
        values = ", ".join(f"{p.name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit}" for p in row)
        lines.append(f"effect {term.title}: {values}")
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
    """Return the lines about log score, repeatability, drift and dropped effects."""
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
    if outcome.dropped:
        lines.append(
            f"dropped, because the test runs are no likelier with them: {', '.join(outcome.dropped)}"
        )
    return lines


def command(
    train: Annotated[list[Path], typer.Option(help="Runs to fit to: logs, or recorded runs (.csv).")],
    test: Annotated[list[Path], typer.Option(help="Runs to predict; nothing is fitted to them.")],
    out: Annotated[
        Path, typer.Option(help="Robot TOML file to write: the nominal robot with the identified effects.")
    ],
    effects: Annotated[
        Path | None, typer.Option(help="Python file with your own effects, which are tried as well.")
    ] = None,
    robot: NominalOption = None,
    predictions: Annotated[
        Path | None,
        typer.Option(help="CSV file to write, with the prediction of each period of the test runs."),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="HTML report to write.")] = None,
    measured: Annotated[
        bool,
        typer.Option(
            help="Start fits of many effects from built-in robots that were calibrated before. With "
            "--no-measured the fits start from the same effects at nominal values."
        ),
    ] = True,
    laws: LawsOption = True,
    json: JsonOption = False,
) -> None:
    """Identify the physical effects that a robot's model lacks. The exit code is 0 for any verdict."""
    for target in (out, predictions, report):
        require_writable(target)
    found = fk.identify(
        train, test=test, robot=robot, effects=effects, measured=measured, laws=laws, progress=True
    )
    say_left_out(found.outcome.left_out)
    found.robot.save(out)
    if predictions is not None:
        found.predictions(predictions)
    if report is not None:
        found.report(report)
    show(found.as_json(), json, _text(found.outcome))


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
