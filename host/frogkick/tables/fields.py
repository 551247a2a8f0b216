"""Checks of a table image's fields, for reading and for packing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Int16
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
    """Raise TableError with a text unless a condition holds."""
    if not good:
        raise TableError(text)


def require_counts(states: int, actions: int, limbs: int, remedy: str) -> None:
    """Raise TableError for counts out of their limits."""
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
    """Raise TableError unless pulse and delay are shorter than the period."""
    good = 1 <= pulse_us < period_us < 2**32 and 0 <= second_delay_us < period_us
    require(
        good,
        f"period {period_us} us, pulse {pulse_us} us, second delay {second_delay_us} us: pulse and delay "
        "must be shorter than the period, the pulse at least 1 us: check the robot",
    )


def action_bytes(row: tuple[str, int, int]) -> bytes:
    """An action in the actions' section."""
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
        raise TableError(
            f"table image's {what} {where} have code {codes[where]}, allowed is +-{allowed}: {AGAIN}"
        )
