"""The chip's own error."""

from __future__ import annotations

from frogkick.core.errors import FrogkickError


class ChipError(FrogkickError):
    """The firmware did what the chip cannot do, or what this model of it does not know.

    The text names what was done, the register or address, and the program counter.
    """
