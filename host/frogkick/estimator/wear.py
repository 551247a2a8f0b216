"""What each limb has lost of its contribution, learned while the robot swims: the twin of fk_wear.c.

What a period missed is held against the wear curves of the limbs that fired in it and against a current.
The sums of all periods are kept, older ones fading: recursive least squares with exponential forgetting
(Ljung 1999, System Identification, section 11.2). The limbs and the current are selected forward, as long as
one more explains more than its penalty: where nothing is worn, nothing is learned, and the planner decides as
without.

The two share the order of float32 operations, each rounded once, and the numbers below.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from frogkick.core.errors import InputError
from frogkick.planner import floats
from frogkick.tables.image import Tables
from frogkick.tables.layout import LOST_MAX

Float32 = npt.NDArray[np.float32]

OFF, ON, HELD = 0, 1, 2
"""Whether a robot learns, as in the link's ``frames.toml``."""

_F = np.float32

NOISE = (0.0012, 0.0012, 0.02)
"""Standard deviation of what a period misses where all is known: forward, left (m), turn (rad). The default
table misses less; wear curves, which are means over actions and states, miss more."""

_NOISE = np.array([1.44e-6, 1.44e-6, 4e-4], dtype=np.float32)
_CURRENT_INFORMATION = np.array([111111.11, 111111.11, 40000.0], dtype=np.float32)  # 3 mm/s, 0.005 rad/s
_FADING, _SURPRISED = _F(0.96), _F(0.3)
_PENALTY, _SURPRISE, _MISSED_MOST = _F(9), _F(30), _F(1e6)
_SECANT = 22937
_LEAST, _MOST, _APART = _F(0.02), _F(1.3), _F(1e-3)


