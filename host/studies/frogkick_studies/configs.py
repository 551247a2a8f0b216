"""The configuration of each study. Its fields are the command's options, its docstring the command's help.

This module loads nothing that computes, so that help is printed at once. An option that several commands
share has no help here: the runner (``frogkick/cli/research.py``) takes it from its name and type.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from typer import Argument, Option

RobotArgument = Annotated[str, Argument(help="TOML file or built-in name.")]
LibraryArgument = Annotated[Path, Argument(help="HDF5 file of 'library build', the larger the better.")]
OwnTableOption = Annotated[
    Path | None, Option(help="Robot's own table; default: affine, 64 KiB, of that library.")
]
PictureOption = Annotated[Path | None, Option(help="Picture to write (PNG).")]


@dataclass(frozen=True)
class Config:
    """Configuration of a study.

    Attributes:
        folder: ``out`` is a folder, in which the picture has the study's name, instead of the picture itself.
    """

    folder: ClassVar[bool] = False

    @property
    def processes(self) -> int:
        """Number of processes: ``workers``, or one for each core."""
        return getattr(self, "workers", 1) or os.cpu_count() or 1


@dataclass(frozen=True)
class Tables(Config):
    """Measure the error of both kinds of table against their size, and compare it with the library's."""

    library: LibraryArgument
    out: PictureOption = None
    test_states: Annotated[
        int, Option(min=4, max=10000, help="Number of unseen states of each sampling.")
    ] = 200
    swims: str = "planned"
    seed: int = 1


@dataclass(frozen=True)
class History(Config):
    """Measure the error of affine tables with and without limb use as an input, also for tiring robots."""

    robot: RobotArgument = "frog2022"
    out: PictureOption = None
    states: Annotated[int, Option(min=50, max=65535, help="Number of states of each library.")] = 400
    test_states: Annotated[int, Option(min=4, max=10000, help="Number of unseen states.")] = 100
    seed: int = 1


@dataclass(frozen=True)
class Estimator(Config):
    """Estimate states from late, lost, duplicate and wrong fixes by three methods.

    The methods are the robot's estimator, a fitted line and the paper's estimate.
    """

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
    """Compare the paper's planner with the robot's at depth 1 to 3: distance to the path and progress.

    The exit code is 1 if, in one of the worlds, the distance of the robot's planner is more than half of the
    paper's or its progress is less, or if the distances at depth 2 and at depth 3 are both larger than at
    depth 1.
    """

    folder: ClassVar[bool] = True
    out: Annotated[
        Path, Option(help="Folder for tables, results and figure; an interrupted study resumes there.")
    ]
    seeds: Annotated[
        int,
        Option(
            min=1, max=1000, help="Runs of each planner along each path; each has other noise of the camera."
        ),
    ] = 20
    path: Annotated[
        list[str] | None,
        Option(
            help="line, sine, ellipse, circle, bends or eight; may be repeated. Default: the first three."
        ),
    ] = None
    world: Annotated[
        list[str] | None,
        Option(
            help="nominal: the plain pool; hidden: a pool with a few effects that are in no model; or a TOML "
            "file of such effects, as for 'run'. May be repeated. Default: nominal and hidden."
        ),
    ] = None
    robot: str = "frog2022"
    library: Annotated[
        Path | None, Option(help="Library for both tables; default: one of 8503 states, made once.")
    ] = None
    tables: OwnTableOption = None
    learn: Annotated[
        bool,
        Option(
            help="Also compare a planner on the host that estimates the wear of the limbs and plans with it."
        ),
    ] = False
    workers: int = 0


@dataclass(frozen=True)
class Twin(Config):
    """Compare the paper's planner with the robot's in the pool, on a robot that was fitted to recorded runs.

    With --runs the paper's planner also plans with the motion that it assumed of each action in these runs,
    which inverse planning recovers from its recorded decisions. The exit code is 1 if the robot's planner,
    with its own table, is more than 10 mm off on average over the shapes or over the recorded runs' paths.
    """

    folder: ClassVar[bool] = True
    out: Annotated[
        Path,
        Option(help="Folder for libraries, tables, results, figure; an interrupted study resumes there."),
    ]
    seeds: Annotated[
        int,
        Option(
            min=1, max=1000, help="Runs of each planner along each path; each has other noise of the camera."
        ),
    ] = 6
    path: Annotated[
        list[str] | None, Option(help="line, sine, ellipse, ...; may be repeated. Default: these 3.")
    ] = None
    runs: Annotated[
        Path | None,
        Option(help="Folder of the paper's recorded runs, whose paths are followed too."),
    ] = None
    robot: Annotated[str, Option(help="TOML file or built-in name; its effects act in the pool.")] = (
        "frog2022-measured"
    )
    model: Annotated[str, Option(help="Robot that the paper's planner has as its model.")] = "frog2022"
    library: Annotated[
        Path | None, Option(help="Library of the robot; default: one of 1000 planned states, made once.")
    ] = None
    model_library: Annotated[
        Path | None, Option(help="Library of the model; default: one of 8503 states, made once.")
    ] = None
    workers: int = 0


