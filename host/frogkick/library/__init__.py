"""Sample states, simulate actions, keep the transitions, quantise them to tables."""

from frogkick.library.build import RECORD_S, BuildReport, build_library
from frogkick.library.cut import cut_library
from frogkick.library.error import table_error
from frogkick.library.quantise import quantise
from frogkick.library.sampling import SAMPLINGS, sample_velocities
from frogkick.library.store import (
    Library,
    Recorded,
    library_info,
    read_library,
    read_recorded,
    write_library,
)
from frogkick.library.transitions import Failed, simulate_transitions

__all__ = [
    "RECORD_S",
    "SAMPLINGS",
    "BuildReport",
    "Failed",
    "Library",
    "Recorded",
    "build_library",
    "cut_library",
    "library_info",
    "quantise",
    "read_library",
    "read_recorded",
    "sample_velocities",
    "simulate_transitions",
    "table_error",
    "write_library",
]
