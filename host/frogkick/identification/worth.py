"""What an effect and its parameters must gain to be taken, and when two models do equally well."""

from __future__ import annotations

from frogkick.identification.fit import Fitted

BASE_GAIN, GAIN_EACH = 20.0, 4.0
"""By how much minus twice the log likelihood must fall for an effect, and more for each free parameter."""

ALIKE = 15.0
"""Effects whose gains differ by less cannot be told apart."""

SAME = ("limb_wear all", "fix_latency")
"""Every limb late and every fix late are one swim, but for its first stroke. The second is simpler."""

SAME_ALIKE = 4.0 * ALIKE
"""Such two may differ by more: by 22, under one's noise, in world 20010 of ``study verdicts``."""


def free_count(fitted: Fitted) -> int:
    """How many parameters a fit has found."""
    return len(fitted.model.values) - len(fitted.model.held)


def price(fitted: Fitted) -> float:
    """Cost, and what the free parameters cost."""
    return fitted.cost + GAIN_EACH * free_count(fitted)
