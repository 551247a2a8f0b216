"""A calibration as a TOML file, with the unit of each number in its name."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.files import existing_file, write_text
from frogkick.vision.calibration import Calibration, Lens, Tag

FORMAT = 1
KEYS: dict[str, tuple[set[str], set[str]]] = {
    "image": ({"width_px", "height_px"}, set()),
    "pool": ({"length_m", "width_m"}, set()),
    "plane": ({"homography_m_to_px", "height_m", "refraction_offset_m"}, set()),
    "camera": (set(), {"place_m", "matrix_px", "distortion"}),
    "tag": (
        {"family", "id", "size_m", "height_m", "refraction_offset_m"},
        {"height_sd_m", "tilt_sd_rad", "mount_heading_rad", "offset_body_m"},
    ),
    "made": ({"method", "points", "rms_px"}, set()),
}
"""Table -> required keys, optional keys."""


def _number(value: float) -> str:
    return repr(float(value))


def _row(values: Float64) -> str:
    return "[" + ", ".join(_number(value) for value in values) + "]"


def _matrix(values: Float64) -> str:
    return "[\n" + "".join(f"    {_row(row)},\n" for row in values) + "]"


def calibration_text(c: Calibration) -> str:
    """The file's text; the same calibration gives the same bytes."""
    lines = [
        "# frogkick camera calibration. Pool's frame: origin in its first corner, x along its length, z up,",
        "# z = 0 on the water. The homography takes (x_m, y_m) of the plane at height_m, as it is seen",
        "# (raised by the refraction offset), to undistorted pixels. Heights under water are negative.",
        f"format = {FORMAT}",
        "[image]", f"width_px = {c.image_px[0]}", f"height_px = {c.image_px[1]}",
        "[pool]", f"length_m = {_number(c.pool_m[0])}", f"width_m = {_number(c.pool_m[1])}",
        "[plane]", f"homography_m_to_px = {_matrix(c.homography)}", f"height_m = {_number(c.plane_height_m)}",
        f"refraction_offset_m = {_number(c.plane_refraction_offset_m)}",
    ]  # fmt: skip
    if c.camera_m is not None or c.lens is not None:
        lines.append("[camera]")
    if c.camera_m is not None:
        lines.append(f"place_m = {_row(c.camera_m)}")
    if c.lens is not None:
        lines += [f"matrix_px = {_matrix(c.lens.matrix_px)}", f"distortion = {_row(c.lens.distortion)}"]
    tag = c.tag
    lines += [
        "[tag]", f'family = "{tag.family}"', f"id = {tag.id}", f"size_m = {_number(tag.size_m)}",
        f"height_m = {_number(tag.height_m)}", f"refraction_offset_m = {_number(tag.refraction_offset_m)}",
        f"height_sd_m = {_number(tag.height_sd_m)}", f"tilt_sd_rad = {_number(tag.tilt_sd_rad)}",
        f"mount_heading_rad = {_number(tag.mount_heading_rad)}",
        f"offset_body_m = {_row(np.array(tag.offset_body_m))}",
        "[made]", f'method = "{c.method}"', f"points = {c.points}", f"rms_px = {_number(c.rms_px)}",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


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
    for name, (needed, optional) in KEYS.items():
        table = tables.setdefault(name, {})
        if not isinstance(table, dict):
            raise InputError(f"calibration {str(path)!r}: {name} is not a table")
        for key in sorted(needed - table.keys()):
            raise InputError(f"calibration {str(path)!r} lacks {name}.{key}")
        for key in sorted(table.keys() - needed - optional):
            near = nearest_name(key, needed | optional)
            raise InputError(f"calibration {str(path)!r} has an unknown key {name}.{key}{near}")
    try:
        return _calibration(tables)
    except (TypeError, ValueError) as error:
        raise InputError(f"calibration {str(path)!r} cannot be used: {error}") from error


def _array(table: dict[str, Any], key: str, shape: tuple[int, ...]) -> Float64:
    values = np.array(table[key], dtype=np.float64)
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"{key} is not {' x '.join(map(str, shape))} finite numbers")
    return values


def _calibration(tables: dict[str, Any]) -> Calibration:
    image, pool, plane, camera, tag, made = (tables[name] for name in KEYS)
    lens = None
    if "matrix_px" in camera:
        distortion = _array(camera, "distortion", (5,)) if "distortion" in camera else np.zeros(5)
        lens = Lens(_array(camera, "matrix_px", (3, 3)), distortion)
    x, y = _array(tag, "offset_body_m", (2,)) if "offset_body_m" in tag else (0.0, 0.0)
    return Calibration(
        (int(image["width_px"]), int(image["height_px"])),
        (float(pool["length_m"]), float(pool["width_m"])),
        _array(plane, "homography_m_to_px", (3, 3)),
        float(plane["height_m"]),
        float(plane["refraction_offset_m"]),
        _array(camera, "place_m", (3,)) if "place_m" in camera else None,
        lens,
        Tag(
            str(tag["family"]), int(tag["id"]), float(tag["size_m"]), float(tag["height_m"]),
            float(tag["refraction_offset_m"]), float(tag.get("height_sd_m", Tag.height_sd_m)),
            float(tag.get("tilt_sd_rad", Tag.tilt_sd_rad)), float(tag.get("mount_heading_rad", 0.0)),
            (float(x), float(y)),
        ),
        str(made["method"]), int(made["points"]), float(made["rms_px"]),
    )  # fmt: skip
