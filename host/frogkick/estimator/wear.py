"""Online estimate of what each limb has lost of its contribution: the twin of fk_wear.c.

The prediction error of each period is regressed on the wear curves of the limbs that fired in it, and on a
current. This is recursive least squares with exponential forgetting (Ljung 1999, System Identification,
section 11.2): the normal equations of all periods are summed, and the weight of a period fades. Limbs and
current enter by forward selection, as long as one more explains more than its penalty. In place of the first
limb it may be all of them, with a common share, as from an empty battery; what single limbs have lost beyond
it may follow. If no limb is worn, none is selected, and the planner decides as without this estimate. Whether
a worn limb has lost everything is then decided by single periods.

Twin and C take the same float32 operations in the same order, and round each once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from frogkick.core.arrays import Float32, Int64
from frogkick.core.errors import InputError
from frogkick.planner import floats
from frogkick.tables.image import Tables
from frogkick.tables.layout import LOST_MAX

OFF, ON, HELD = 0, 1, 2
"""Whether a robot estimates wear, as in the link's ``frames.toml``; HELD keeps the estimate as it is."""

_F = np.float32

NOISE = (0.0012, 0.0012, 0.02)
"""Standard deviation of a period's prediction error if wear and current are known: forward, left (m), turn
(rad). It is larger than the default table's error, because wear curves are means over actions and states."""

_NOISE = np.array([1.44e-6, 1.44e-6, 4e-4], dtype=np.float32)
_CURRENT_INFORMATION = np.array([111111.11, 111111.11, 40000.0], dtype=np.float32)  # 3 mm/s, 0.005 rad/s
_FADING, _OUTLIER_FADING = _F(0.96), _F(0.3)
_PENALTY, _COMMON_BY, _OUTLIER, _ERROR_MOST = _F(9), _F(9), _F(8), _F(1e6)
_SECANT = 22937
_LEAST, _MOST, _COMMON_MOST, _APART = _F(0.02), _F(1.3), _F(0.6), _F(1e-3)
_GONE_BY = _F(1)
_RESTARTED = _F(18)  # twice the penalty: the share is dropped after 17 periods without news of the limb


