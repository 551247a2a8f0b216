"""fk_plan and its helpers, called as an application calls them: refusals, limits, edges, cuts."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from tests.codegen import planner_c
from tests.codegen.planner_c import FFI, config_of, library, path_of, state_of
from tests.conftest import count
from tests.planner import synthetic

from frogkick.core.weights import WEIGHTS
from frogkick.planner import beam
from frogkick.planner.plan import Cost, PlanConfig, plan_batch
from frogkick.tables.image import open_image

NEAREST = synthetic.image(60, 5)
AFFINE = synthetic.affine_image(60, 5)
_TURNING = np.random.default_rng(5).uniform(-1.0, 1.0, (40, 4, 6)) * [0.03, 0.03, 2.5, 0.02, 0.02, 0.4]
WILD = synthetic.affine_image(40, 4, seed=5, base=_TURNING)
"""Turns of more than a right angle either way."""
EQUAL = synthetic.pack(*(np.repeat(part, 3, axis=1) if part.ndim == 3 else part for part in
                         synthetic.transitions(30, 2, 4)))  # fmt: skip
"""Six actions, each three the same: ties at every node."""
EIGHT = synthetic.affine_image(30, 4, limbs=8, history=np.ones((4, 8, 6)) * 0.004)
STILL = synthetic.pack(np.zeros((1, 3)), np.zeros((1, 2, 3)), np.zeros((1, 2, 3)))
"""Nothing moves it: the least reach there is."""
IMAGES = {
    "nearest": NEAREST, "affine": AFFINE, "wild": WILD, "equal": EQUAL, "eight": EIGHT, "still": STILL,
}  # fmt: skip
ROUTE = {
    "cost": Cost.ROUTE,
    "distance_weight_per_m": 300.0,
    "angle_weight_per_rad": 20.0,
    "progress_weight_per_m": 400.0,
    "look_ahead_m": 0.06,
    "soft_distance_m": 0.02,
    "turn_lead": 0.5,
    "course_weight_per_m": 50.0,
}
CODES = planner_c.codes()
NAN, INFINITY = float("nan"), float("inf")
POINTS = [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.1, 0.7)]


class Points:
    """A path of given points."""

    def __init__(self, points: npt.ArrayLike) -> None:
        self.x_m, self.y_m, self.tangent_rad = np.array(points, dtype=np.float32).T


def c_plan(
    image: bytes,
    path: Any,
    config: PlanConfig,
    states: npt.NDArray[np.float32],
    use: npt.NDArray[np.uint16],
    along: npt.NDArray[np.float32],
) -> list[dict[str, Any]]:
    """What the C answers, field by field."""
    tables, route, settings = planner_c.opened(image), path_of(path), config_of(config)
    reported = []
    for values, used, place in zip(states, use, along, strict=True):
        names = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_rad_s")
        state = state_of(dict(enumerate(used.tolist())), **dict(zip(names, values.tolist(), strict=True)))
        state.along_points = float(place)
        status, plan = planner_c.plan(tables, route, settings, state)
        assert status == 0
        fields = ("action", "nearest_state", "path_index", "depth_reached", "transitions")
        row: dict[str, Any] = {name: getattr(plan, name) for name in fields}
        for name in ("cost", "distance_m", "along_points"):
            row[name] = np.float32(getattr(plan, name)).tobytes()
        row["predicted"] = np.array([getattr(plan.predicted, name) for name in names], np.float32).tobytes()
        row["use"] = list(plan.predicted.limb_use)
        assert plan.predicted.along_points == plan.along_points
        reported.append(row)
    return reported


def twin_plan(
    image: bytes,
    path: Any,
    config: PlanConfig,
    states: npt.NDArray[np.float32],
    use: npt.NDArray[np.uint16],
    along: npt.NDArray[np.float32],
) -> list[dict[str, Any]]:
    """What the twin answers, likewise."""
    rows = plan_batch(open_image(image), path, config, states, limb_use=use, along_points=along)
    assert not rows["status"].any()
    reported = []
    for row in rows:
        fields = ("action", "nearest_state", "path_index", "depth_reached", "transitions")
        one: dict[str, Any] = {name: int(row[name]) for name in fields}
        for name in ("cost", "distance_m", "along_points"):
            one[name] = row[name].tobytes()
        one["predicted"] = row["predicted"].tobytes()
        one["use"] = row["predicted_limb_use"].tolist()
        reported.append(one)
    return reported


def some_states(number: int, points: int, seed: int, spread_m: float = 0.1) -> tuple[Any, Any, Any]:
    """States on and about a path of a metre, limb uses, places."""
    rng = np.random.default_rng(seed)
    states = rng.uniform(-1.0, 1.0, (number, 6)) * [0.0, spread_m, np.pi, 0.05, 0.04, 0.7]
    states[:, 0] = rng.uniform(-0.1, 1.1, number)
    use = rng.integers(0, 32768, (number, 8))
    use[:, 4:] = 0
    along = np.clip(states[:, 0] * (points - 1) + rng.normal(0.0, 2.0, number), 0.0, points - 1)
    along[:4] = [0.0, points - 1, points // 2, points // 2]
    return states.astype(np.float32), use.astype(np.uint16), along.astype(np.float32)


def test_the_headers_and_the_host_count_the_same_error_codes() -> None:
    assert len(CODES) == len(set(CODES.values())) == 28
    assert CODES["FK_OK"] == 0
    assert all(value < 0 for name, value in CODES.items() if name != "FK_OK")


@pytest.mark.parametrize("missing", range(5))
def test_every_null_pointer_is_refused_and_nothing_is_written(missing: int) -> None:
    made = FFI.new("fk_plan_t *")
    FFI.buffer(made)[:] = b"\xa5" * FFI.sizeof("fk_plan_t")
    tables = planner_c.opened(NEAREST)
    given = [tables.pointer, path_of(POINTS), config_of(), state_of(), made]
    given[missing] = FFI.NULL
    assert library().fk_plan(*given) == CODES["NULL"]
    assert set(bytes(FFI.buffer(made))) == {0xA5}


PLACES = ("wall_x_min_m", "wall_x_max_m", "wall_y_min_m", "wall_y_max_m")
LIMITS = (
    dict.fromkeys(WEIGHTS, 1e6)
    | {"turn_lead": 2.0, "glide_lead": 2.0, "wall_glide": 100.0}
    | dict.fromkeys(PLACES, 1000.0)
)
REFUSED_CONFIGS = [
    ({"depth": 0}, "DEPTH"),
    ({"depth": 5}, "DEPTH"),
    ({"cost": 2}, "COST"),
    ({"cost": 255}, "COST"),
    *(
        ({name: value}, "WEIGHT")
        for name, most in LIMITS.items()
        for value in (
            NAN,
            INFINITY,
            -INFINITY,
            float(np.nextafter(np.float32(most), np.float32(2e6))),
            *((-1000.0001,) if name in PLACES else (-1.0, -0.0)),
        )
    ),
]  # fmt: skip
REFUSED_STATES = [
    *(
        ({name: value}, "NOT_FINITE")
        for name in ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_rad_s", "along_points")
        for value in (NAN, INFINITY, -INFINITY)
    ),
    *(
        ({name: sign * float(np.nextafter(np.float32(1000), np.float32(2000)))}, "RANGE")
        for name in ("x_m", "y_m", "heading_rad")
        for sign in (-1.0, 1.0)
    ),
    ({"along_points": -1e-6}, "RANGE"),
    ({"along_points": 2.0001}, "RANGE"),
]


@pytest.mark.parametrize(("changes", "name"), REFUSED_CONFIGS)
def test_a_configuration_out_of_range_is_refused_by_its_code(changes: dict[str, float], name: str) -> None:
    status, plan = planner_c.plan(
        planner_c.opened(NEAREST), path_of(POINTS), config_of(**changes), state_of()
    )
    assert status == CODES[name]
    assert set(bytes(FFI.buffer(plan))) == {0xA5}


@pytest.mark.parametrize(("changes", "name"), REFUSED_STATES)
def test_a_state_out_of_range_is_refused_by_its_code(changes: dict[str, float], name: str) -> None:
    status, plan = planner_c.plan(
        planner_c.opened(NEAREST), path_of(POINTS), config_of(), state_of(**changes)
    )
    assert status == CODES[name]
    assert set(bytes(FFI.buffer(plan))) == {0xA5}


@pytest.mark.parametrize("limb", range(8))
def test_a_limb_used_more_than_fully_is_refused(limb: int) -> None:
    tables, path = planner_c.opened(AFFINE), path_of(POINTS)
    assert planner_c.plan(tables, path, config_of(), state_of({limb: 32767}))[0] == 0
    assert planner_c.plan(tables, path, config_of(), state_of({limb: 32768}))[0] == CODES["RANGE"]


@pytest.mark.parametrize("member", range(3))
@pytest.mark.parametrize("value", [NAN, INFINITY, -1000.1, 1000.1])
def test_a_path_point_out_of_range_is_refused(member: int, value: float) -> None:
    for index in range(3):
        points = [list(point) for point in POINTS]
        points[index][member] = value
        assert library().fk_path_check(path_of(points)) == CODES["PATH_POINT"]
        assert planner_c.plan(planner_c.opened(NEAREST), path_of(points), config_of(), state_of())[0] == -7
    outside = path_of([*POINTS, (value, value, value)])
    outside.count = 3  # what lies behind the count is not looked at
    assert library().fk_path_check(outside) == 0


def test_a_path_has_2_to_100_points() -> None:
    path = path_of([POINTS[0]] * 100)
    for points in (0, 1, 2, 100, 101, 65535):
        path.count = points
        assert library().fk_path_check(path) == (0 if 2 <= points <= 100 else CODES["PATH_COUNT"])
    assert library().fk_path_check(FFI.NULL) == CODES["NULL"]


def test_the_first_thing_that_is_wrong_is_named() -> None:
    """All wrong at once, then one after the other made right, in the header's order."""
    tables = planner_c.opened(NEAREST)
    path, config = path_of(POINTS), config_of(depth=0, cost=7, level_weight=-1.0)
    path.count, path.x_m[1] = 1, NAN
    state = state_of({3: 40000}, x_m=NAN)
    mends = [
        ("DEPTH", lambda: setattr(config, "depth", 1)),
        ("COST", lambda: setattr(config, "cost", 1)),
        ("WEIGHT", lambda: setattr(config, "level_weight", 0.0)),
        ("PATH_COUNT", lambda: setattr(path, "count", 3)),
        ("PATH_POINT", lambda: path.x_m.__setitem__(1, 0.1)),
        ("NOT_FINITE", lambda: setattr(state, "x_m", 0.0)),
        ("RANGE", lambda: state.limb_use.__setitem__(3, 0)),
    ]
    for name, mend in mends:
        assert planner_c.plan(tables, path, config, state)[0] == CODES[name]
        mend()
    assert planner_c.plan(tables, path, config, state)[0] == 0


