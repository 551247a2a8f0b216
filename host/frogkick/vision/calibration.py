"""A camera's calibration: maps between pixels and the pool's frame.

The pool's frame: origin in the pool's first corner, x along its length, y along its width, z up, z = 0 on the
water. A homography takes points of the reference plane (where the four corners or the board were seen) to
pixels. A tag lies higher or lower than that plane; a point q at height z is seen on the line from the camera
through q, which meets the reference plane in p = c + (q - c) (Hc - zp) / (Hc - z), c below the camera.
Heights under water are raised by the refraction offset, depth (1 - 1 / 1.333) for a camera looking down.
"""

from __future__ import annotations

import tomllib
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.files import existing_file, write_text
from frogkick.vision.tags import check_tag

WATER_INDEX = 1.333


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


def refraction_offset_m(height_m: float) -> float:
    """Apparent rise of a point under water seen from above, m; 0 above the water."""
    return max(0.0, -height_m) * (1.0 - 1.0 / WATER_INDEX)


@dataclass(frozen=True)
class Lens:
    """Intrinsics."""

    matrix_px: Float64  # (3, 3) camera matrix
    distortion: Float64  # (5,) k1, k2, p1, p2, k3 of OpenCV's model


@dataclass(frozen=True)
class Tag:
    """The tag on the robot."""

    family: str = "tag36h11"  # ``tag36h11``, or ``tagStandard41h12`` with the extra ``apriltag``
    id: int = 0  # number in the family
    # side of tag36h11's black square, of tagStandard41h12's white one (5 of its 9 cells)
    size_m: float = 0.047
    height_m: float = 0.0  # of the printed face over the water; negative under it
    refraction_offset_m: float = 0.0  # apparent rise
    height_sd_m: float = 0.0005  # standard deviation of its height by waves and trim
    tilt_sd_rad: float = 0.02  # standard deviation of its slopes along x and y by waves and swimming
    # direction of the picture's top, counter-clockwise from the robot's forward
    mount_heading_rad: float = 0.0
    offset_body_m: tuple[float, float] = (0.0, 0.0)  # the tag's centre in the body frame, x forward, y left

    def __post_init__(self) -> None:
        check_tag(self.family, self.id)
        limits = {
            "size_m": (self.size_m, 0.005, 1.0),
            "height_m": (self.height_m, -1.0, 1.0),
            "refraction_offset_m": (self.refraction_offset_m, 0.0, 0.5),
            "height_sd_m": (self.height_sd_m, 0.0, 0.1),
            "tilt_sd_rad": (self.tilt_sd_rad, 0.0, 0.3),
            "mount_heading_rad": (self.mount_heading_rad, -2 * np.pi, 2 * np.pi),
        }
        for name, (value, low, high) in limits.items():
            if not low <= value <= high:
                raise InputError(f"tag {name} is {value:g}, allowed is {low:g} to {high:g}")

    @property
    def apparent_height_m(self) -> float:
        """Height at which the camera sees it."""
        return self.height_m + self.refraction_offset_m


