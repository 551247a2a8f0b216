"""Do two places plan alike? States that make them differ if anything can, and a comparison bit by bit.

A place is a callable: states (k, 6) float32, depths (k,) int32, limb uses (k, 8) uint16 and places along the
path (k,) float32 in, an array of ``PLAN_ROW`` out. Python and native C are here; the virtual chip, or a robot
on a wire, is one more callable.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from frogkick.core.arrays import AnyArray, Bool, Float32, Float64, Int32, Int64, UInt16
from frogkick.core.errors import FrogkickError, InputError
from frogkick.planner.kernel import PLAN_ROW
from frogkick.planner.plan import PathLike, PlanConfig, path_rows, plan_batch
from frogkick.tables.image import Tables
from frogkick.tables.layout import LIMBS_MAX
from frogkick_codegen.native import NativeLibrary

Place = Callable[[Float32, Int32, UInt16, Float32], AnyArray]

DEPTH_SHARE = (0.62, 0.30, 0.075, 0.005)
"""Parts of the states that are planned at depth 1 to 4: each level costs about ten times the one before."""
_TIES_WANTED = 64


@dataclass(frozen=True, eq=False)
class Cases:
    """States to compare, kinds interleaved: the first n rows hold every kind (n at least the kinds' number).

    Attributes:
        states: (k, 6) float32.
        depths: (k,) int32, 1 to 4.
        limb_use: (k, 8) uint16.
        along_points: (k,) float32, where along the path each was last.
        kinds: (k,) index into ``KINDS``.
        seed: makes them again.
    """

    states: Float32
    depths: Int32
    limb_use: UInt16
    along_points: Float32
    kinds: Int64
    seed: int

    def part(self, at: int, count: int) -> Cases:
        """Return ``count`` cases from one on, fewer at the end."""
        names = [field.name for field in fields(self) if field.name != "seed"]
        return replace(self, **{name: getattr(self, name)[at : at + count] for name in names})


@dataclass(frozen=True)
class PairReport:
    """How two places compare."""

    first: str
    second: str
    states: int  # how many were compared
    mismatches: int  # states in which anything differs
    fields: Mapping[str, int]  # field of ``PLAN_ROW`` -> states in which its bits differ
    first_failure: str  # one line on the first of them, with what replays it; "" without any


@dataclass(frozen=True, eq=False)
class _Source:
    """What the makers of states draw from."""

    rng: np.random.Generator
    tables: Tables
    path: Float32
    ties: Int64

    def base(self, count: int) -> Float64:
        """Poses about the path, any heading, velocities over the table's box."""
        x, y = self.path[0].astype(np.float64), self.path[1].astype(np.float64)
        scale = self.tables.velocity_scale.astype(np.float64)
        low = [x.min() - 0.2, y.min() - 0.2, -np.pi, *(self.tables.states.min(axis=0) * scale)]
        high = [x.max() + 0.2, y.max() + 0.2, np.pi, *(self.tables.states.max(axis=0) * scale)]
        return self.rng.uniform(low, high, (count, 6))

    def velocity(self, codes: npt.ArrayLike) -> Float64:
        return np.asarray(codes, dtype=np.float64) * self.tables.velocity_scale.astype(np.float64)


def _uniform(source: _Source, count: int) -> AnyArray:
    return source.base(count)


def _rest(source: _Source, count: int) -> AnyArray:
    states = source.base(count)
    states[:, 3:] = 0.0
    return states


def _table_row(source: _Source, count: int) -> AnyArray:
    states = source.base(count)
    states[:, 3:] = source.velocity(source.rng.choice(source.tables.states, count))
    return states


def _table_edge(source: _Source, count: int) -> AnyArray:
    """At the box's faces, edges and corners, and one code to either side."""
    states = source.base(count)
    codes = source.tables.states.astype(np.int64)
    ends = np.stack([codes.min(axis=0), codes.max(axis=0)])
    faces = source.rng.integers(0, 2, (count, 3))
    edge = source.velocity(ends[faces, [0, 1, 2]] + source.rng.integers(-1, 2, (count, 3)))
    states[:, 3:] = np.where(source.rng.random((count, 3)) < 0.6, edge, states[:, 3:])
    return states


def _beyond(source: _Source, count: int) -> AnyArray:
    states = source.base(count)
    states[:, 3:] *= 10.0 ** source.rng.uniform(0.0, 4.0, (count, 3))
    return states


def _tie(source: _Source, count: int) -> AnyArray:
    states = source.base(count)
    if len(source.ties):
        states[:, 3:] = source.velocity(source.rng.choice(source.ties, count))
    return states


def _half_code(source: _Source, count: int) -> AnyArray:
    """Velocities whose code is an integer and a half, exactly or by one unit in the last place.

    Most lie half a code inside a tie: rounded away from zero they tie, rounded otherwise they do not.
    """
    states = source.base(count).astype(np.float32)
    per_velocity = np.float32(1) / source.tables.velocity_scale
    codes = source.rng.integers(-400, 400, (count, 3)) + 0.5
    if len(source.ties):
        tie = source.rng.choice(source.ties, count).astype(np.float64)
        axis = source.rng.integers(0, 3, count)
        tie[np.arange(count), axis] -= 0.5 * np.sign(tie[np.arange(count), axis])
        codes = np.where(source.rng.random((count, 1)) < 0.7, tie, codes)
    velocity = source.velocity(codes).astype(np.float32)
    for _ in range(3):  # towards the velocity whose float32 product is the half itself
        step = np.sign(codes.astype(np.float32) - velocity * per_velocity)
        velocity = np.where(step == 0, velocity, _beside(velocity, step))
    nudge = source.rng.integers(-1, 2, (count, 3)).astype(np.float32)
    nudge[(source.rng.random((count, 3)) < 0.7) | (nudge == 0)] = 0
    states[:, 3:] = np.where(nudge == 0, velocity, _beside(velocity, nudge))
    return states


def _beside(values: Float32, direction: Float32) -> Float32:
    """Return the next float32 above (direction > 0) or below."""
    return np.nextafter(values, np.where(direction > 0, np.float32(np.inf), np.float32(-np.inf)))


def _huge(source: _Source, count: int) -> AnyArray:
    states = source.base(count)
    states[:, 3:] = np.sign(states[:, 3:]) * 10.0 ** source.rng.uniform(1.0, 38.5, (count, 3))
    states[:, :2] = source.rng.uniform(-1000.0, 1000.0, (count, 2))
    return states


def _limit(source: _Source, count: int) -> AnyArray:
    """At the limits of pose, and one unit in the last place inside and outside."""
    states = source.base(count).astype(np.float32)
    limit = np.float32(1000)
    ends = np.array([limit, np.nextafter(limit, np.float32(0)), np.nextafter(limit, np.float32(2000))])
    ends = np.concatenate([ends, -ends])
    picked = source.rng.random((count, 3)) < 0.4
    states[:, :3] = np.where(picked, source.rng.choice(ends, (count, 3)), states[:, :3])
    return states


def _tiny(source: _Source, count: int) -> AnyArray:
    sign = source.rng.choice([-1.0, 1.0], (count, 6))
    return sign * 10.0 ** source.rng.uniform(-38.0, -6.0, (count, 6))


def _subnormal(source: _Source, count: int) -> AnyArray:
    """Subnormal numbers, zero and minus zero in every component."""
    bits = source.rng.integers(0, 1 << 23, (count, 6), dtype=np.uint32)
    bits[source.rng.random((count, 6)) < 0.3] = 0
    bits |= source.rng.integers(0, 2, (count, 6), dtype=np.uint32) << np.uint32(31)
    return bits.view(np.float32)


def _not_finite(source: _Source, count: int) -> AnyArray:
    states = source.base(count).astype(np.float32)
    odd = np.array([0x7FC00000, 0xFFC00001, 0x7F800001, 0x7F800000, 0xFF800000], dtype=np.uint32).view(
        np.float32
    )
    where = source.rng.integers(0, 6, count)
    states[np.arange(count), where] = source.rng.choice(odd, count)
    return states


def _half_turn(source: _Source, count: int) -> AnyArray:
    """Headings within some units in the last place of an odd number of half turns."""
    states = source.base(count).astype(np.float32)
    turns = np.where(source.rng.random(count) < 0.5, 0, source.rng.integers(-158, 158, count))
    heading = (source.rng.choice([-np.pi, np.pi], count) + 2.0 * np.pi * turns).astype(np.float32)
    states[:, 2] = heading + source.rng.integers(-4, 5, count).astype(np.float32) * np.spacing(heading)
    return states


def _on_path(source: _Source, count: int) -> AnyArray:
    """On a path point or half way between two, heading along the tangent or against it."""
    states = source.base(count).astype(np.float32)
    index = source.rng.integers(0, source.path.shape[1], count)
    after = np.minimum(index + source.rng.integers(0, 2, count), source.path.shape[1] - 1)
    states[:, :2] = ((source.path[:2, index] + source.path[:2, after]) * np.float32(0.5)).T
    against = source.rng.choice(np.array([0.0, np.pi, -np.pi], dtype=np.float32), count)
    states[:, 2] = source.path[2, index] + against
    return states


def _any_bits(source: _Source, count: int) -> AnyArray:
    """Velocities of any bits at all; poses of any finite size up to the limits."""
    states = source.base(count).astype(np.float32)
    bits = source.rng.integers(0, 1 << 32, (count, 3), dtype=np.uint64).astype(np.uint32)
    states[:, 3:] = bits.view(np.float32)
    states[:, :3] = source.rng.choice([-1.0, 1.0], (count, 3)) * 10.0 ** source.rng.uniform(
        -30, 3, (count, 3)
    )
    return states


def _limb_uses(rng: np.random.Generator, count: int, beyond: Bool) -> UInt16:
    """What a robot meets, with rested and full limbs; half of those marked go beyond and are refused."""
    use = (rng.random((count, LIMBS_MAX)) ** 2 * 32767).astype(np.uint16)
    edges = rng.choice(np.array([0, 1, 32766, 32767], dtype=np.uint16), (count, LIMBS_MAX))
    use = np.where(rng.random((count, LIMBS_MAX)) < 0.3, edges, use)
    use[rng.random(count) < 0.2] = 0
    beyond = beyond & (rng.random(count) < 0.5)
    limb = rng.integers(0, LIMBS_MAX, int(beyond.sum()))
    use[beyond, limb] = rng.choice(np.array([32768, 65535], dtype=np.uint16), len(limb))
    return use.astype(np.uint16)


def _along(source: _Source, states: Float32, beyond: Bool) -> Float32:
    """Mostly near the state, as in a run; anywhere, and at the ends; half of those marked are refused."""
    rng, last = source.rng, source.path.shape[1] - 1
    x, y = states[:, 0, None].astype(np.float64), states[:, 1, None].astype(np.float64)
    near = np.argmin(np.nan_to_num((source.path[0] - x) ** 2 + (source.path[1] - y) ** 2), axis=1)
    along = np.clip(near - rng.exponential(0.06 * last, len(states)), 0, last)
    along = np.where(rng.random(len(states)) < 0.2, rng.uniform(0, last, len(states)), along)
    whole = rng.random(len(states)) < 0.2
    along = np.where(whole, np.round(along), along).astype(np.float32)
    ends = rng.choice(np.array([0.0, -0.0, last, np.nextafter(np.float32(last), np.float32(0))]), len(states))
    along = np.where(rng.random(len(states)) < 0.1, ends, along).astype(np.float32)
    odd = np.array([-1.0, last + 1, np.nan, np.inf, -np.inf, -1e-30], dtype=np.float32)
    beyond = beyond & (rng.random(len(states)) < 0.5)
    along[beyond] = rng.choice(odd, int(beyond.sum()))
    return along


_MAKERS: dict[str, Callable[[_Source, int], AnyArray]] = {
    **{
        make.__name__.removeprefix("_"): make
        for make in (
            _uniform, _rest, _table_row, _table_edge, _beyond, _tie, _half_code, _huge, _limit, _tiny,
            _subnormal, _not_finite, _half_turn, _on_path, _any_bits,
        )
    },
    "limb_use": _uniform,
    "along": _uniform,
}  # fmt: skip
KINDS = tuple(_MAKERS)


def make_cases(
    tables: Tables, path: PathLike, count: int, seed: int, depth_share: Sequence[float] = DEPTH_SHARE
) -> Cases:
    """Make ``count`` states of every kind in turn.

    ``depth_share`` has the parts of depth 1, 2, 3, 4, which sum to 1.
    """
    if count < 1:
        raise InputError(f"{count} states asked for, at least 1 is needed: choose --states")
    rng = np.random.default_rng(seed)
    source = _Source(rng, tables, path_rows(path), find_ties(tables, rng))
    states = np.empty((count, 6), dtype=np.float32)
    kinds = np.arange(count) % len(KINDS)
    for index, name in enumerate(KINDS):
        rows = kinds == index
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            states[rows] = _MAKERS[name](source, int(rows.sum())).astype(np.float32)
    depths = rng.choice(np.arange(1, 5), count, p=depth_share).astype(np.int32)
    limb_use = _limb_uses(rng, count, kinds == KINDS.index("limb_use"))
    with np.errstate(over="ignore", invalid="ignore"):
        along = _along(source, states, kinds == KINDS.index("along"))
    return Cases(states, depths, limb_use, along, kinds, seed)


def find_ties(tables: Tables, rng: np.random.Generator, wanted: int = _TIES_WANTED) -> Int64:
    """Return velocities in codes, (k, 3), that have two or more nearest rows at exactly the same distance.

    They are fewer than wanted, or none, where a table offers no more.
    """
    codes = tables.states.astype(np.int64)
    offsets = np.array(list(itertools.product(range(-8, 9), repeat=3)), dtype=np.int64)
    found: list[Int64] = []
    for row in rng.permutation(len(codes))[: 8 * wanted]:
        apart = ((codes - codes[row]) ** 2).sum(axis=1)
        apart[row] = np.iinfo(np.int64).max
        near = codes[np.argmin(apart)]
        queries = (codes[row] + near) // 2 + offsets
        queries = queries[np.abs(queries).max(axis=1) <= 16383]
        level = ((queries - codes[row]) ** 2).sum(axis=1) == ((queries - near) ** 2).sum(axis=1)
        for query in rng.permutation(queries[level])[:4]:
            distance2 = ((codes - query) ** 2).sum(axis=1)
            if (distance2 == distance2.min()).sum() >= 2:
                found.append(query)
                break
        if len(found) == wanted:
            break
    return np.array(found, dtype=np.int64).reshape(-1, 3)


def python_place(tables: Tables, path: PathLike, config: PlanConfig) -> Place:
    return lambda *given: plan_batch(tables, path, config, *given)


def native_place(library: NativeLibrary, tables: Tables, path: PathLike, config: PlanConfig) -> Place:
    return lambda *given: library.plan_batch(tables.image, path, config, *given)


def compare(cases: Cases, places: Mapping[str, Place]) -> list[PairReport]:
    """Let every place, by its name, plan every case, and compare each pair of places."""
    if len(places) < 2:
        raise FrogkickError(f"{len(places)} place given, a comparison needs 2: add a place")
    results: dict[str, AnyArray] = {}
    for name, place in places.items():
        rows = place(cases.states, cases.depths, cases.limb_use, cases.along_points)
        if rows.dtype != PLAN_ROW or rows.shape != (len(cases.states),):
            raise FrogkickError(
                f"place {name!r} returned {rows.dtype} {rows.shape}, needed is PLAN_ROW for each state"
            )
        results[name] = rows
    return [
        _pair(cases, one, results[one], two, results[two]) for one, two in itertools.combinations(places, 2)
    ]


def _pair(cases: Cases, one: str, left: AnyArray, two: str, right: AnyArray) -> PairReport:
    fields: dict[str, int] = {}
    wrong = np.zeros(len(left), dtype=bool)
    for name in PLAN_ROW.names or ():
        differs = _bits(left[name]) != _bits(right[name])
        differs = differs.reshape(len(left), -1).any(axis=1)
        fields[name] = int(differs.sum())
        wrong |= differs
    failure = ""
    if wrong.any():
        index = int(np.argmax(wrong))
        values = ", ".join(float(value).hex() for value in cases.states[index])
        failure = (
            f"seed {cases.seed}, case {index} of {len(left)} ({KINDS[cases.kinds[index]]}), "
            f"depth {cases.depths[index]}, state [{values}], "
            f"limb use {cases.limb_use[index].tolist()}, along {float(cases.along_points[index]).hex()}: "
            f"{one} {left[index]}, {two} {right[index]}"
        )
    return PairReport(one, two, len(left), int(wrong.sum()), fields, failure)


def _bits(column: AnyArray) -> npt.NDArray[np.uint32]:
    return np.ascontiguousarray(column).view(np.uint32)
