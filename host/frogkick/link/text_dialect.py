"""The text dialect of the authors' firmware, as far as it is known.

Two lines are known: ``p 80`` sets the pulse's length in ms, ``h 0 1`` fires limbs together (front left 0,
front right 1, rear left 2, rear right 3). Assumed: a line ends with a newline, answers are ignored, and a
pulse cannot be ended early. Source: Huang, Patterson et al. 2022.

What it cannot say is an ``InputError``.
"""

from __future__ import annotations

from collections.abc import Sequence

from frogkick.core.errors import InputError, nearest_name

DIALECTS = ("frogkick", "frog2022")
LIMBS = ("front_left", "front_right", "rear_left", "rear_right")
"""By their numbers in a line."""


def require_dialect(name: str) -> None:
    """Check the name of a dialect.

    Raises:
        InputError: it is none of DIALECTS.
    """
    if name not in DIALECTS:
        raise InputError(
            f"--dialect is {name!r}{nearest_name(name, DIALECTS)}: choose frogkick (this project's firmware) "
            "or frog2022 (the authors')"
        )


def limb_numbers(names: Sequence[str]) -> tuple[int, ...]:
    """The dialect's number of each limb, by the limbs' names.

    Raises:
        InputError: the dialect does not have a limb.
    """
    unknown = [name for name in names if name not in LIMBS]
    if unknown:
        raise InputError(
            f"dialect frog2022 knows the limbs {', '.join(LIMBS)}, not {unknown[0]!r}: give the authors' "
            "robot, or flash this project's firmware"
        )
    return tuple(LIMBS.index(name) for name in names)


def pulse_line(pulse_us: int) -> bytes:
    """The command that sets the length of pulses.

    Raises:
        InputError: the length is not in whole ms.
    """
    if pulse_us % 1000:
        raise InputError(
            f"the table's pulse is {pulse_us} us, dialect frog2022 takes whole ms: build it with another"
        )
    return b"p %d\n" % (pulse_us // 1000)


def fire_line(limbs: Sequence[int]) -> bytes:
    """The command that fires limbs, by their numbers."""
    return b"h " + b" ".join(b"%d" % limb for limb in sorted(limbs)) + b"\n"
