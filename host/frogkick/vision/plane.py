"""Maps of a plane to a plane."""

from __future__ import annotations

import numpy as np

from frogkick.core.arrays import Float64


def apply(homography: Float64, points: Float64) -> Float64:
    """Map (n, 2) points by a (3, 3) homography."""
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def from_four(source: Float64, target: Float64) -> Float64:
    """The homography that takes four points (4, 2) exactly to four others.

    Raises:
        numpy.linalg.LinAlgError: three of the points lie on one line.
    """
    rows = np.zeros((8, 8))
    rows[0::2, :2] = rows[1::2, 3:5] = source
    rows[0::2, 2] = rows[1::2, 5] = 1.0
    rows[0::2, 6:] = -source * target[:, :1]
    rows[1::2, 6:] = -source * target[:, 1:]
    return np.append(np.linalg.solve(rows, target.ravel()), 1.0).reshape(3, 3)
