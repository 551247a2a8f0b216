"""Write a nested dict as TOML: the canonical form whose hash identifies a robot."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from frogkick.core.errors import InputError


def _scalar(value: object, where: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise InputError(f"{where} is {value}: only finite numbers can be written")
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=True)
    if isinstance(value, Sequence):
        return "[" + ", ".join(_scalar(item, where) for item in value) + "]"
    raise InputError(f"{where} is a {type(value).__name__}: TOML has no such value here")


def _is_table_array(value: object) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(v, Mapping) for v in value)


def _write(table: Mapping[str, Any], prefix: str, lines: list[str]) -> None:
    nested = {k: v for k, v in table.items() if isinstance(v, Mapping) or _is_table_array(v)}
    for key, value in table.items():
        if key not in nested:
            lines.append(f"{key} = {_scalar(value, prefix + key)}")
    for key, value in nested.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{prefix}{key}]"]
            _write(value, f"{prefix}{key}.", lines)
        else:
            for item in value:
                lines += ["", f"[[{prefix}{key}]]"]
                _write(item, f"{prefix}{key}.", lines)


def to_toml(table: Mapping[str, Any]) -> str:
    """Return ``table`` as TOML text, keys in their order, floats in their shortest exact form.

    Args:
        table: str -> scalar, list of scalars, dict, or list of dicts; keys are bare TOML keys.
    """
    lines: list[str] = []
    _write(table, "", lines)
    return "\n".join(lines).lstrip("\n") + "\n"
