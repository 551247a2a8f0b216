"""Sample states, simulate actions, keep the transitions, quantise them to tables.

Functions raise InputError for what they are given and cannot use, and ConvergenceError where the rods fail.
"""

from frogkick.library.build import (
    RECORD_S,
    build_library,
    checkpoint_folder,
    sample_library,
    truncate_library,
)
from frogkick.library.fitting import BUDGET_BYTES, KINDS, FittedTable, default_table, error_on, fit_table
from frogkick.library.sampling import SAMPLINGS, sample_starts
from frogkick.library.store import (
    Library,
    Recorded,
    library_info,
    quantise,
    read_library,
    read_recorded,
    write_library,
)
from frogkick.library.transitions import Failed

__all__ = [
    "BUDGET_BYTES", "KINDS", "RECORD_S", "SAMPLINGS", "Failed", "FittedTable", "Library", "Recorded",
    "build_library", "checkpoint_folder", "default_table", "error_on", "fit_table", "library_info",
    "quantise", "read_library", "read_recorded", "sample_library", "sample_starts", "truncate_library",
    "write_library",
]  # fmt: skip
