"""Turns a table image into C that stands on its own, and builds it."""