@pytest.mark.parametrize("image", [NEAREST, AFFINE])
@pytest.mark.parametrize("cost", [Cost.PAPER, Cost.ROUTE])
def test_everything_at_its_limit_is_planned(image: bytes, cost: Cost) -> None:
    corners = [(-1000.0, -1000.0, -1000.0), (1000.0, 1000.0, 1000.0), (1000.0, -1000.0, 0.0)]
    for weights in (dict.fromkeys(LIMITS, 0.0), LIMITS):
        config = PlanConfig(**weights, cost=cost, depth=2)
        values = np.array(
            [[1e3, 1e3, 1e3, 3e38, -3e38, 3e38], [-1e3, 1e3, -1e3, -3e38, 1e-45, 0.0]], dtype=np.float32
        )
        use = np.array([[32767] * 8, [0] * 8], dtype=np.uint16)
        along = np.array([2.0, 0.0], dtype=np.float32)
        planned = c_plan(image, Points(corners), config, values, use, along)
        assert planned == twin_plan(image, Points(corners), config, values, use, along)
        assert all(np.isfinite(np.frombuffer(row["cost"], np.float32)[0]) for row in planned)


@pytest.mark.parametrize("kind", IMAGES)
@pytest.mark.parametrize("depth", [1, 2, 3, 4])
def test_both_costs_answer_as_the_twin_does(kind: str, depth: int) -> None:
    states = some_states(count(40, 400), 100, depth)
    for config in (
        PlanConfig(depth=depth),
        PlanConfig(depth=depth, **ROUTE),
        PlanConfig(depth=depth, **(ROUTE | {"soft_distance_m": 0.0, "look_ahead_m": 1e6, "turn_lead": 2.0})),
    ):
        path = synthetic.wave_path()
        planned = c_plan(IMAGES[kind], path, config, *states)
        assert planned == twin_plan(IMAGES[kind], path, config, *states)
        more = beam.BEYOND if config.cost == Cost.ROUTE and depth >= beam.DEPTH else 0
        assert {row["depth_reached"] for row in planned} == {depth + more}


