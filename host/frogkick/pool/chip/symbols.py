"""What a firmware must not contain: helpers that a compiler or a library slips in."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Final

UNWANTED: Final[Mapping[str, re.Pattern[str]]] = {
    "64-bit division": re.compile(r"__aeabi_u?ldivmod|__u?(div|mod|divmod)[dt]i[34]|__divmod[dt]i4"),
    "double": re.compile(
        r"__aeabi_(d(add|sub|rsub|mul|div|neg|cmp\w*|2\w+)|cd\w+|u?[il]2d|f2d|h2d)"
        r"|__\w*df[23]|__(fix|fixuns|float|floatun|trunc|extend)\w*df\w*"
    ),
    "float arithmetic in software": re.compile(
        r"__aeabi_(f(add|sub|rsub|mul|div|neg|cmp\w*|2\w+)|cf\w+|u?[il]2f|h2f\w*|d2f)"
        r"|__\w*sf[23]|__(fix|fixuns|float|floatun|trunc|extend)\w*sf\w*"
    ),
    "libm": re.compile(
        r"_*(a?(sin|cos|tan)h?|atan2|sqrt|cbrt|exp[2m]?1?|log(2|10|1p)?|pow|hypot|fmod|remainder|fabs|floor|ceil"
        r"|round|l?lround|rint|l?lrint|nearbyint|trunc|ldexp|frexp|fma|fmin|fmax|copysign|sincos)[fl]?"
        r"|__(ieee754|kernel|rem_pio2)\w*"
    ),
    "heap": re.compile(r"_*(malloc|calloc|realloc|free|memalign|aligned_alloc|sbrk)(_r)?"),
}
"""What it is -> names of functions that show it: Arm's run-time ABI, libgcc, the C library."""


def unwanted(symbols: Iterable[str]) -> list[str]:
    """Return 'name: what it is' for each symbol that a firmware must not have."""
    found = []
    for symbol in sorted(set(symbols)):
        what = next(
            (what for what, pattern in UNWANTED.items() if pattern.fullmatch(symbol.split(".")[0])), ""
        )
        found += [f"{symbol}: {what}"] if what else []
    return found
