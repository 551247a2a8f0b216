"""Table images (``.fkt``): pack, check, open. The layout stands in ``layout.py``."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from frogkick.errors import InputError
from frogkick.files import existing_file
from frogkick.planner import layout

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int16 = npt.NDArray[np.int16]

VELOCITY_COLUMNS = ("vx_mps", "vy_mps", "omega_rad_s")
MOTION_COLUMNS = ("dx_m", "dy_m", "dheading_rad")
_AGAIN = "make it again with 'frogkick tables build'"


class TableError(InputError):
    """A table image that cannot be used, or transitions that fit no table image."""


@dataclass(frozen=True)
class ActionRow:
    """One action: two groups of limbs, the second ``second_delay_us`` after the first.

    ``name`` is one printable ASCII character; bit i of a mask is limb i, 0 = no limb.
    """

    name: str
    first_mask: int
    second_mask: int


@dataclass(frozen=True, eq=False)
class Tables:
    """An opened, wholly checked table image. All arrays are read-only views of ``image``.

    Attributes:
        image: the bytes themselves.
        robot_id: the robot that the table is for.
        provenance: 32 bytes, SHA-256 of the library's content.
        period_us, pulse_us, second_delay_us: integer microseconds.
        limbs: number of limbs, 1 to 8.
        actions: the actions in table order.
        velocity_scale: (3,) float32 velocity per code: m/s, m/s, rad/s, body frame.
        motion_scale: (3,) float32 motion per code: m, m, rad, body frame at the action's start.
        states: (n, 3) int16 velocity codes in k-d order.
        transitions: (n, a, 6) int16: three motion codes, three velocity codes at the action's end.
    """

    image: bytes
    robot_id: str
    provenance: bytes
    period_us: int
    pulse_us: int
    second_delay_us: int
    limbs: int
    actions: tuple[ActionRow, ...]
    velocity_scale: Float32
    motion_scale: Float32
    states: Int16
    transitions: Int16

    @property
    def kind(self) -> str:
        """The kind of table by name."""
        return "nearest"

    @property
    def crc32(self) -> int:
        """CRC-32 of the image, as its header and the robot's HELLO have it."""
        return zlib.crc32(self.image[16:])

    def require_robot(self, robot_id: str) -> None:
        """Refuse a table that was made for another robot.

        Raises:
            TableError: ``robot_id`` is not the table's; the text names both.
        """
        if robot_id != self.robot_id:
            raise TableError(
                f"table image is for robot {self.robot_id!r}, this robot is {robot_id!r}: "
                f"build tables from a library of {robot_id!r}"
            )


def read_image(path: Path | str) -> Tables:
    """Open a table image file.

    Raises:
        InputError: no such file, or an empty one.
        TableError: the file is not a usable table image; the text names the file.
    """
    file = existing_file(path, "table image")
    try:
        return open_image(file.read_bytes())
    except TableError as error:
        raise TableError(f"{str(path)!r}: {error}") from None
    except OSError as error:
        raise InputError(
            f"table image {str(path)!r} cannot be read: {error.strerror}; check access"
        ) from None