@dataclass(frozen=True)
class Ceiling(Config):
    """Compare one planner in the pool with three models: full nearest table, the robot's table and the rods.

    As a model, the rods must simulate every sequence of actions, so the planner looks one or two strokes
    ahead. The beam search of depth 3 and more would need too many simulations.
    """

    library: LibraryArgument
    tables: OwnTableOption = None
    seeds: Annotated[
        int, Option(min=1, max=1000, help="Runs with each model; each has other noise and another start.")
    ] = 8
    depth: Annotated[
        list[int] | None, Option(min=1, max=2, help="Strokes to look ahead; may be repeated.")
    ] = None
    simulated_time: Annotated[float, Option(help="Longest pool time of a run, s.")] = 120.0
    workers: int = 0
    out: PictureOption = None


@dataclass(frozen=True)
class Foresight(Config):
    """Compute the offline bound of a path: plan the whole run at once with the table.

    The plan has no noise, no delay and no limit of time or memory. A planner on the robot stays farther from
    the path. The difference is the loss of the planner; the bound itself is due to the path and the table.
    """

    path: Annotated[str, Option(help="A shape's name or a path file.")] = "sine"
    tables: Path | None = None
    at_least: Annotated[
        float | None,
        Option(
            help="Least progress of a plan, m/s; shown is the plan with it that stays closest to the path."
        ),
    ] = None
    breadth: Annotated[
        int, Option(min=1, max=5000, help="Number of plans kept for each part of the path.")
    ] = 300
    out: PictureOption = None


@dataclass(frozen=True)
class Weights(Config):
    """Tune the weights of a robot's planner on random paths, and test them on others.

    The simulated robot moves as its table says, so this takes minutes. The output goes into the section
    [planner] of the robot's file. A smaller distance counts only without a loss of progress along the path.
    """

    tables: Path | None = None
    model: str | None = None
    depth: int | None = None
    trials: Annotated[
        int, Option(min=16, max=100_000, help="Weights to try, in whole populations of 16.")
    ] = 432
    paths: Annotated[int, Option(min=1, max=1000, help="Random paths to tune on.")] = 10
    runs: Annotated[int, Option(min=1, max=1000, help="Runs along each path.")] = 4
    seed: int = 0


@dataclass(frozen=True)
class Verdicts(Config):
    """Put synthetic effects in simulated pools, identify them from the runs, and count the verdicts.

    The exit code is 1 if a group has fewer than 95 % right verdicts, or if more than 2 % are wrong effects.
    The groups are: no effect, one effect of the catalogue, two effects at once, one from outside the
    catalogue, and laws: effects that a formula can describe, two at once in a fifth of them. An effect is
    wrong if a parameter is farther off than twice its interval. The study also counts how many parameters are
    inside their 95 % intervals.

    Laws are drawn again until the nominal model's error on the test run is 2 to 20 noise floors. The right
    kind of law must be named in 80 % of the cases, and a wrong one in at most 3 %. In 85 % of the cases the
    error must fall by at least 70 % of its distance from the noise floor.
    """

    folder: ClassVar[bool] = True
    out: Annotated[Path, Option(help="Folder for results and figure; resumes there.")]
    seeds: Annotated[int, Option(min=1, max=1000, help="Number of cases of each kind.")] = 5
    cases: Annotated[
        int | None,
        Option(
            min=1, max=10000, help="Number of cases of each group, spread over its kinds; replaces --seeds."
        ),
    ] = None
    first: Annotated[int, Option(min=0, help="First seed.")] = 0
    kind: Annotated[
        list[str] | None, Option(help="Kinds of effect to put in; may be repeated; default: all.")
    ] = None
    laws: Annotated[
        bool, Option(help="Search laws in all groups, as identify does; else only in the last one.")
    ] = False
    tables: Path | None = None
    workers: int = 1