@dataclass(frozen=True)
class Calibration:
    """A camera over a pool."""

    image_px: tuple[int, int]  # width and height of the pictures
    pool_m: tuple[float, float]  # length (x) and width (y) of the pool
    homography: Float64  # (3, 3) reference plane, m, to undistorted pixels
    plane_height_m: float = 0.0  # of the reference plane over the water, negative under it
    plane_refraction_offset_m: float = 0.0  # apparent rise of that plane
    camera_m: Float64 | None = None  # (3,) position of the camera in the pool's frame; None: unknown
    lens: Lens | None = None  # intrinsics; None: unknown
    tag: Tag = Tag()  # the tag on the robot
    method: str = "corners"  # ``corners``, ``chessboard`` or ``charuco``
    points: int = 4  # number of points it was made from
    rms_px: float = 0.0  # root mean square of their residuals; 0 for four corners, which fit exactly

    def __post_init__(self) -> None:
        """Raise InputError for a size, height or matrix out of its limits."""
        for name, value in (("width", self.image_px[0]), ("height", self.image_px[1])):
            if not 32 <= value <= 16_384:
                raise InputError(f"image {name} is {value} px, allowed is 32 to 16384")
        for name, metres in (("length", self.pool_m[0]), ("width", self.pool_m[1])):
            if not 0.05 <= metres <= 100.0:
                raise InputError(f"pool {name} is {metres:g} m, allowed is 0.05 to 100")
        matrix = np.asarray(self.homography)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or np.linalg.cond(matrix) > 1e12:
            raise InputError("the homography is not an invertible 3 x 3 matrix: calibrate again")
        apart = self.tag.apparent_height_m - self.plane_apparent_m
        if self.camera_m is None:
            if abs(apart) > 1e-6:
                raise InputError(
                    f"the tag is {1e3 * apart:.1f} mm over the plane of the calibration and the camera's "
                    "position is unknown: give its height (--camera-height-m) or calibrate with a board"
                )
        elif self.camera_m[2] <= max(self.plane_apparent_m, self.tag.apparent_height_m) + 0.01:
            raise InputError(f"the camera is at {self.camera_m[2]:.3f} m, not above tag and pool")

    @property
    def plane_apparent_m(self) -> float:
        """Height at which the camera sees the reference plane."""
        return self.plane_height_m + self.plane_refraction_offset_m

    def _shift(self, xy_m: Float64, from_m: float, to_m: float) -> Float64:
        """Move points along their lines of sight from one apparent height to another, m."""
        if self.camera_m is None or from_m == to_m:
            return xy_m
        below, height = self.camera_m[:2], self.camera_m[2]
        return np.asarray(below + (xy_m - below) * (height - to_m) / (height - from_m))

    def pixels(self, xy_m: Float64) -> Float64:
        """(n, 2) undistorted pixels of (n, 2) points of the pool at the tag's apparent height."""
        return apply(self.homography, self._shift(xy_m, self.tag.apparent_height_m, self.plane_apparent_m))

    def pool(self, undistorted_px: Float64, height_m: float | None = None) -> Float64:
        """(n, 2) points of the pool, m, seen at (n, 2) pixels; at an apparent height, None: the tag's."""
        height = self.tag.apparent_height_m if height_m is None else height_m
        inverse = np.asarray(np.linalg.inv(self.homography), dtype=np.float64)
        on_plane = apply(inverse, undistorted_px)
        return self._shift(on_plane, self.plane_apparent_m, height)

    def undistort(self, image_px: Float64) -> Float64:
        """(n, 2) undistorted pixels of pixels of a picture; the same ones if the lens is unknown."""
        if self.lens is None:
            return image_px
        matrix, distortion = self.lens.matrix_px, self.lens.distortion
        points = np.ascontiguousarray(image_px).reshape(-1, 1, 2)
        return np.asarray(
            cv2.undistortPoints(points, matrix, distortion, P=matrix).reshape(-1, 2), dtype=np.float64
        )

    def distort(self, undistorted_px: Float64) -> Float64:
        """The inverse of ``undistort``."""
        if self.lens is None:
            return undistorted_px
        rays = np.c_[undistorted_px, np.ones(len(undistorted_px))] @ np.linalg.inv(self.lens.matrix_px).T
        seen, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.lens.matrix_px, self.lens.distortion)
        return np.asarray(seen.reshape(-1, 2), dtype=np.float64)