def open_image(image: bytes) -> Tables:
    """Check every part of a table image and return views of it.

    Args:
        image: the whole image, nothing before or after it.

    Raises:
        TableError: one clear line on the first thing that is wrong.
    """
    size = len(image)
    _require(
        size >= 4 and image[:4] == layout.MAGIC,
        "not a table image (its first 4 bytes are not 'FKTB'): name a .fkt file",
    )
    _require(size >= layout.HEADER_BYTES, f"table image has {size} bytes, its header alone has 128: {_AGAIN}")
    # fmt: off
    (
        _, version, kind, length, crc, robot, provenance, period_us, pulse_us, states, actions, limbs,
        actions_at, states_at, transitions_at, *scales, second_delay_us,
    ) = layout.HEADER.unpack_from(image)
    # fmt: on
    _require(
        version <= layout.FORMAT_VERSION,
        f"table image has format version {version}, newer than this program's {layout.FORMAT_VERSION}: "
        "update frogkick",
    )
    _require(version == layout.FORMAT_VERSION, f"table image has format version {version}, not 1: {_AGAIN}")
    _require(kind == layout.KIND_NEAREST, f"table image is of kind {kind}, known is 1 (nearest): {_AGAIN}")
    _require(
        length == size,
        f"table image says it has {length} bytes, here are {size}: it is truncated or joined; {_AGAIN}",
    )
    found = zlib.crc32(image[16:])
    _require(
        crc == found,
        f"table image has CRC-32 {found:08x}, its header says {crc:08x}: it is damaged; {_AGAIN}",
    )
    _require(states >= 1, f"table image has 0 states, at least 1 is needed: {_AGAIN}")
    _require(
        1 <= actions <= layout.ACTIONS_MAX,
        f"table image has {actions} actions, allowed are 1 to 32: {_AGAIN}",
    )
    _require(1 <= limbs <= layout.LIMBS_MAX, f"table image has {limbs} limbs, allowed are 1 to 8: {_AGAIN}")
    right = layout.sections(states, actions)
    for name, given, wanted in (
        ("actions", actions_at, right.actions),
        ("states", states_at, right.states),
        ("transitions", transitions_at, right.transitions),
        ("end", length, right.length),
    ):
        _require(
            given == wanted,
            f"table image has its {name} at byte {given}, format 1 has it at {wanted}: {_AGAIN}",
        )
    robot_id = _robot_id(robot)
    _require_times(period_us, pulse_us, second_delay_us)
    for index, scale in enumerate(scales):
        what = ("velocity_scale", "motion_scale")[index // 3]
        _require(
            layout.SCALE_MIN <= scale <= layout.SCALE_MAX,  # false for NaN as well
            f"table image's {what}[{index % 3}] is {scale!r}, allowed is 1e-9 to 0.03: {_AGAIN}",
        )
    _require(not any(image[116:128]), f"table image has a reserved byte that is not zero: {_AGAIN}")
    rows = _action_rows(image[right.actions : right.states], limbs)
    padding = image[right.states + 6 * states : right.transitions]
    _require(not any(padding), f"table image has a padding byte that is not zero: {_AGAIN}")
    state_codes = np.frombuffer(image, "<i2", 3 * states, right.states).reshape(states, 3)
    transition_codes = np.frombuffer(image, "<i2", 6 * states * actions, right.transitions)
    transition_codes = transition_codes.reshape(states, actions, 6)
    _require_codes("states", state_codes, layout.VELOCITY_CODE_MAX)
    _require_codes("transitions", transition_codes[:, :, :3], layout.MOTION_CODE_MAX)
    _require_codes("transitions' velocities", transition_codes[:, :, 3:], layout.VELOCITY_CODE_MAX)
    wrong = layout.kd_violation(state_codes)
    _require(wrong is None, f"table image's state {wrong} breaks the k-d order: {_AGAIN}")
    return Tables(
        image=bytes(image),
        robot_id=robot_id,
        provenance=provenance,
        period_us=period_us,
        pulse_us=pulse_us,
        second_delay_us=second_delay_us,
        limbs=limbs,
        actions=rows,
        velocity_scale=_frozen(np.array(scales[:3], dtype=np.float32)),
        motion_scale=_frozen(np.array(scales[3:], dtype=np.float32)),
        states=state_codes,
        transitions=transition_codes,
    )


def pack_nearest(
    robot_id: str,
    provenance: bytes,
    period_us: int,
    pulse_us: int,
    second_delay_us: int,
    limbs: int,
    action_rows: Sequence[tuple[str, int, int]],
    velocity_scale: Sequence[float],
    velocities: npt.ArrayLike,
    displacements: npt.ArrayLike,
    velocities_end: npt.ArrayLike,
) -> bytes:
    """Quantise transitions to a table image of kind ``nearest``.

    Values are rounded half away from zero to multiples of the float32 scale. The scale of motions is the
    finest that holds the largest motion of its axis. Rows are put into k-d order.

    Args:
        robot_id: 1 to 15 printable ASCII characters.
        provenance: SHA-256 of the library's content, 32 bytes.
        period_us, pulse_us, second_delay_us: integer microseconds, pulse and delay shorter than the period.
        limbs: 1 to 8.
        action_rows: (name, mask of the first group, mask of the second) per action.
        velocity_scale: velocity per code, (m/s, m/s, rad/s).
        velocities: (n, 3) body-frame initial velocities (forward m/s, left m/s, rad/s).
        displacements: (n, a, 3) motion over one period (m, m, rad), body frame at its start.
        velocities_end: (n, a, 3) body-frame velocities at the end of the period.

    Returns:
        The image; the same input gives the same bytes.

    Raises:
        TableError: wrong shapes or counts, or a value that is not finite or out of range: the text names
            its row (of the input) and column.
    """
    actions = len(action_rows)
    start = np.asarray(velocities, dtype=np.float64)
    motion = np.asarray(displacements, dtype=np.float64)
    end = np.asarray(velocities_end, dtype=np.float64)
    states = len(start)
    _require(
        1 <= actions <= layout.ACTIONS_MAX, f"{actions} actions given, a table holds 1 to 32: choose fewer"
    )
    _require(1 <= limbs <= layout.LIMBS_MAX, f"{limbs} limbs given, a table holds 1 to 8: check the robot")
    _require(
        1 <= states <= layout.STATES_MAX, f"{states} states given, a table holds 1 to 65535: choose --states"
    )
    for name, array, shape in (
        ("velocities", start, (states, 3)),
        ("displacements", motion, (states, actions, 3)),
        ("velocities_end", end, (states, actions, 3)),
    ):
        _require(
            array.shape == shape, f"{name} has shape {array.shape}, needed is {shape}: check the library"
        )
    _require(
        len(provenance) == 32, f"provenance has {len(provenance)} bytes, a SHA-256 has 32: pass the digest"
    )
    robot = robot_id.encode("utf-8")
    _robot_id(robot.ljust(layout.ROBOT_ID_BYTES, b"\0"))
    _require_times(period_us, pulse_us, second_delay_us)
    action_bytes = b"".join(_action_bytes(row) for row in action_rows)
    _action_rows(action_bytes, limbs)

    scale = np.array(velocity_scale, dtype=np.float32)
    _require(
        scale.shape == (3,) and bool(np.all((scale >= layout.SCALE_MIN) & (scale <= layout.SCALE_MAX))),
        f"velocity_scale is {tuple(velocity_scale)}, allowed are three values of 1e-9 to 0.03: "
        "check the robot",
    )
    start_codes = _quantise(
        "initial velocities", VELOCITY_COLUMNS, start, scale, layout.VELOCITY_CODE_MAX, action_rows
    )
    motion_scale = _motion_scale(motion, action_rows)
    motion_codes = _quantise(
        "displacements", MOTION_COLUMNS, motion, motion_scale, layout.MOTION_CODE_MAX, action_rows
    )
    end_codes = _quantise(
        "end velocities", VELOCITY_COLUMNS, end, scale, layout.VELOCITY_CODE_MAX, action_rows
    )

    order = layout.kd_order(start_codes)
    right = layout.sections(states, actions)
    state_bytes = start_codes[order].astype("<i2").tobytes()
    body = action_bytes + state_bytes.ljust(right.transitions - right.states, b"\0")
    body += np.concatenate([motion_codes, end_codes], axis=2)[order].astype("<i2").tobytes()

    def header(crc: int) -> bytes:
        return layout.HEADER.pack(
            layout.MAGIC, layout.FORMAT_VERSION, layout.KIND_NEAREST, right.length, crc, robot, provenance,
            period_us, pulse_us, states, actions, limbs, right.actions, right.states, right.transitions,
            *scale.tolist(), *motion_scale.tolist(), second_delay_us,
        )  # fmt: skip

    crc = zlib.crc32(header(0)[16:] + body)
    return header(crc) + body


def _quantise(
    what: str,
    columns: tuple[str, ...],
    values: Float64,
    scale: Float32,
    limit: int,
    rows: Sequence[tuple[str, int, int]],
) -> Int16:
    """Round half away from zero to codes; the first value out of range is named by row and column."""
    ratio = values / scale.astype(np.float64)
    codes = np.copysign(np.floor(np.abs(ratio) + 0.5), ratio)
    bad = ~(np.abs(codes) <= limit)  # true for NaN as well
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        axis = where[-1]
        action = f", action {rows[where[1]][0]}" if len(where) == 3 else ""
        raise TableError(
            f"{what}: row {where[0]}{action}, column {columns[axis]} is {float(values[where])!r}, allowed is "
            f"+-{limit * float(scale[axis]):.6g}: leave the row out or choose a coarser scale"
        )
    return codes.astype(np.int16)


def _motion_scale(motion: Float64, rows: Sequence[tuple[str, int, int]]) -> Float32:
    """Return the finest float32 scale of each axis that keeps every code within 16 bits."""
    ceiling = np.full(3, layout.SCALE_MAX, dtype=np.float32)
    _quantise("displacements", MOTION_COLUMNS, motion, ceiling, layout.MOTION_CODE_MAX - 1, rows)
    largest = np.abs(motion).max(axis=(0, 1))
    scale = (largest / layout.MOTION_CODE_MAX).astype(np.float32)
    # float32 rounding may leave the scale a hair too small, which the code's rounding absorbs: the
    # quotient exceeds 32767 by at most 32767 * 2**-24 < 0.5. An axis without motion gets the floor.
    return np.asarray(np.clip(scale, np.float32(layout.SCALE_MIN), ceiling), dtype=np.float32)


def _robot_id(field: bytes) -> str:
    """Return the robot's id from its NUL-padded field."""
    text = field.rstrip(b"\0")
    good = len(field) == layout.ROBOT_ID_BYTES and 1 <= len(text) < layout.ROBOT_ID_BYTES
    _require(
        good and all(0x21 <= byte <= 0x7E for byte in text),
        f"robot id {text!r} is not 1 to 15 printable ASCII characters: choose another id",
    )
    return text.decode("ascii")


def _require_times(period_us: int, pulse_us: int, second_delay_us: int) -> None:
    good = 1 <= pulse_us < period_us < 2**32 and 0 <= second_delay_us < period_us
    _require(
        good,
        f"period {period_us} us, pulse {pulse_us} us, second delay {second_delay_us} us: pulse and delay "
        "must be shorter than the period, the pulse at least 1 us: check the robot",
    )


def _action_bytes(row: tuple[str, int, int]) -> bytes:
    name, first, second = row
    good = len(name) == 1 and name.isascii() and 0 <= first <= 255 and 0 <= second <= 255
    _require(good, f"action {row!r} is not one ASCII character and two masks of 0 to 255: check the robot")
    return bytes([ord(name), first, second, 0])


def _action_rows(section: bytes, limbs: int) -> tuple[ActionRow, ...]:
    """Check the actions' section and return its rows."""
    rows: list[ActionRow] = []
    for index in range(0, len(section), 4):
        name, first, second, zero = section[index : index + 4]
        where = f"action {index // 4}"
        _require(
            0x21 <= name <= 0x7E, f"{where} has the name byte {name}, not a printable character: {_AGAIN}"
        )
        _require(
            all(row.name != chr(name) for row in rows), f"{where} repeats the name {chr(name)!r}: {_AGAIN}"
        )
        _require(
            (first | second) >> limbs == 0, f"{where} fires a limb beyond the {limbs} there are: {_AGAIN}"
        )
        _require(zero == 0, f"{where} has a padding byte that is not zero: {_AGAIN}")
        rows.append(ActionRow(chr(name), first, second))
    return tuple(rows)


def _require_codes(what: str, codes: Int16, limit: int) -> None:
    bad = np.abs(codes.astype(np.int32)) > limit
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise TableError(
            f"table image's {what} {where} have code {codes[where]}, allowed is +-{limit}: {_AGAIN}"
        )


def _require(good: bool, text: str) -> None:
    if not good:
        raise TableError(text)


def _frozen(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.setflags(write=False)
    return array
