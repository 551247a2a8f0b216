"""Checks of a table image: of its fields, for reading and for packing, then of its header and columns."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from frogkick.core.arrays import Int16, Int64
from frogkick.core.errors import InputError
from frogkick.tables import layout

AGAIN = "make it again with 'frogkick tables build'"


class TableError(InputError):
    """A table image that cannot be used, or transitions that do not fit into one."""


@dataclass(frozen=True)
class ActionRow:
    """An action: two groups of limbs, the second ``second_delay_us`` after the first.

    ``name`` is a printable ASCII character, or the robot's name of the action if the robot is known; bit i of
    a mask is limb i.
    """

    name: str
    first_mask: int
    second_mask: int


def require(good: bool, text: str) -> None:
    """Refuse what cannot be packed.

    Raises:
        TableError: ``good`` is false; with this text.
    """
    if not good:
        raise TableError(text)


def require_usable(good: bool, text: str) -> None:
    """Raise TableError that advises to make the table again unless a condition holds."""
    require(good, f"{text}: {AGAIN}")


def require_counts(states: int, actions: int, limbs: int, remedy: str) -> None:
    """Check the sizes of a table."""
    require(1 <= states <= layout.STATES_MAX, f"{states} states, allowed are 1 to 65535: {remedy}")
    require(1 <= actions <= layout.ACTIONS_MAX, f"{actions} actions, allowed are 1 to 32: {remedy}")
    require(1 <= limbs <= layout.LIMBS_MAX, f"{limbs} limbs, allowed are 1 to 8: {remedy}")


def robot_id_of(field: bytes) -> str:
    """The robot's id from its NUL-padded field."""
    text = field.rstrip(b"\0")
    good = len(field) == layout.ROBOT_ID_BYTES and 1 <= len(text) < layout.ROBOT_ID_BYTES
    require(
        good and all(0x21 <= byte <= 0x7E for byte in text),
        f"robot id {text!r} is not 1 to 15 printable ASCII characters: choose another id",
    )
    return text.decode("ascii")


def require_times(period_us: int, pulse_us: int, second_delay_us: int) -> None:
    good = 1 <= pulse_us < period_us < 2**32 and 0 <= second_delay_us < period_us
    require(
        good,
        f"period {period_us} us, pulse {pulse_us} us, second delay {second_delay_us} us: pulse and delay "
        "must be shorter than the period, the pulse at least 1 us: check the robot",
    )


def action_bytes(row: tuple[str, int, int]) -> bytes:
    name, first, second = row
    good = len(name) == 1 and name.isascii() and 0 <= first <= 255 and 0 <= second <= 255
    require(good, f"action {row!r} is not one ASCII character and two masks of 0 to 255: check the robot")
    return bytes([ord(name), first, second, 0])


def action_rows_of(section: bytes, limbs: int) -> tuple[ActionRow, ...]:
    """The checked rows of the actions' section."""
    rows: list[ActionRow] = []
    for index in range(0, len(section), 4):
        name, first, second, zero = section[index : index + 4]
        where = f"action {index // 4}"
        require(0x21 <= name <= 0x7E, f"{where} has the name byte {name}, not a printable character: {AGAIN}")
        require(
            all(row.name != chr(name) for row in rows), f"{where} repeats the name {chr(name)!r}: {AGAIN}"
        )
        require((first | second) >> limbs == 0, f"{where} fires a limb beyond the {limbs} there are: {AGAIN}")
        require(zero == 0, f"{where} has a padding byte that is not zero: {AGAIN}")
        rows.append(ActionRow(chr(name), first, second))
    return tuple(rows)


def require_codes(what: str, codes: Int16, limit: int | Sequence[int]) -> None:
    """Raise TableError for codes beyond +-limit, one for all or one for each entry of the last axis."""
    bad = np.abs(codes.astype(np.int32)) > np.asarray(limit)
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        allowed = limit if isinstance(limit, int) else limit[where[-1]]
        require_usable(
            False, f"table image's {what} {where} have code {codes[where]}, allowed is +-{allowed}"
        )


