"""Importer of the paper's recorded closed-loop runs (Huang 2022)."""

from frogkick.runs.recorded.importer import (
    clock_problem,
    import_recorded,
    load_run,
    read_recorded,
    summarise,
)

__all__ = ["clock_problem", "import_recorded", "load_run", "read_recorded", "summarise"]