class WearFilter:
    """Learns the lost share of each limb from what each period missed.

    Attributes:
        codes: (l,) share of its contribution that each limb has lost, 0 to 32767.
        current: (3,) float32, what a current moves the robot, world frame, m/s and rad/s.
        held: what was learned is planned with, and nothing more is learned.
    """

    def __init__(self, tables: Tables) -> None:
        """Start with nothing lost.

        Args:
            tables: of the robot as it was.

        Raises:
            InputError: they hold no wear curves.
        """
        if not tables.limb_wear.size:
            raise InputError(
                "the table holds no wear curves to learn by: build it again, or do without learn"
            )
        unknowns = 3 + tables.limbs
        masks = [row.first_mask | row.second_mask for row in tables.actions]
        self._fires = [[limb for limb in range(tables.limbs) if mask >> limb & 1] for mask in masks]
        self._original = tables
        self._information = np.zeros((unknowns, unknowns), dtype=np.float32)
        self._vector = np.zeros(unknowns, dtype=np.float32)
        self.codes = np.zeros(tables.limbs, dtype=np.int64)
        self.current = np.zeros(3, dtype=np.float32)
        self.held = False

    def restore(self, sums: Float32, vector: Float32, current: Float32, codes: Sequence[int]) -> None:
        """Put back what a robot's snapshot holds: (n (n + 1) / 2,), (n,), (3,) and (l,) for n = l + 3."""
        lower = np.zeros_like(self._information)
        lower[np.tril_indices(len(vector))] = sums
        self._information = lower + np.tril(lower, -1).T
        self._vector, self.current = vector, current
        self.codes = np.array(codes, dtype=np.int64)

    @property
    def lost(self) -> npt.NDArray[np.float64]:
        """(l,) share of its contribution that each limb has lost, 0 to 1."""
        return np.asarray(self.codes / LOST_MAX)

    @property
    def tables(self) -> Tables:
        """The table of the robot with these limbs."""
        return self._original.worn(self.codes)

    def learn(
        self,
        missed_world: Float32,
        variance: Float32,
        heading_rad: np.float32,
        action: int,
        period_s: np.float32,
    ) -> None:
        """Learn from a period that has ended.

        Args:
            missed_world: (3,) pose at its end minus the pose that ``tables`` predicted: m, m, rad, world.
            variance: (3,) of that pose by the fixes.
            heading_rad: where the robot headed when the period began, within a turn of zero.
            action: of the period.
            period_s: its length.
        """
        if self.held or action >= len(self._fires):
            return
        missed, rows = self._rows(missed_world, heading_rad, action, period_s)
        left = missed.copy()
        values = np.concatenate([self.current, self.codes.astype(np.float32) / _F(LOST_MAX)])
        for unknown, value in enumerate(values):
            left = left - rows[:, unknown] * value
        weight = _F(1) / (_NOISE + variance)
        square = _F(0)
        for part in weight * (left * left):
            square = square + part
        if not square <= _MISSED_MOST:
            return
        kept = _FADING * _SURPRISED if square > _SURPRISE else _FADING
        weighted = weight[:, None] * rows
        products = weighted[:, :, None] * rows[:, None, :]
        lower = np.tril(kept * self._information + ((products[0] + products[1]) + products[2]))
        self._information = lower + np.tril(lower, -1).T
        told = weighted * missed[:, None]
        self._vector = kept * self._vector + ((told[0] + told[1]) + told[2])
        self._believe()

    def _rows(
        self, missed_world: Float32, heading_rad: np.float32, action: int, period_s: np.float32
    ) -> tuple[Float32, Float32]:
        """(3,) what a robot with no worn limb would have missed, body frame, and its (3, n) derivatives."""
        sine, cosine = (np.float32(value) for value in floats.sincos(heading_rad))
        x_m, y_m, turn_rad = missed_world
        missed = np.array([cosine * x_m + sine * y_m, cosine * y_m - sine * x_m, turn_rad], dtype=np.float32)
        rows = np.zeros((3, len(self._vector)), dtype=np.float32)
        rows[0, :2] = cosine * period_s, sine * period_s
        rows[1, :2] = -sine * period_s, cosine * period_s
        rows[2, 2] = period_s
        for limb in self._fires[action]:
            code = int(self.codes[limb])
            to = max(code, _SECANT)
            missed = missed + self._curve(limb, code)
            rows[:, 3 + limb] = self._curve(limb, to) / (_F(to) / _F(LOST_MAX))
        return missed, rows

    def _curve(self, limb: int, code: int) -> Float32:
        """(3,) what a limb that has lost a share changes of a motion."""
        return np.asarray(
            self._original.wear_at(limb, code)[:3].astype(np.float32) * self._original.motion_scale
        )

    def _believe(self) -> None:
        """Select the limbs, and the current, that explain most, one after another."""
        unknowns = len(self._vector)
        normal = np.concatenate([self._information, self._vector[:, None]], axis=1)
        normal[range(3), range(3)] += _CURRENT_INFORMATION
        chosen: list[int] = []
        while True:
            most, best = _PENALTY, None
            for first in (0, *range(3, unknowns)):
                gain = _F(-1) if first in chosen else self._gain(normal, first, chosen)
                if gain > most or (first == 0 and gain >= most):
                    most, best = gain, first
            if best is None:
                break
            for pivot in range(3) if best == 0 else (best,):
                own = normal[pivot] / normal[pivot, pivot]
                normal = normal - normal[:, pivot, None] * own
                normal[pivot] = own
            chosen.append(best)
        is_chosen = [(0 if k < 3 else k) in chosen for k in range(unknowns)]
        found = np.where(is_chosen, normal[:, -1], _F(0))
        self.current = found[:3]
        shares = np.minimum(found[3:], _F(1))
        self.codes = np.where(shares > 0, shares * _F(LOST_MAX) + _F(0.5), 0).astype(np.int64)

    def _gain(self, normal: Float32, first: int, chosen: list[int]) -> np.float32:
        """What a limb, or the current (0), explains of what the chosen ones leave; -1: not to be believed."""
        if first == 0:
            values = _solve(normal[:3, :3], normal[:3, -1])
        else:
            left = normal[first, first]
            if not left > _APART * self._information[first, first]:
                return _F(-1)
            values = normal[first : first + 1, -1] / left
        shares = [normal[k, -1] for k in chosen if k]
        for k, value in enumerate(values):
            parts = [normal[limb, first + k] * value for limb in chosen if limb]
            shares = [share - part for share, part in zip(shares, parts, strict=True)]
        if not all(_LEAST < share < _MOST for share in (*shares, *(values if first else ()))):
            return _F(-1)
        gain = _F(0)
        for k, value in enumerate(values):
            part = normal[first + k, -1] * value
            gain = part if k == 0 else gain + part
        return np.float32(gain)


def _solve(matrix: Float32, right: Float32) -> Float32:
    """Gaussian elimination of three unknowns without pivoting: the current's expected size keeps it sound."""
    rows = np.concatenate([matrix, right[:, None]], axis=1)
    for pivot in range(2):
        for row in range(pivot + 1, 3):
            part = rows[row, pivot] / rows[pivot, pivot]
            rows[row, pivot:] = rows[row, pivot:] - part * rows[pivot, pivot:]
    last = rows[2, 3] / rows[2, 2]
    middle = (rows[1, 3] - rows[1, 2] * last) / rows[1, 1]
    first = ((rows[0, 3] - rows[0, 1] * middle) - rows[0, 2] * last) / rows[0, 0]
    return np.array([first, middle, last], dtype=np.float32)