def identified(image: bytes) -> Any:
    """The header of a complete and undamaged image of this version and of a known kind."""
    size, known = len(image), layout.FORMAT_VERSION
    require(
        size >= 4 and image[:4] == layout.MAGIC,
        "not a table image (its first 4 bytes are not 'FKTB'): name a .fkt file",
    )
    require_usable(
        size >= layout.HEADER_BYTES,
        f"table image has {size} bytes, its header alone has {layout.HEADER_BYTES}",
    )
    head = layout.header_of(image)
    version, found = head.format_version, zlib.crc32(image[16:])
    require(
        version <= known,
        f"table image has format version {version}, newer than this program's {known}: update frogkick",
    )
    plain = layout.FORMAT_PLAIN
    require_usable(version >= plain, f"table image has format version {version}, older than {plain}")
    require_usable(
        head.kind in layout.KINDS, f"table image is of kind {head.kind}, known are 1 (nearest), 2 (affine)"
    )
    require(
        head.length == size,
        f"table image says it has {head.length} bytes, here are {size}: it is truncated or joined; {AGAIN}",
    )
    require(
        head.crc32 == found,
        f"table image has CRC-32 {found:08x}, its header says {head.crc32:08x}: it is damaged; {AGAIN}",
    )
    knots = head.wear_knots
    require_usable(
        (knots > 0) == (version == known),
        f"table image has format version {version} and {knots} wear knots, which version {known} alone has",
    )
    return head


def laid_out(head: Any) -> layout.Sections:
    """The sections' offsets by the counts, which must be those in the header."""
    for what, levels, most in (
        ("tree", head.tree_levels, layout.TREE_LEVELS_MAX),
        ("block", head.block_levels, layout.BLOCK_LEVELS_MAX if head.kind == layout.KIND_NEAREST else 0),
    ):
        require_usable(
            levels <= most and 2**levels <= head.states,
            f"table image has {levels} {what} levels, allowed are 0 to {most} and at most log2(states)",
        )
    most = layout.WEAR_KNOTS_MAX
    require_usable(
        head.wear_knots <= most, f"table image has {head.wear_knots} wear knots, at most {most} are allowed"
    )
    right = layout.sections(head)
    for name, wanted in right._asdict().items():
        given = getattr(head, name if name == "length" else f"{name}_at", wanted)  # wear has no offset
        require_usable(
            given == wanted, f"table image has its {name} at byte {given}, its counts say {wanted}"
        )
    return right


def require_numbers(head: Any) -> None:
    affine = head.kind == layout.KIND_AFFINE
    for what in ("velocity_scale", "motion_scale"):
        for index, scale in enumerate(getattr(head, what)):
            good = layout.SCALE_MIN <= scale <= layout.SCALE_MAX  # false for NaN as well
            require_usable(good, f"table image's {what}[{index}] is {scale!r}, allowed is 1e-9 to 0.03")
    for what, least, most in (
        ("motion_limit", 1, layout.MOTION_CODE_MAX),
        ("offset_limit", 0, layout.VELOCITY_CODE_MAX if affine else 0),
        ("shift", *((0, layout.CORRECTION_SHIFT_MAX) if affine else layout.PREDICTION_SHIFTS)),
        ("unit", 1, 65535),
        ("up", 0, 0 if affine else 14),
        ("use", 0, layout.USE_MAX if affine else 0),
    ):
        for index, value in enumerate(getattr(head, what)):
            good = least <= value <= most
            require_usable(good, f"table image's {what}[{index}] is {value}, allowed is {least} to {most}")


class Columns(NamedTuple):
    """Columns: bits (a * c,) of a row; kind affine: least (a, 6, 4), history (a, 6, l)."""

    bits: Int64
    least: Int64
    history: Int64


def columns_of(image: bytes, head: Any, right: layout.Sections) -> Columns:
    """Read the columns' section, whose bits must fill a row without gaps."""
    section = image[right.columns : right.wear]
    unit = np.tile(head.unit, head.actions)
    if head.kind == layout.KIND_AFFINE:
        affine = np.frombuffer(section, layout.affine_column(head.limbs)).reshape(head.actions, 6)
        bits = np.tile(layout.AFFINE_BITS, 6 * head.actions).astype(np.int64)
        least, history = affine["least"].astype(np.int64), affine["history"].astype(np.int64)
        zeros, good = history[..., head.limbs :], np.array([True])
        history, value_bits = history[..., : head.limbs], bits[3::4]
    else:
        raw = np.frombuffer(section, layout.COLUMN)
        bits = value_bits = raw["bits"].astype(np.int64)
        least = np.zeros((head.actions, 6, 4), dtype=np.int64)
        history = np.zeros((head.actions, 6, head.limbs), dtype=np.int64)
        zeros, good = raw["zero"], raw["at"] == np.cumsum(bits) - bits
    require_usable(not zeros.any(), "table image has a padding byte that is not zero")
    good = good & (value_bits <= layout.BITS_MAX)
    good &= ((1 << value_bits) - 1) * unit <= layout.RESIDUAL_CODES_MAX
    require_usable(
        bool(good.all()) and head.row_bytes == (int(bits.sum()) + 7) // 8,
        f"table image's columns do not fill its rows of {head.row_bytes} bytes",
    )
    return Columns(bits, least, history)
