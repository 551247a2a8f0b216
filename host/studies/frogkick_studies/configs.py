"""What each study is told: a configuration is the command's options, and its text is the command's help.

Nothing that computes is loaded here, so that help is there at once. An option that several commands have
stands without its help: the runner (``frogkick/cli/study.py``) knows it by its name and type.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from typer import Argument, Option

RobotArgument = Annotated[str, Argument(help="TOML file or built-in name.")]
LibraryArgument = Annotated[Path, Argument(help="HDF5 file of 'library build', the larger the better.")]
PictureOption = Annotated[Path | None, Option(help="Picture to write (PNG).")]


@dataclass(frozen=True)
class Config:
    """Configuration of a study.

    Attributes:
        folder: ``out`` is a folder, in which the picture has the study's name, instead of the picture itself.
    """

    folder: ClassVar[bool] = False


@dataclass(frozen=True)
class Tables(Config):
    """Error of tables of both kinds against their size, and against the library's."""

    library: LibraryArgument
    out: PictureOption = None
    test_states: Annotated[int, Option(min=4, max=10000, help="Unseen states of each sampling.")] = 200
    swims: str = "planned"
    seed: int = 1


@dataclass(frozen=True)
class History(Config):
    """Error of affine tables with and without limb use as an input, for this robot and tiring ones."""

    robot: RobotArgument = "frog2022"
    out: PictureOption = None
    states: Annotated[int, Option(min=50, max=65535, help="States of each library.")] = 400
    test_states: Annotated[int, Option(min=4, max=10000, help="Unseen states.")] = 100
    seed: int = 1


@dataclass(frozen=True)
class Estimator(Config):
    """States from late, lost, doubled and wrong fixes in the pool: the robot's way, a line, the paper's."""

    tables: Path | None = None
    model: str | None = None
    path: Annotated[list[str] | None, Option(help="line, sine, ellipse, or a CSV file as for 'run'.")] = None
    rate: Annotated[list[float] | None, Option(help="Fixes per second; may be repeated.")] = None
    planner: str = "robot"
    depth: int | None = None
    seeds: Annotated[int, Option(min=1, max=1000, help="Runs along each path.")] = 3
    simulated_time: Annotated[float, Option(help="Longest pool time of a run, s.")] = 60.0
    workers: int = 1
    out: PictureOption = None


@dataclass(frozen=True)
class Loop(Config):
    """Distance to the path and progress: the paper's planner against the robot's, depth 1 to 3.

    Exit 1 where, in a world and over all paths, the robot's planner is not at most half as far off as the
    paper's at no less progress, or depth 2 and 3 are both further off than depth 1.
    """

    folder: ClassVar[bool] = True
    out: Annotated[Path, Option(help="Folder for tables, results and figure; resumes there.")]
    seeds: Annotated[int, Option(min=1, max=1000, help="Runs of each, by the camera's noise.")] = 20
    path: Annotated[
        list[str] | None,
        Option(help="line, sine, ellipse, circle, bends or eight; again for more. Default: the first 3."),
    ] = None
    world: Annotated[
        list[str] | None,
        Option(
            help="nominal: the plain pool; hidden: with a few effects that no model knows; or a TOML of such "
            "effects, as for 'run'. Again for more. Default: nominal and hidden."
        ),
    ] = None
    robot: str = "frog2022"
    library: Annotated[
        Path | None, Option(help="Library for both tables; default: one of 8503 states, made once.")
    ] = None
    tables: Annotated[
        Path | None, Option(help="Robot's own table; default: affine, 64 KiB, of that library.")
    ] = None
    workers: int = 0


@dataclass(frozen=True)
class Twin(Config):
    """The paper's planner and the robot's in the pool of a robot as its recorded runs show it.

    Exit 1 where the robot's planner, with its own table, is more than 10 mm off on average: over the shapes,
    or over the recorded runs' paths. With --runs the paper's planner also swims with what it believed of
    each action, as its recorded decisions show.
    """

    folder: ClassVar[bool] = True
    out: Annotated[Path, Option(help="Folder for libraries, tables, results, figure; resumes there.")]
    seeds: Annotated[int, Option(min=1, max=1000, help="Runs of each, by the camera's noise.")] = 6
    path: Annotated[
        list[str] | None, Option(help="line, sine, ellipse, ...; again for more. Default: these 3.")
    ] = None
    runs: Annotated[
        Path | None,
        Option(help="Folder of the paper's recorded runs: their paths too, from where they began."),
    ] = None
    robot: Annotated[str, Option(help="TOML file or built-in name; its effects are true in the pool.")] = (
        "frog2022-measured"
    )
    model: Annotated[str, Option(help="What the paper's planner takes it for.")] = "frog2022"
    library: Annotated[
        Path | None, Option(help="Library of the robot; default: one of 1000 planned states, made once.")
    ] = None
    model_library: Annotated[
        Path | None, Option(help="Library of the model; default: one of 8503 states, made once.")
    ] = None
    workers: int = 0


@dataclass(frozen=True)
class Ceiling(Config):
    """One planner in the pool, told by a full nearest table, by the robot's, or by the rods themselves.

    Each --depth that the rods look further takes as many times longer as the robot has actions.
    """

    library: LibraryArgument
    tables: Annotated[
        Path | None, Option(help="Robot's own table; default: affine, 64 KiB, of that library.")
    ] = None
    seeds: Annotated[int, Option(min=1, max=1000, help="Runs of each, by noise and start.")] = 8
    depth: Annotated[
        list[int] | None, Option(min=1, max=3, help="Strokes to look ahead; may be repeated.")
    ] = None
    simulated_time: Annotated[float, Option(help="Longest pool time of a run, s.")] = 120.0
    workers: int = 0
    out: PictureOption = None