def camera_pose(homography: Float64, matrix_px: Float64, plane_m: float) -> tuple[Float64, Float64]:
    """Pose of the camera from the homography of a plane and the camera matrix.

    Returns:
        (3, 3) rotation pool to camera (z forward, y down) and (3,) position in the pool's frame, m.

    Source: Zhang 2000, section 3.1.
    """
    a = np.linalg.inv(matrix_px) @ homography
    a /= np.sqrt(np.linalg.norm(a[:, 0]) * np.linalg.norm(a[:, 1]))
    if a[2, 2] < 0:  # the pool must be in front of the camera
        a = -a
    u, _, vt = np.linalg.svd(np.c_[a[:, 0], a[:, 1], np.cross(a[:, 0], a[:, 1])])
    rotation = u @ vt
    place = -rotation.T @ a[:, 2]
    place[2] += plane_m
    return rotation, place


def lens_from_height(
    homography: Float64, image_px: tuple[int, int], camera_height_m: float, plane_m: float
) -> Float64:
    """The camera matrix with square centred pixels that gives the camera a measured height over the water.

    ``plane_m`` is the apparent height of the reference plane, which the homography takes to pixels.

    Raises:
        InputError: no lens gives the camera this height.
    """
    width, height = image_px

    def matrix(focal: float) -> Float64:
        return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])

    low, high = 0.2 * width, 20.0 * width
    reach = [camera_pose(homography, matrix(f), plane_m)[1][2] for f in (low, high)]
    if not reach[0] < camera_height_m < reach[1]:
        raise InputError(
            f"a camera {camera_height_m:g} m above the water does not fit the corners: its height can be "
            f"{reach[0]:.2f} to {reach[1]:.2f} m; measure again"
        )
    for _ in range(60):
        middle = np.sqrt(low * high)
        if camera_pose(homography, matrix(middle), plane_m)[1][2] < camera_height_m:
            low = middle
        else:
            high = middle
    return matrix(float(np.sqrt(low * high)))


def camera_of(
    homography: Float64,
    image_px: tuple[int, int],
    plane_m: float,
    lens: Lens | None,
    camera_height_m: float | None,
) -> tuple[Float64, Float64, Float64] | None:
    """Camera matrix and ``camera_pose``, by the lens or by the camera's height; None without both."""
    if lens is not None:
        matrix = lens.matrix_px
    elif camera_height_m is not None:
        matrix = lens_from_height(homography, image_px, camera_height_m, plane_m)
    else:
        return None
    return matrix, *camera_pose(homography, matrix, plane_m)


FORMAT = 1
HEAD = f"""\
# frogkick camera calibration. Pool's frame: origin in its first corner, x along its length, z up,
# z = 0 on the water. The homography takes (x_m, y_m) of the plane at height_m, as it is seen
# (raised by the refraction offset), to undistorted pixels. Heights under water are negative.
format = {FORMAT}
"""


Kind = type | tuple[int, ...]
"""The type of a value, or the shape of an array of numbers."""

KEYS: dict[str, dict[str, Kind]] = {
    "image": {"width_px": int, "height_px": int},
    "pool": {"length_m": float, "width_m": float},
    "plane": {"homography_m_to_px": (3, 3), "height_m": float, "refraction_offset_m": float},
    "camera": {"place_m": (3,), "matrix_px": (3, 3), "distortion": (5,)},
    "tag": {
        **{"family": str, "id": int, "size_m": float, "height_m": float, "refraction_offset_m": float},
        **{"height_sd_m": float, "tilt_sd_rad": float, "mount_heading_rad": float, "offset_body_m": (2,)},
    },
    "made": {"method": str, "points": int, "rms_px": float},
}
"""Table -> its keys in their order; those of ``tag`` are the fields of ``Tag``."""
OPTIONAL = {*KEYS["camera"], "height_sd_m", "tilt_sd_rad", "mount_heading_rad", "offset_body_m"}


def _written(value: Any, kind: Kind) -> str:
    if isinstance(kind, type):
        return f'"{value}"' if kind is str else repr(kind(value))
    rows = ["[" + ", ".join(repr(float(each)) for each in row) + "]" for row in np.atleast_2d(value)]
    return rows[0] if len(kind) == 1 else "[\n" + "".join(f"    {row},\n" for row in rows) + "]"


