"""Figures and self-contained HTML pages, in one style."""

import os
import sys
from contextlib import suppress
from pathlib import Path

from frogkick.core.files import cache_folder, problem_with

# Before matplotlib is loaded: without a home it would complain in several lines, and look at all fonts again.
if "MPLCONFIGDIR" not in os.environ:
    _home = Path(os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config"))
    if problem_with(_home / "matplotlib"):
        os.environ["MPLCONFIGDIR"] = str(cache_folder("matplotlib"))

# matplotlib cannot be loaded where MPLBACKEND names a backend that it does not know. No figure needs one.
if "matplotlib" not in sys.modules and (_backend := os.environ.pop("MPLBACKEND", "")):
    import matplotlib

    os.environ["MPLBACKEND"] = _backend
    with suppress(ValueError):
        matplotlib.rcParams["backend"] = _backend
