"""Importer of the paper's recorded closed-loop runs (Huang 2022)."""

from frogkick.loop.recorded.importer import import_recorded, load_run, read_recorded, summarise

__all__ = ["import_recorded", "load_run", "read_recorded", "summarise"]
