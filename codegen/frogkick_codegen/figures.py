"""What an emitted planner costs on the chip, as its README and its header say it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class DepthTime:
    """Times of one decision at a depth, at 64 MHz: states timed, mean and worst."""

    states: int
    mean_ms: float
    worst_ms: float


@dataclass(frozen=True)
class Figures:
    """Measured on the emitted files themselves, compiled for the nRF52832.

    Attributes:
        compiler: that built them, with its version.
        flags: that decide on size and speed.
        code_bytes: flash of the planner's code and constants, without the table.
        ram_bytes: type of the interface -> its size.
        static_bytes: RAM that the planner keeps itself.
        stack_bytes: the most that a call of the function can use, by function.
        open_ms: checking and opening the table, once after start-up.
        times: depth -> times of a decision.
    """

    compiler: str
    flags: str
    code_bytes: int
    ram_bytes: Mapping[str, int]
    static_bytes: int
    stack_bytes: Mapping[str, int]
    open_ms: float
    times: Mapping[int, DepthTime]
