"""What an effect and its parameters must gain to be taken, and when two models do equally well.

Models are compared by their penalised deviance: minus twice the log likelihood, plus a penalty for each
effect and for each of its free parameters. It differs from the Bayesian information criterion (Schwarz 1978),
whose penalty is ln(n) for each parameter: here the penalty of a parameter does not grow with the number n of
periods (4 is BIC's at 55 periods), and an effect has a penalty of its own, because it is the best of many
candidates.
"""

from __future__ import annotations

from frogkick.identification.fit import Fitted

EFFECT_PENALTY, PARAMETER_PENALTY = 20.0, 4.0
"""Penalty of each effect, and of each free parameter, in units of the deviance."""

CONFOUNDED_MARGIN = 15.0
"""Effects whose penalised deviances differ by less are confounded: the data cannot tell them apart."""

EQUIVALENT = ("limb_wear all", "fix_latency")
"""All limbs late and all fixes late give the same run, but for its first stroke. The second is simpler."""

EQUIVALENT_MARGIN = 4.0 * CONFOUNDED_MARGIN
"""Those two may differ by more: by 22 in world 20010 of ``study verdicts``, under the noise of one of
them."""


def free_count(fitted: Fitted) -> int:
    """Number of free parameters of a fit."""
    return len(fitted.model.values) - len(fitted.model.fixed)


def penalised_deviance(fitted: Fitted) -> float:
    """Deviance plus the penalty of the free parameters; effects are penalised where their number varies."""
    return fitted.deviance + PARAMETER_PENALTY * free_count(fitted)