def calibration_text(calibration: Calibration) -> str:
    """The file's text; the same calibration gives the same bytes."""
    c, lens = calibration, calibration.lens
    values = (
        c.image_px,
        c.pool_m,
        (c.homography, c.plane_height_m, c.plane_refraction_offset_m),
        (c.camera_m, lens and lens.matrix_px, lens and lens.distortion),
        astuple(c.tag),
        (c.method, c.points, c.rms_px),
    )
    text = HEAD
    for (table, keys), row in zip(KEYS.items(), values, strict=True):
        given = [(key, value) for key, value in zip(keys, row, strict=True) if value is not None]
        text += f"[{table}]\n" if given else ""
        text += "".join(f"{key} = {_written(value, keys[key])}\n" for key, value in given)
    return text


def write_calibration(path: Path | str, calibration: Calibration) -> None:
    """Write the file, completely or not at all."""
    write_text(path, calibration_text(calibration))


def read_calibration(path: Path | str) -> Calibration:
    """Read and check a calibration.

    Raises:
        InputError: no such file, another format, keys that are missing, unknown or of another shape, or
            values out of their limits.
    """
    file = existing_file(path, "calibration")
    try:
        tables = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"calibration {str(path)!r} is not TOML: {error}") from error
    except UnicodeError as error:
        raise InputError(f"calibration {str(path)!r} is not text: give the .toml file") from error
    if "format" not in tables:
        raise InputError(
            f"{str(path)!r} is not a calibration of a camera: give the file that 'frogkick camera calibrate' "
            "wrote"
        )
    if tables["format"] != FORMAT:
        raise InputError(
            f"calibration {str(path)!r} has format {tables['format']!r}, this version reads {FORMAT}: "
            "make it again with 'frogkick camera calibrate'"
        )
    for name in tables:
        if name != "format" and name not in KEYS:
            raise InputError(
                f"calibration {str(path)!r} has an unknown table {name!r}{nearest_name(name, KEYS)}"
            )
    for name, keys in KEYS.items():
        table = tables.setdefault(name, {})
        if not isinstance(table, dict):
            raise InputError(f"calibration {str(path)!r}: {name} is not a table")
        for key in sorted(keys.keys() - OPTIONAL - table.keys()):
            raise InputError(f"calibration {str(path)!r} lacks {name}.{key}")
        for key in sorted(table.keys() - keys):
            raise InputError(
                f"calibration {str(path)!r} has an unknown key {name}.{key}{nearest_name(key, keys)}"
            )
    try:
        return _calibration(tables)
    except (TypeError, ValueError) as error:
        raise InputError(f"calibration {str(path)!r} cannot be used: {error}") from error


def _read(key: str, value: Any, kind: Kind) -> Any:
    if isinstance(kind, type):
        return kind(value)
    values = np.array(value, dtype=np.float64)
    if values.shape != kind or not np.isfinite(values).all():
        raise ValueError(f"{key} is not {' x '.join(map(str, kind))} finite numbers")
    return values


def _calibration(tables: dict[str, Any]) -> Calibration:
    image, pool, plane, camera, tag, made = (
        {key: _read(key, tables[table][key], kind) for key, kind in keys.items() if key in tables[table]}
        for table, keys in KEYS.items()
    )
    lens = None
    if "matrix_px" in camera:
        lens = Lens(camera["matrix_px"], camera.get("distortion", np.zeros(5)))
    if "offset_body_m" in tag:
        tag["offset_body_m"] = tuple(tag["offset_body_m"].tolist())
    return Calibration(
        (image["width_px"], image["height_px"]),
        (pool["length_m"], pool["width_m"]),
        plane["homography_m_to_px"],
        plane["height_m"],
        plane["refraction_offset_m"],
        camera.get("place_m"),
        lens,
        Tag(**tag),
        **made,
    )
