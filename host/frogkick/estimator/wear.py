"""How much of its contribution each limb has lost, learned while the robot swims.

What a period missed is held against the wear curves of the limbs that fired in it and against a current. Sums
of all periods are kept, older ones fading: recursive least squares with exponential forgetting (Ljung 1999,
System Identification, section 11.2). Limbs and the current are selected forward, as long as one more gains
more than its penalty: where nothing is worn, nothing is learned, and the planner decides as without.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from frogkick.core.errors import InputError
from frogkick.tables.image import Tables
from frogkick.tables.layout import LOST_MAX

Float64 = npt.NDArray[np.float64]

NOISE = (0.0012, 0.0012, 0.02)
"""Standard deviation of what a period misses where all is known: forward, left (m), turn (rad). The default
table misses less; wear curves, which are means over actions and states, miss more."""

CURRENT = (0.003, 0.003, 0.005)
"""Standard deviation of what currents are expected: m/s, m/s, rad/s."""

FADING = 0.96
"""What remains of older periods' weight at each new one: half of it after 17."""

PENALTY = 9.0
"""What a limb, or the current, must gain to be believed, in units of the noise squared: three deviations."""

SURPRISE, KEPT = 30.0, 0.3
"""Where a period's squared miss exceeds the first, limbs have changed: this much of older ones remains."""

SECANT = 0.7
"""Lost share up to which a wear curve is taken as a straight line; beyond it, as the line to its place."""

LEAST, MOST = 0.02, 1.3
"""Lost shares that are believed; above one a curve's end is meant."""


class WearFilter:
    """Learns the lost share of each limb from what each period missed.

    Attributes:
        lost: (l,) share of its contribution that each limb has lost, 0 to 1.
        current: (3,) what a current moves the robot, world frame, m/s and rad/s.
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
        limbs = tables.limbs
        masks = np.array([row.first_mask | row.second_mask for row in tables.actions], dtype=np.int64)
        self._fires = ((masks[:, None] >> np.arange(limbs)) & 1).astype(bool)
        curves = tables.limb_wear[:, :, :3] * np.asarray(tables.motion_scale, dtype=np.float64)
        self._curves = np.concatenate([np.zeros((limbs, 1, 3)), curves], axis=1)
        self._information = np.zeros((limbs + 3, limbs + 3))
        self._vector = np.zeros(limbs + 3)
        self._original = tables
        self.lost = np.zeros(limbs)
        self.current = np.zeros(3)

    @property
    def tables(self) -> Tables:
        """The table of the robot with these limbs."""
        return self._original.worn(np.round(self.lost * LOST_MAX).astype(np.int64))

    def learn(
        self, missed_world: Float64, variance: Float64, heading_rad: float, action: int, period_s: float
    ) -> None:
        """Learn from a period that has ended.

        Args:
            missed_world: (3,) pose at its end minus the pose that ``tables`` predicted: m, m, rad, world.
            variance: (3,) of that pose by the fixes.
            heading_rad: where the robot headed when the period began.
            action: of the period.
            period_s: its length.
        """
        limbs = len(self.lost)
        if action >= len(self._fires):
            return
        cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
        to_body = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        missed: Float64 = to_body @ missed_world
        rows = np.zeros((3, limbs + 3))
        for limb in np.flatnonzero(self._fires[action]).tolist():
            missed = missed + self._curve(limb, self.lost[limb])
            share = max(self.lost[limb], SECANT)
            rows[:, limb] = self._curve(limb, share) / share
        rows[:, limbs:] = to_body * period_s
        weights = 1.0 / (np.square(NOISE) + variance)
        left = missed - rows @ np.concatenate([self.lost, self.current])
        kept = FADING * (KEPT if float(weights @ left**2) > SURPRISE else 1.0)
        weighted = rows * weights[:, None]
        self._information = kept * self._information + rows.T @ weighted
        self._vector = kept * self._vector + weighted.T @ missed
        self._select()

    def _curve(self, limb: int, share: float) -> Float64:
        """(3,) what a limb that has lost a share changes of a motion."""
        at = np.clip(share, 0.0, 1.0) * (self._curves.shape[1] - 1)
        knot = min(int(at), self._curves.shape[1] - 2)
        before, after = self._curves[limb, knot], self._curves[limb, knot + 1]
        return np.asarray(before + (after - before) * (at - knot))

    def _select(self) -> None:
        """Believe the limbs, and the current, that gain most, one after another."""
        limbs = len(self.lost)
        columns = [[limb] for limb in range(limbs)] + [[limbs, limbs + 1, limbs + 2]]
        information = self._information + np.diag([0.0] * limbs + [1.0 / each**2 for each in CURRENT])
        chosen: list[int] = []
        found, gained = np.zeros(limbs + 3), 0.0
        while True:
            best = None
            for group in range(limbs + 1):
                taken = [k for each in [*chosen, group] for k in columns[each]]
                if group in chosen or not information[taken[-1], taken[-1]]:
                    continue
                try:
                    values = np.linalg.solve(information[np.ix_(taken, taken)], self._vector[taken])
                except np.linalg.LinAlgError:
                    continue  # two limbs that only ever fired together
                shares = [value for k, value in zip(taken, values, strict=True) if k < limbs]
                gain = float(self._vector[taken] @ values)
                if gain < gained + PENALTY or (shares and not LEAST < min(shares) <= max(shares) < MOST):
                    continue
                if best is None or gain > best[0]:
                    best = gain, group, taken, values
            if best is None:
                break
            gained, group, taken, values = best
            chosen.append(group)
            found = np.zeros(limbs + 3)
            found[taken] = values
        self.lost, self.current = np.clip(found[:limbs], 0.0, 1.0), found[limbs:]