@pytest.mark.parametrize("cost", [Cost.PAPER, Cost.ROUTE])
def test_ties_take_the_lowest_first_action(cost: Cost) -> None:
    """Costs of few values: paths of a few points, progress alone; and no weights at all."""
    states, tables = some_states(count(150, 1500, 40), 4, 8), open_image(EQUAL)
    path = synthetic.wave_path(4)
    for depth in (1, 2, 3):
        some = PlanConfig(0.0, 0.0, 300.0, 0.0, depth=depth, cost=cost)
        planned = c_plan(EQUAL, path, some, *states)
        assert planned == twin_plan(EQUAL, path, some, *states)
        nothing = PlanConfig(0.0, 0.0, 0.0, 0.0, depth=depth, cost=cost)
        chosen = [row["action"] for row in c_plan(EQUAL, path, nothing, *states)]
        slow = np.hypot(*states[0][:, 3:5].T) * tables.period_us * 1e-6 <= 0.375 * tables.stroke_max_m
        assert slow.any() and not slow.all()
        # The first action fires nothing, and a slow robot does not rest.
        assert chosen == (slow if cost == Cost.ROUTE else np.zeros(len(slow))).astype(int).tolist()
    # The full tree by hand, of two levels: least cost first, then the lowest first action.
    if cost == Cost.PAPER:
        found = {row["action"] for row in planned}
        assert found <= {0, 3}, "of equal actions the first"