class WearFilter:
    """Estimates the lost share of each limb from the prediction error of each period.

    Attributes:
        codes: (l,) share of its contribution that each limb has lost, 0 to 32767.
        current: (3,) float32 velocity that a current adds to the robot, world frame, m/s and rad/s.
        held: the estimate is used, but no longer updated.
    """

    def __init__(self, tables: Tables) -> None:
        """Start with nothing lost, from the tables of new limbs; InputError: they hold no wear curves."""
        if not tables.limb_wear.size:
            raise InputError(
                "the table has no wear curves, which learning needs: build it again, or leave out learn"
            )
        self._fires = [np.flatnonzero(fires).tolist() for fires in tables.fires]
        self._original = tables
        self.held = False
        self.restart([0] * tables.limbs)

    def restart(self, codes: Sequence[int]) -> None:
        """Start from shares, each with a standard deviation of a quarter of it, and no current."""
        unknowns = 3 + self._original.limbs
        self._information = np.zeros((unknowns, unknowns), dtype=np.float32)
        self._vector = np.zeros(unknowns, dtype=np.float32)
        self.codes = np.array(codes, dtype=np.int64)
        self.current = np.zeros(3, dtype=np.float32)
        for limb in np.flatnonzero(self.codes):
            share = _F(self.codes[limb]) / _F(LOST_MAX)
            information = _RESTARTED / (share * share)
            self._information[3 + limb, 3 + limb] = information
            self._vector[3 + limb] = information * share

    def restore(self, sums: Float32, vector: Float32, current: Float32, codes: Sequence[int]) -> None:
        """Restore the state of a robot's snapshot, of n = l + 3 unknowns.

        ``sums`` (n (n + 1) / 2,) is the lower triangle of the information matrix, ``vector`` (n,) the right-
        hand side of the normal equations.
        """
        lower = np.zeros_like(self._information)
        lower[np.tril_indices(len(vector))] = sums
        self._information = lower + np.tril(lower, -1).T
        self._vector, self.current = vector, current
        self.codes = np.array(codes, dtype=np.int64)

    @property
    def tables(self) -> Tables:
        """The tables of the robot with limbs as worn as estimated."""
        return self._original.worn(self.codes)

    def learn(
        self,
        error_world: Float32,
        variance: Float32,
        heading_rad: np.float32,
        action: int,
        period_s: np.float32,
    ) -> None:
        """Update the estimate by a period that has ended.

        Args:
            error_world: (3,) pose at its end minus the pose that ``tables`` predicted: m, m, rad, world.
            variance: (3,) variance of that pose, given the fixes.
            heading_rad: heading at the start of the period, less than a turn from zero.
            action: action of the period.
            period_s: length of the period.
        """
        if self.held or action >= len(self._fires):
            return
        error, rows = self._regression(error_world, heading_rad, action, period_s)
        left = error.copy()
        values = np.concatenate([self.current, self.codes.astype(np.float32) / _F(LOST_MAX)])
        for unknown, value in enumerate(values):
            left = left - rows[:, unknown] * value
        weight = _F(1) / (_NOISE + variance)
        square = _F(0)
        for part in weight * (left * left):
            square = square + part
        if not square <= _ERROR_MOST:
            return
        kept = _FADING * _OUTLIER_FADING if square > _OUTLIER else _FADING
        weighted = weight[:, None] * rows
        products = weighted[:, :, None] * rows[:, None, :]
        # A limb breaks suddenly, a current seldom begins so: what older periods contributed to the current's
        # estimate, with the shares of the limbs estimated then, keeps its weight.
        of_limbs = np.zeros(3, dtype=np.float32)
        for limb, share in enumerate(values[3:]):
            of_limbs = of_limbs + self._information[3 + limb, :3] * share
        weights = np.full_like(self._information, kept)
        weights[:3, :3] = _FADING
        lower = np.tril(weights * self._information + ((products[0] + products[1]) + products[2]))
        self._information = lower + np.tril(lower, -1).T
        parts = weighted * error[:, None]
        faded = kept * self._vector
        faded[:3] = _FADING * self._vector[:3] - (_FADING - kept) * of_limbs
        self._vector = faded + ((parts[0] + parts[1]) + parts[2])
        before = self.codes
        self._select()
        for column in range(3):
            error = error - rows[:, column] * self.current[column]
        self._find_gone(error, weight, action, before)

    def _find_gone(self, error: Float32, weight: Float32, action: int, before: Int64) -> None:
        """Find limbs that do nothing at all, of those that were worn before the period and still are.

        A wear curve bends at its end, where the robot turns otherwise than while something is left of the
        limb, and sums over secants cannot tell this. A period in which the limb fires does: if the curve's
        end explains it better than the estimated share, everything is lost, until a period says otherwise.
        The period that first names a limb does not count, as it may be a misfire.

        Args:
            error: (3,) of tables of new limbs, without what the current does.
            weight: (3,) 1 / variance of it.
            action: of the period.
            before: (l,) shares before the period.
        """
        was_gone = before == LOST_MAX
        fires, is_gone = self._fires[action], was_gone.copy()
        curves = {limb: self._curve(limb, int(self.codes[limb])) for limb in fires}
        left = error
        for limb in fires:
            left = left - curves[limb]
        for limb in fires:
            other = (left + curves[limb]) - self._curve(limb, LOST_MAX)
            less = _F(0)
            for part in weight * (left * left - other * other):
                less = less + part
            is_gone[limb] = less > (-_GONE_BY if was_gone[limb] else _GONE_BY)
        self.codes[is_gone & (before > 0) & (self.codes > 0)] = LOST_MAX

    def _regression(
        self, error_world: Float32, heading_rad: np.float32, action: int, period_s: np.float32
    ) -> tuple[Float32, Float32]:
        """Return the (3,) error that new tables would have made, body frame, and its (3, n) derivatives."""
        sine, cosine = (np.float32(value) for value in floats.sincos(heading_rad))
        x_m, y_m, turn_rad = error_world
        error = np.array([cosine * x_m + sine * y_m, cosine * y_m - sine * x_m, turn_rad], dtype=np.float32)
        rows = np.zeros((3, len(self._vector)), dtype=np.float32)
        rows[0, :2] = cosine * period_s, sine * period_s
        rows[1, :2] = -sine * period_s, cosine * period_s
        rows[2, 2] = period_s
        for limb in self._fires[action]:
            code = int(self.codes[limb])
            to = max(code, _SECANT)
            error = error + self._curve(limb, code)
            rows[:, 3 + limb] = self._curve(limb, to) / (_F(to) / _F(LOST_MAX))
        return error, rows

    def _curve(self, limb: int, code: int) -> Float32:
        """Return (3,) the change of a motion by a limb that has lost a share."""
        return np.asarray(
            self._original.wear_at(limb, code)[:3].astype(np.float32) * self._original.motion_scale
        )

    def _select(self) -> None:
        """Forward selection of limbs and current: in each turn the one that explains most.

        The last unknown is the share that all limbs have lost; a limb's own is then what it has lost beyond.
        """
        limbs = range(3, len(self._vector))
        common = len(self._vector)
        normal = np.zeros((common + 1, common + 2), dtype=np.float32)
        normal[:common, :common], normal[:common, -1] = self._information, self._vector
        normal[range(3), range(3)] += _CURRENT_INFORMATION
        for limb in limbs:
            normal[common] = normal[common] + normal[limb]
        normal[:common, common] = normal[common, :common]
        for limb in limbs:
            normal[common, common] = normal[common, common] + normal[common, limb]
        least = _APART * np.diagonal(normal)
        chosen: list[int] = []
        while True:
            most, best = _PENALTY, None
            for first in (0, *limbs):
                gain = _F(-1) if first in chosen else _gain(normal, first, chosen, least[first])
                if gain > most or (first == 0 and gain >= most):
                    most, best = gain, first
            if not any(chosen) and _gain(normal, common, chosen, least[common]) > most + _COMMON_BY:
                best = common
            if best is None:
                break
            for pivot in range(3) if best == 0 else (best,):
                own = normal[pivot] / normal[pivot, pivot]
                normal = normal - normal[:, pivot, None] * own
                normal[pivot] = own
            chosen.append(best)
        is_chosen = [(0 if k < 3 else k) in chosen for k in range(common + 1)]
        found = np.where(is_chosen, normal[:, -1], _F(0))
        self.current = found[:3]
        shares = np.minimum(found[common] + found[3:common], _F(1))
        self.codes = np.where(shares > 0, shares * _F(LOST_MAX) + _F(0.5), 0).astype(np.int64)


def _gain(normal: Float32, first: int, chosen: list[int], least: np.float32) -> np.float32:
    """Return what a limb, all limbs (the last unknown), or the current (0) explains of the residual.

    It is -1 if a limb has no more than ``least`` information beyond the chosen unknowns, so that the data
    cannot separate it from them, or if a share would be implausible.
    """
    common = len(normal) - 1
    if first == 0:
        values = _solve(normal[:3, :3], normal[:3, -1])
    else:
        left = normal[first, first]
        if not left > least:
            return _F(-1)
        values = normal[first : first + 1, -1] / left
    found = {unknown: normal[unknown, -1] for unknown in chosen if unknown}
    for k, value in enumerate(values):
        found = {unknown: share - normal[unknown, first + k] * value for unknown, share in found.items()}
    if first:
        found[first] = values[0]
    of_all = found.pop(common, None)
    if of_all is not None and not _LEAST < of_all <= _COMMON_MOST:
        return _F(-1)
    if not all(_LEAST < (of_all or _F(0)) + share < _MOST for share in found.values()):
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
