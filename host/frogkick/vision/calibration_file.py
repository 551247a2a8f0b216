"""A calibration as a TOML file, with the unit of each number in its name."""

from __future__ import annotations

import tomllib
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.errors import InputError, nearest_name
from frogkick.core.files import existing_file, write_text
from frogkick.vision.calibration import Calibration, Lens, Tag

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
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
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