@pytest.mark.parametrize("image", [NEAREST, AFFINE])
@pytest.mark.parametrize("cost", [Cost.PAPER, Cost.ROUTE])
def test_a_budget_cuts_the_search_anywhere_and_the_answer_is_the_best_so_far(
    image: bytes, cost: Cost
) -> None:
    """Every budget from one transition to more than the whole tree has. A beam is cut otherwise."""
    settings = ROUTE if cost == Cost.ROUTE else {}
    path = synthetic.wave_path()
    states = some_states(6, 100, 21)
    reached, depths = set(), (1, 2, 3) if cost == Cost.PAPER else (1, 2)
    for depth in depths:
        whole = sum(5**level for level in range(1, depth + 1)) + 5
        alone = {
            level: c_plan(image, path, PlanConfig(depth=level, **settings), *states)
            for level in range(1, depth + 1)
        }
        for limit in sorted({*range(1, min(whole + 3, 80)), whole - 1, whole, whole + 1, 2**32 - 1}):
            config = PlanConfig(depth=depth, transitions_max=limit, **settings)
            planned = c_plan(image, path, config, *states)
            assert planned == twin_plan(image, path, config, *states)
            for index, row in enumerate(planned):
                assert row["transitions"] <= max(limit, 5)
                reached.add((depth, row["depth_reached"]))
                if row["depth_reached"] == depth:
                    assert row["action"] == alone[depth][index]["action"]
                    assert row["cost"] == alone[depth][index]["cost"]
            if limit <= 5:
                assert [row["action"] for row in planned] == [row["action"] for row in alone[1]]
    assert reached == {(depth, level) for depth in depths for level in range(1, depth + 1)}