@dataclass(frozen=True)
class Foresight(Config):
    """How near to a path any plan could stay, and how fast: the whole run planned at once, by the table.

    No noise, no delay, no limit of time or memory. A planner on the robot stays further off; by how much
    more tells what it misses, and the rest is what the path asks of the robot.
    """

    path: Annotated[str, Option(help="A shape's name or a path file.")] = "sine"
    tables: Path | None = None
    at_least: Annotated[
        float | None, Option(help="Progress that a plan has to make, m/s: tells the nearest such one.")
    ] = None
    breadth: Annotated[int, Option(min=1, max=5000, help="Plans kept for each part of it.")] = 300
    out: PictureOption = None


@dataclass(frozen=True)
class Verdicts(Config):
    """Plant effects in simulated pools, identify them from the runs, and count what comes out.

    Exit 1 where a group has fewer right verdicts than asked: 95 % with nothing planted, with one effect of
    the catalogue and with one from outside; 90 % with two at once; or where more than 2 % are wrongly found.
    An effect with a parameter farther off than twice its interval is wrong. How many parameters are inside
    their intervals of 95 % is counted beside it.
    """

    folder: ClassVar[bool] = True
    out: Annotated[Path, Option(help="Folder for results and figure; resumes there.")]
    seeds: Annotated[int, Option(min=1, max=1000, help="Cases of each kind.")] = 5
    cases: Annotated[
        int | None,
        Option(min=1, max=10000, help="Cases of each group, its kinds in turn, instead of --seeds."),
    ] = None
    first: Annotated[int, Option(min=0, help="First seed.")] = 0
    kind: Annotated[list[str] | None, Option(help="Kinds to plant; may be given again; default: all.")] = None
    tables: Path | None = None
    workers: int = 1


@dataclass(frozen=True)
class Openloop(Config):
    """Fit effects to some groups of measured swims and predict the speeds of those left out.

    Without further options each EGaIn fraction and each band of frequency is left out in turn; --train-egain
    fits to one fraction at a time; --train and --test fit to one folder and predict another. Effects are the
    same for every alloy: alloys differ by their measured limb profiles alone. Effects are taken up only where
    groups of the training swims that are left out of the fit are predicted better by more than the sampling
    error (paired bootstrap over cases); else the nominal model stays.
    """

    folder: ClassVar[bool] = True
    data_dir: Annotated[
        Path | None, Argument(help="The paper's data: exp/, profile/; or give --train and --test.")
    ] = None
    train: Annotated[Path | None, Option(help="Folder to fit to, all of it, laid out as DATA_DIR.")] = None
    test: Annotated[Path | None, Option(help="Folder to predict, laid out as DATA_DIR.")] = None
    train_egain: Annotated[
        list[float] | None, Option(help="EGaIn fraction to fit to, per cent; may be repeated.")
    ] = None
    test_egain: Annotated[
        list[float] | None, Option(help="Fraction to predict; may be repeated; default: all others.")
    ] = None
    robot: str = "frog2022"
    out: Annotated[Path | None, Option(help="Folder for openloop.png and a robot's TOML for each fit.")] = (
        None
    )
    workers: int = 0


@dataclass(frozen=True)
class Heldout(Config):
    """Keep each run back in turn, learn from all others what the model lacks, and predict it with that.

    How far identification may be trusted on this robot: every period is predicted once, by effects that were
    found without it. Fits of many effects start from nominal values, never from a built-in robot that was
    measured before. Exit 1 where what was found predicts worse than the nominal model.
    """

    runs: Annotated[list[Path], Argument(help="Three runs or more: logs, or recorded runs (.csv).")]
    robot: str | None = None
    effects: Annotated[Path | None, Option(help="Python file with effects of your own, tried as well.")] = (
        None
    )
    out: PictureOption = None
    workers: int = 0


@dataclass(frozen=True)
class Convergence(Config):
    """Error of the rod simulation against its time step. Exit 1 if the default step errs too much."""

    robot: RobotArgument = "frog2022"
    out: PictureOption = None
    every: Annotated[int, Option(min=1, max=100, help="Take every so many-th gait.")] = 1


@dataclass(frozen=True)
class Chip(Config):
    """How long the chip plans: cycles of the flashed image over many states. Exit 1 over a limit.

    Of very many states the dearest are run on the virtual chip, which a model of the planner's blocks finds
    among all of them: "run" is how many, "model_error" its largest error, "unrun_ms" its bound of the rest.
    "band_ms": the worst decision by the least and by the most that the manuals allow an instruction.
    """

    tables: Path | None = None
    model: str | None = None
    states: Annotated[int, Option(min=12, max=1_000_000, help="Decisions at each depth.")] = 300
    planner: str = "robot"
    workers: int = 1
    seed: int = 0


STUDIES: Mapping[str, type[Config]] = {
    kind.__name__.lower(): kind
    for kind in (
        Tables, History, Estimator, Loop, Twin, Ceiling, Foresight, Verdicts, Openloop, Heldout, Convergence,
        Chip,
    )
}  # fmt: skip
"""Name of each study, of its command and of its module."""