@dataclass(frozen=True)
class Openloop(Config):
    """Fit effects to some groups of measured swims and predict the speeds of the groups left out.

    Without further options each EGaIn fraction and each frequency band is left out once. --train-egain fits
    to one fraction at a time. --train and --test fit to one folder and predict another. Effects are the same
    for every alloy: alloys differ only by their measured limb profiles. Effects are accepted only if groups
    of training swims that the fit leaves out are predicted better by more than the sampling error (paired
    bootstrap over cases). Otherwise the nominal model stays.
    """

    folder: ClassVar[bool] = True
    data_dir: Annotated[
        Path | None, Argument(help="Folder of the paper's data: exp/, profile/; or give --train and --test.")
    ] = None
    train: Annotated[Path | None, Option(help="Folder to fit to, with the layout of DATA_DIR.")] = None
    test: Annotated[Path | None, Option(help="Folder to predict, with the layout of DATA_DIR.")] = None
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
class Wake(Config):
    """Fit how strokes lose thrust in each other's wake, and predict the speed of a gait over phase offset.

    Each measured series over phase offset is held out in turn. The interval of the prediction contains the
    spread of the series' mean levels, the uncertainty of the fit, and the scatter between swims.
    """

    data_dir: Annotated[Path, Argument(help="Folder of the paper's data: exp/, profile/.")]
    egain: Annotated[float, Option(help="EGaIn fraction to predict, per cent.")] = 30.0
    frequency: Annotated[float, Option(help="Frequency to predict, Hz.")] = 1.2
    robot: str = "frog2022"
    out: PictureOption = None
    workers: int = 0


@dataclass(frozen=True)
class Water(Config):
    """Test theory about the water and the frame's inertia on measured swims and recorded runs.

    Each hypothesis has its values from theory. Speeds of measured swims are predicted with one factor, which
    is fitted to the other groups. The recorded runs of DATA_DIR/control are predicted one period ahead.
    """

    data_dir: Annotated[Path, Argument(help="Folder of the paper's data: exp/, profile/, control/.")]
    joint: Annotated[
        bool,
        Option(
            help="Also fit the effects of a calibrated robot together with each hypothesis (half an hour)."
        ),
    ] = False
    robot: str = "frog2022"
    out: PictureOption = None
    workers: int = 0


@dataclass(frozen=True)
class Shared(Config):
    """Fit the water's drag to measured swims and recorded runs together, with one drag for all robots.

    Alloys have an amplitude and a time scale, builds an offset, each with a prior; what is not known is
    integrated over. Groups of swims and recorded runs are held out in turn. They are predicted with a drag
    that was fitted to the others of their kind, and with one drag for both; runs also with that of the swims.
    """

    data_dir: Annotated[Path, Argument(help="Folder of the paper's data: exp/, profile/, control/.")]
    runs: Annotated[bool, Option(help="Also fit recorded runs (ten minutes of one core).")] = True
    robot: str = "frog2022"
    out: PictureOption = None
    workers: int = 0


@dataclass(frozen=True)
class Heldout(Config):
    """Cross-validate identification: predict each run with the effects identified from all others.

    The result shows how well identification generalises for this robot: every period is predicted once, by
    effects that were identified without it. Fits of many effects start from nominal values, never from a
    built-in robot that was calibrated before. The exit code is 1 if the effects predict worse than the
    nominal model.
    """

    runs: Annotated[list[Path], Argument(help="Three runs or more: logs, or recorded runs (.csv).")]
    robot: str | None = None
    effects: Annotated[
        Path | None, Option(help="Python file with your own effects, which are tried as well.")
    ] = None
    out: PictureOption = None
    workers: int = 0


@dataclass(frozen=True)
class Convergence(Config):
    """Measure the error of the rod simulation against its time step.

    The exit code is 1 if the error of the default step is too large.
    """

    robot: RobotArgument = "frog2022"
    out: PictureOption = None
    every: Annotated[int, Option(min=1, max=100, help="Use only every n-th gait.")] = 1


@dataclass(frozen=True)
class Chip(Config):
    """Measure how long the chip takes to plan: cycles of the flashed image over many states.

    A model of the planner's blocks finds the most expensive states, and only these are run on the virtual
    chip. "run" is their number, "model_error" the largest error of the model, and "unrun_ms" its bound for
    all other states. "band_ms" is the worst decision by the least and by the most cycles that the manuals
    allow an instruction. The exit code is 1 if a limit is exceeded.
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
        Tables, History, Estimator, Loop, Twin, Ceiling, Foresight, Weights, Verdicts, Openloop, Wake, Water,
        Shared, Heldout, Convergence, Chip,
    )
}  # fmt: skip
"""Name of each study, of its command and of its module."""
