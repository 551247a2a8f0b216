"""Sample states, simulate actions, keep the transitions, quantise them to tables."""

from frogkick.library.build import BuildReport, build_library, simulate_transitions
from frogkick.library.error import table_error
from frogkick.library.quantise import quantise
from frogkick.library.sampling import SAMPLINGS, sample_velocities
from frogkick.library.store import Library, library_info, read_library, write_library

__all__ = [
    "SAMPLINGS",
    "BuildReport",
    "Library",
    "build_library",
    "library_info",
    "quantise",
    "read_library",
    "sample_velocities",
    "simulate_transitions",
    "table_error",
    "write_library",
]