DEGENERATE = {
    "all points equal": [(0.3, 0.1, 0.2)] * 5,
    "two equal points": [(0.0, 0.0, 0.0)] * 2,
    "equal at the start": [(0.0, 0.0, 0.0)] * 3 + [(0.2, 0.05, 0.3), (0.5, 0.1, 0.1)],
    "equal in the middle": [(0.0, 0.0, 0.0), *[(0.2, 0.05, 0.3)] * 4, (0.5, 0.1, 0.1)],
    "equal at the end": [(0.0, 0.0, 0.0), (0.2, 0.05, 0.3), *[(0.5, 0.1, 0.1)] * 3],
    "there and back": [(0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.0, 0.0, 3.14159)],
    "closed": [(np.cos(a), np.sin(a), a + np.pi / 2) for a in np.linspace(0, 2 * np.pi, 40)],
    "shorter than a step": [(0.0, 0.0, 0.0), (1e-4, 0.0, 0.0)],
    "nearer than floats tell apart": [(900.0, 900.0, 0.0), (900.00001, 900.0, 0.0), (900.1, 900.0, 0.0)],
}  # fmt: skip


@pytest.mark.parametrize("shape", DEGENERATE)
@pytest.mark.parametrize("kind", ["nearest", "wild"])
def test_degenerate_paths_are_planned_along(shape: str, kind: str) -> None:
    points = np.array(DEGENERATE[shape])
    rng = np.random.default_rng(31)
    number = count(60, 600)
    states, use, along = some_states(number, len(points), 32)
    near = points[rng.integers(0, len(points), number), :2]
    off = rng.choice([0.0, 0.02, 0.1, 0.5, 5.0], (number, 1))
    states[:, :2] = near + off * rng.normal(0.0, 1.0, (number, 2))
    for depth in (1, 2):
        for settings in ({}, ROUTE, ROUTE | {"look_ahead_m": 0.0}):
            config = PlanConfig(depth=depth, **settings)
            planned = c_plan(IMAGES[kind], Points(points), config, states, use, along)
            assert planned == twin_plan(IMAGES[kind], Points(points), config, states, use, along)
            assert all(np.isfinite(np.frombuffer(row["predicted"], np.float32)).all() for row in planned)


def test_a_place_on_the_path_is_found_again_and_a_far_robot_keeps_its_own() -> None:
    tables = planner_c.opened(NEAREST)
    stroke_max_m = tables.pointer.stroke_max_m
    length = 40 * stroke_max_m
    path = path_of([(x, 0.0, 0.0) for x in np.linspace(0.0, length, 41)])
    distance = FFI.new("float *")
    for wanted in (0.0, 0.4, 1.0, 17.25, 39.5, 40.0):
        place = library().fk_path_along(
            tables.pointer,
            path,
            min(max(wanted - 0.5, 0.0), 40.0),
            wanted * stroke_max_m,
            0.5 * stroke_max_m,
            distance,
        )
        assert place == pytest.approx(wanted, abs=1e-4)
        assert distance[0] == pytest.approx(0.5 * stroke_max_m, rel=1e-4)
        again = library().fk_path_along(tables.pointer, path, place, wanted * stroke_max_m, 0.0, FFI.NULL)
        assert again == pytest.approx(wanted, abs=1e-4)
    far = library().fk_path_along(tables.pointer, path, 17.25, 30.0 * stroke_max_m, 0.0, distance)
    assert far == np.float32(17.25)
    assert distance[0] == pytest.approx(12.75 * stroke_max_m, rel=1e-4)


def test_a_robot_at_its_look_ahead_has_no_direction_to_take() -> None:
    """Nothing moves, and the branch ends where it should point to: the end costs nothing."""
    config = PlanConfig(depth=1, **(ROUTE | {"look_ahead_m": 0.0, "progress_weight_per_m": 0.0}))
    states = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=np.float32)
    use, along = np.zeros((1, 8), dtype=np.uint16), np.zeros(1, dtype=np.float32)
    (planned,) = c_plan(STILL, Points(POINTS), config, states, use, along)
    assert np.frombuffer(planned["cost"], np.float32)[0] == 0.0
    assert [planned] == twin_plan(STILL, Points(POINTS), config, states, use, along)
