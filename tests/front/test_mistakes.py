"""Plausible mistakes in Python: each is refused in one line that names what was given and what to give."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

import frogkick as fk
from frogkick.core.arguments import ArgumentError, fits, typed
from frogkick.core.files import sole_writer
from frogkick.core.progress import Progress
from frogkick.front.retune_tables import TableMaker

MISTAKES: dict[str, tuple[Callable[[Any], object], str]] = {
    "an action's number": (lambda _: fk.simulate("frog2022", [1]), "no action 1: choose from A, B"),
    "a length as text": (lambda _: fk.paths.line("1"), "line: length '1' m: give a finite length"),
    "a number of actions": (lambda _: fk.simulate("frog2022", 3), "actions is 3: give names"),
    "mm/s": (lambda _: fk.simulate("frog2022", "B", velocity_body=(20, 0, 0)), "(20, 0, 0): give forward"),
    "two velocities": (
        lambda _: fk.simulate("frog2022", "B", velocity_body=(0.01, 0)),
        "(0.01, 0): give forward",
    ),
    "a column as a velocity": (
        lambda _: fk.simulate("frog2022", "B", velocity_body=np.zeros((3, 1))),
        "array([[0.],        [0.],        [0.]]): give forward",
    ),
    "one velocity": (lambda _: fk.simulate("frog2022", "B", velocity_body=0.02), "0.02: give forward"),
    "a velocity as text": (lambda _: fk.simulate("frog2022", "B", velocity_body="0,0,0"), "'0,0,0': give"),
    "a frequency as text": (lambda _: fk.simulate("frog2022", frequency_hz="0.7"), "frequency_hz is '0.7'"),
    "actions without an order": (
        lambda _: fk.simulate("frog2022", {"B", "C"}),
        "give names, as 'B,B,C' or ['B', 'B', 'C']",
    ),
    "a count of each action": (
        lambda _: fk.simulate("frog2022", {"B": 2}),
        "actions is {'B': 2}: give names",
    ),
    "a velocity without an order": (
        lambda _: fk.simulate("frog2022", "B", velocity_body={0.1, 0.2, 0.3}),
        "give forward and left in m/s",
    ),
    "a calibration that is not there": (
        lambda _: fk.Camera("missing.toml"),
        "calibration 'missing.toml' does not exist: check the path",
    ),
    "a robot as a calibration": (
        lambda robot: fk.Camera(robot),
        "calibration is given as Robot: give a file's name",
    ),
    "half a cycle": (lambda _: fk.simulate("frog2022", cycles=2.5), "cycles is 2.5: give 1 or more"),
    "states as a float": (lambda _: fk.build_library("frog2022", 100.0), "states is 100.0: give 1 to 65535"),
    "states as text": (lambda _: fk.build_library("frog2022", "100"), "states is '100': give 1 to 65535"),
    "a seed as text": (lambda _: fk.build_library("frog2022", 10, "a"), "seed is 'a': give 0 or more"),
    "a seed that no file holds": (
        lambda _: fk.build_library("frog2022", 10, 2**63),
        "a whole number below 2^63",
    ),
    "a library of a robot with a replaced value that is out of range": (
        lambda robot: fk.build_library(replace(robot, pulse_s=-0.07), 2),
        "robot 'frog2022' with replaced values: pulse_s is '-0.07'",
    ),
    "the table of a robot with such a value": (
        lambda robot: fk.load_table(robot=replace(robot, pulse_s=-0.07)),
        "robot 'frog2022' with replaced values: pulse_s is '-0.07'",
    ),
    "a number as a sampling": (lambda _: fk.build_library("frog2022", 10, sampling=5), "sampling"),
    "a number as a target": (lambda _: fk.connect(5).__enter__(), "5"),
    "a name as long as no file's": (lambda _: fk.load_robot("x" * 5000), "name a TOML file or one of"),
    "a log's name as long as no file's": (lambda _: fk.load_run("x" * 5000), "name too long; check the path"),
    "a robot as library": (lambda robot: fk.fit_table(robot), "library is given as Robot: give a file"),
    "a robot as table": (lambda robot: fk.load_table(robot), "table image is given as Robot: give a file"),
    "an effect's name as world": (
        lambda _: fk.World("limb_wear"),
        "effects of a world are 'limb_wear': give a list",
    ),
    "an effect without a list": (
        lambda _: fk.World(fk.effects.LimbWear(limb="rear_left")),
        "effects of a world are limb_wear(",
    ),
    "a shape as waypoints": (
        lambda _: fk.paths.from_waypoints("line"),
        "waypoints are not numbers: give (k, 2)",
    ),
    "a path's name first": (
        lambda _: fk.Path("p", [0, 0.1], [0, 0], [0, 0]),
        "x_m is not a row of numbers: give x_m",
    ),
    "a folder to save to": (lambda robot: robot.save("."), "cannot write '.': it is a folder"),
    "a file as the folder to save to": (
        lambda robot: robot.save(f"{__file__}/robot.toml"),
        "robot.toml': a folder in this path is a file; choose another --out",
    ),
    "a library in no folder": (
        lambda _: fk.build_library("frog2022", 2, workers=1, out="nofolder/"),
        "cannot write 'nofolder/': a name that ends in a slash",
    ),
    "a folder to make and save to": (
        lambda robot: robot.save("nofolder/"),
        "cannot write 'nofolder/': a name that ends in a slash is a folder's; name a file in it",
    ),
    "no period": (lambda robot: robot.at_period(0), "period_s is 0: give a time above 0"),
    "a retune of too many states": (
        lambda _: TableMaker(10**9, 0, 1),
        "states is 1000000000: give 1 to 65535",
    ),
    "a retune of too few states": (lambda _: TableMaker(45, 0, 1), "states is 45: give 46 or more"),
    "a retune by no process": (lambda _: TableMaker(800, 0, -1), "workers is -1: give 1 to 256"),
    "a retune with a negative seed": (lambda _: TableMaker(800, -1, 1), "seed is -1: give 0 or more"),
    "a table as runs": (lambda robot: fk.identify(robot, test=[robot]), "runs are given as Robot: give runs"),
    "a run to train on and to test": (
        lambda _: fk.identify(["a.h5", "b.h5"], test="./b.h5"),
        "run 'b.h5' is a training run and a test run: its test would show how well it was fitted",
    ),
    "a run alone that does not exist": (
        lambda _: fk.retune("a.h5", robot="frog2022", out="new"),
        "run 'a.h5' does not exist",
    ),
    "a robot to emit": (
        lambda robot: fk.emit_c(robot, "emitted"),
        "table image is given as Robot: give a file",
    ),
}
OF_A_TABLE: dict[str, tuple[Callable[[Any], object], str]] = {
    "a number to save to": (lambda t: t.save(3), "file to write is given as int: give its name"),
    "a robot where it is": (lambda t: fk.run(t, robot=t.robot), "--robot is Robot('frog2022'"),
    "a seed that no log holds": (lambda t: fk.run(t, seed=2**63), "a whole number below 2^63"),
    "a folder as a log": (lambda t: fk.run(t, out="."), "is a folder: name a file in it"),
    "a log in no folder": (
        lambda t: fk.run(t, out="nofolder/"),
        "cannot write 'nofolder/': a name that ends",
    ),
    "a log where none can be": (lambda t: fk.run(t, out="/proc/r.h5"), "cannot write '/proc/r.h5'"),
    "a number as a plan": (lambda t: fk.run(t, plan=5), "5"),
    "a number as a planner": (lambda t: fk.Planner(t, planner=5), "5"),
    "a seed with a point": (lambda t: fk.run(t, seed=1.5), "seed is 1.5: give 0 or more"),
    "seconds as text": (lambda t: fk.run(t, time_limit_s="30"), "simulated time is '30' s: give"),
    "a depth as text": (
        lambda t: fk.Planner(t, depth="3"),
        "--depth is '3', allowed is 1 to 4",
    ),
    "a place beyond the path": (
        lambda t: fk.Planner(t).plan([0] * 6, "line", along_points=100),
        "along_points is 100: give 0 to 99, the points of the path counted from 0",
    ),
    "no place": (
        lambda t: fk.Planner(t).plan([0] * 6, "line", along_points=float("nan")),
        "along_points is nan: give 0 to 99",
    ),
    "a use of each of four limbs": (
        lambda t: fk.Planner(t).plan([0] * 6, "line", limb_use=[0] * 4),
        "limb_use is [0, 0, 0, 0]: give 8 whole numbers, 0 (rested) to 32767",
    ),
    "a share as the use of a limb": (
        lambda t: fk.Planner(t).plan([0] * 6, "line", limb_use=[0.5] * 8),
        "give 8 whole numbers",
    ),
    "seconds as another path": (lambda t: fk.run(t, then=3), "then is 3, give 'PATH@SECONDS' | Sequence["),
    "a pose alone": (lambda t: fk.Planner(t).plan([0, 0, 0], "line"), "state is [0, 0, 0]: give six numbers"),
    "degrees as radians": (
        lambda t: fk.Planner(t).plan([0, 0, 90, 0, 0, 0], "line"),
        "the heading of the state is 90 rad, which is more than two turns: give radians, not degrees",
    ),
    "a table as library": (lambda t: fk.fit_table(t), "library is given as Table: give a file"),
    "a limb's number": (
        lambda t: fk.run(t, world=fk.World([fk.effects.LimbWear(limb=2, gain=0.7)])),
        "has no limb 2: it has front_right",
    ),
}


@pytest.fixture(scope="module")
def robot() -> fk.Robot:
    return fk.load_robot("frog2022")


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_in_one_line(mistake: str, robot: fk.Robot) -> None:
    do, reported = MISTAKES[mistake]
    with pytest.raises(fk.InputError) as refused:
        do(robot)
    assert reported in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_mistyped_name_of_the_front_door_gets_the_nearest() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'identfy' \(did you mean 'identify'\?\)"):
        _ = fk.identfy


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> fk.Table:
    return fk.fit_table(fk.build_library("frog2022", 2, workers=1))


@pytest.mark.parametrize("mistake", OF_A_TABLE)
def test_a_mistake_with_a_table_is_told_in_one_line(mistake: str, table: fk.Table) -> None:
    do, reported = OF_A_TABLE[mistake]
    with pytest.raises(fk.InputError) as refused:
        do(table)
    assert reported in str(refused.value)
    assert "\n" not in str(refused.value)


def test_two_libraries_are_not_built_into_one_file(tmp_path: Path) -> None:
    with (
        sole_writer(tmp_path / "lib.h5"),
        pytest.raises(fk.InputError, match="another process is about to write"),
    ):
        fk.build_library("frog2022", 2, workers=1, out=tmp_path / "lib.h5")
    assert list(tmp_path.iterdir()) == []


def test_a_budget_as_text_is_told(robot: fk.Robot, table: fk.Table) -> None:
    library = fk.build_library(robot, 2, workers=1)
    with pytest.raises(fk.InputError, match="budget is '64' KiB: give"):
        fk.fit_table(library, budget_kib="64")


NO_TYPE = object()
"""Fits no declared type."""
CONSTRUCTED = {"Path", "Planner", "World"}
"""Classes that are made by hand; the other ones are results, and keep what they are given."""


EFFECTS = ("make_effect", "make_effects", "read_world", "changed_robot", "rods_of", "body_effects")


def public() -> dict[str, Callable[..., Any]]:
    """Every function and method of the front door that takes arguments, by its name in errors."""
    found: dict[str, Callable[..., Any]] = {name: getattr(fk.paths, name) for name in fk.paths.SHAPES}
    found |= {name: getattr(fk.paths, name) for name in ("shape", "from_csv", "from_waypoints", "wrap_angle")}
    found |= {name: getattr(fk.effects, name) for name in EFFECTS}
    for name in fk.__all__:
        one = getattr(fk, name)
        if inspect.isfunction(one):
            found[name] = one
        elif inspect.isclass(one) and not issubclass(one, BaseException):
            found |= {name: one} if name in CONSTRUCTED else {}
            for of in vars(one):
                if not of.startswith("_") and callable(getattr(one, of)):
                    found[f"{name}.{of}"] = getattr(one, of)
    return {name: one for name, one in found.items() if set(inspect.signature(one).parameters) - {"self"}}


PUBLIC = public()


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory, robot: fk.Robot, table: fk.Table) -> dict[str, Any]:
    """Arguments that fit, by their names and by those of classes, as small as the work may be."""
    folder = tmp_path_factory.mktemp("given")
    run = fk.run(table, time_limit_s=1.0)
    (folder / "world.toml").write_text("")
    return {
        "Robot": robot, "Table": table, "Run": run, "Path": fk.paths.line(), "Planner": fk.Planner(table),
        "Library": fk.build_library(robot, 1, workers=1), "name_or_path": robot, "robot": robot, "library":
        folder / "none.h5", "table": table, "kind": "nearest", "file": folder / "none", "folder": folder,
        "path": "line", "name": "line", "run": run, "runs": [run], "other": run, "test": [run], "out":
        folder / "none" / "out", "data_dir": folder, "target": "serial:/none", "states": 1, "workers": 1,
        "phases": 1, "seconds": 0.5, "egain_percent": [30.0], "frequencies_hz": [0.7], "time_limit_s": 0.5,
        "period_s": 1.0, "waypoints_m": [[0, 0], [1, 1]], "state": np.zeros(6), "x_m": [0, 1], "y_m": [0,
        1], "tangent_rad": [0, 0], "pose_world": (0, 0, 0), "at_m": np.zeros(1), "points_world_m": [[0, 0]],
        "tables": [], "effects": (), "actions": "B",
    }  # fmt: skip


@pytest.mark.parametrize("name", PUBLIC)
def test_no_argument_of_another_type_ends_in_an_error_of_pythons(
    name: str, given: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Some are not looked at, as the camera of a simulated robot; any error is one line of frogkick's."""
    monkeypatch.chdir(tmp_path)
    one, owner = PUBLIC[name], name.rpartition(".")[0]
    parameters = inspect.signature(one).parameters
    if "self" in parameters and owner not in given:
        one = one.__get__(object.__new__(getattr(fk, owner)))
    elif "self" in parameters:
        one = one.__get__(given[owner])
    small = {key: given[key] for key in parameters if key in given}
    for key, of in parameters.items():
        if key == "self" or of.kind in (of.VAR_POSITIONAL, of.VAR_KEYWORD):
            continue
        with suppress(fk.FrogkickError):
            one(**{**small, key: NO_TYPE})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda _: fk.sweep(egain_percent=10), "sweep: egain_percent is 10, give Sequence[float] | None"),
        (
            lambda _: fk.sweep(egain_percent=np.array(10.0)),
            "sweep: egain_percent is array(10.), give Sequence",
        ),
        (lambda _: fk.scan("x"), "scan: seconds is 'x', give float"),
        (
            lambda of: of["Library"].part([0]),
            "Library.part: states is [0], give a NumPy array of whole numbers",
        ),
        (lambda _: fk.Path(5), "Path: missing a required argument: 'y_m'"),
        (
            lambda _: fk.paths.line(points=None, lenght_m=1),
            "line: got an unexpected keyword argument 'lenght_m'",
        ),
        (
            lambda of: fk.fit_table(of["Library"], progress=5),
            "fit_table: progress is 5, give True, False or a function",
        ),
        (
            lambda of: fk.run(of["Table"], then=None),
            "run: then is None, give 'PATH@SECONDS' | Sequence['PATH@SECONDS']",
        ),
        (lambda of: fk.run(of["Table"], learn="False"), "run: learn is 'False', give bool"),
        (lambda _: fk.simulate(5.5), "5.5"),
        (lambda _: fk.simulate("frog2022", phase=None), "phase is None: give a number"),
    ],
)
def test_an_argument_of_another_type_is_named(
    call: Callable[[Any], object], message: str, given: dict[str, Any]
) -> None:
    with pytest.raises(fk.InputError) as refused:
        call(given)
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("hint", "fit", "others"),
    [
        (int, (1, np.int64(1)), (1.0, True, "1", None)),
        (float, (1, 1.5, np.float32(1)), (True, "1", None)),
        (float | None, (None, 1), ("",)),
        (bool, (True, np.bool_(False)), (0, "False", None)),
        (Sequence[float], ([1], (1.5,), np.ones(3)), (1, "1", [None], {1: 2}, np.array(1.0))),
        (Sequence[str] | str, ("a", ["a"]), ([1], 1)),
        (Mapping[str, Any], ({},), ([],)),
        (ArrayLike, (1, [1], np.ones(2)), (None, NO_TYPE, "x")),
        (ArrayLike | None, (None, 1), (NO_TYPE,)),
        (Progress, (True, print), (1, None, "True")),
        (fk.Robot | Path | str, ("a", Path("a")), (1, None)),
        (Any, (None, 1), ()),
    ],
)
def test_what_fits_a_declared_type(hint: Any, fit: Sequence[Any], others: Sequence[Any]) -> None:
    assert [fits(value, hint) for value in fit] == [True] * len(fit)
    assert [fits(value, hint) for value in others] == [False] * len(others)


def test_what_a_call_gives_and_what_it_says_itself_stays() -> None:
    @typed
    def halved(number: float, tell: Callable[[float], None] = print) -> float:
        if number == "none":
            raise fk.InputError("none cannot be halved")
        return number / 2

    assert halved(3) == 1.5 and halved(number=np.float32(3)) == 1.5
    with pytest.raises(fk.InputError, match="none cannot be halved"):
        halved("none")
    with pytest.raises(ArgumentError, match="halved: number is '3', give float") as refused:
        halved("3")
    assert isinstance(refused.value, TypeError) and isinstance(refused.value.__cause__, TypeError)
    with pytest.raises(ArgumentError, match="tell is 3, give Callable"):
        halved(3, 3)

    @typed
    def broken(number: float) -> float:
        raise KeyError(number)

    with pytest.raises(KeyError):
        broken(1.0)
