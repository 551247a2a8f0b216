"""The pages of the documentation that are made from the code while it is built (a hook of mkdocs).

A page in ``pages`` may hold lines such as ``{{ commands }}``: the function of that name below writes what
stands there. Pictures of ``host/pictures`` are beside the pages, under ``pictures/``.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pydantic import BaseModel

import frogkick
from frogkick.cli.app import SECTIONS
from frogkick.cli.main import run_command
from frogkick.effects import BUILT_IN, law
from frogkick.robot.schema import ABOUT, RobotFile, table_in
from frogkick.runs import runlog
from frogkick.tables import layout
from frogkick_codegen import frames

HOST = Path(__file__).parents[1]
IN_DETAIL = {"effects": ("Effect", "Parameter", "parameter", "read_world")}
"""What the Python reference has of a module that is a name of the front door; else all of it."""
GAP = re.compile(r"^\{\{ (\w+) \}\}$", re.MULTILINE)


def _help(words: list[str]) -> str:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        if run_command([*words, "--help"]) != 0:
            raise RuntimeError(f"frogkick {' '.join(words)} --help failed")
    return printed.getvalue().rstrip()


def commands() -> Iterator[str]:
    """Every command's own help, in the order of ``frogkick --help``."""
    os.environ["COLUMNS"] = "100"
    for section, listed_there in SECTIONS.items():
        yield f"## {section}"
        for name, (_, line) in listed_there.items():
            text = _help([name])
            yield f"### frogkick {name}\n\n{line}\n\n```text\n{text}\n```"
            if "COMMAND" in text.splitlines()[0]:
                listed = text.split("Commands:\n", 1)[1]
                for inner in re.findall(r"^  ([a-z][\w-]*)  ", listed, re.MULTILINE):
                    yield f"#### frogkick {name} {inner}\n\n```text\n{_help([name, inner])}\n```"


def python() -> Iterator[str]:
    """A directive of mkdocstrings for every name of the front door, in its order."""
    for name in frogkick.__all__:
        found = getattr(frogkick, name)
        module = getattr(found, "__module__", None)
        if module is not None:
            yield f"::: {module}.{found.__qualname__}"
        elif name != "__version__":
            yield f"### {name}\n\n{(found.__doc__ or '').strip()}"
            for each in IN_DETAIL.get(name, found.__all__):
                inner = getattr(found, each)
                if each not in frogkick.__all__ and hasattr(inner, "__qualname__"):
                    yield f"::: {inner.__module__}.{inner.__qualname__}\n    options: {{heading_level: 4}}"


def effects() -> Iterator[str]:
    """Each effect: what it is, its parameters, and what could show it."""
    for name, kind in BUILT_IN.items():
        yield f"## {name}\n\n`fk.effects.{kind.__name__}`: {kind.about}."
        if kind.options:
            given = (
                f"`{key}`" + ("" if default is None else f" (default `{default}`)")
                for key, default in kind.options.items()
            )
            yield f"Other keys: {', '.join(given)}."
        rows = [
            f"| `{p.name}` | {p.unit} | {p.low:g} to {p.high:g} | {p.nominal:g} | {p.about} |"
            for p in kind.parameters
        ]
        if rows:
            yield "\n".join(
                ["| parameter | unit | range | nominal | meaning |", "|---|---|---|---|---|", *rows]
            )
        yield f"Data that could show it: {kind.shown_by}."


def law_channels() -> Iterator[str]:
    """What a law's formulas give, and the names that they may use."""

    def named(units: Mapping[str, str]) -> str:
        return ", ".join(f"`{name}` ({unit})" for name, unit in units.items())

    rows = [f"| `{on}` | {named(law.CHANNELS[on])} | {named(law.NAMES[on])} |" for on in law.CHANNELS]
    yield "\n".join(
        ["| `on` | keys that may hold a formula | names that it may use |", "|---|---|---|", *rows]
    )


def _schema_rows(model: type[BaseModel], table: str) -> Iterator[str]:
    definition = model.model_json_schema()
    parts: Mapping[str, Any] = definition.get("$defs", {})
    for key, field in definition["properties"].items():
        inner = [part for part in parts if part in str(field)]
        if (table or not inner) and key != "effect":
            default = "required" if key in definition.get("required", []) else f"`{field.get('default')}`"
            about = ABOUT[f"{table}.{key}" if table else key]
            yield f"| `{key}` | {_allowed(field)} | {default} | {about} |"


def _allowed(field: Mapping[str, Any]) -> str:
    field = next(iter(field.get("anyOf", ())), field)  # of a key whose default is none
    if "enum" in field:
        return " or ".join(f"`{value}`" for value in field["enum"])
    kind = {"number": "number", "integer": "whole number", "string": "text", "array": "list"}[field["type"]]
    signs = {
        "exclusiveMinimum": "above",
        "minimum": "at least",
        "maximum": "at most",
        "maxLength": "length at most",
    }
    limits = [f"{word} {field[sign]:g}" for sign, word in signs.items() if sign in field]
    limits += [
        f"{field[each]} entries {word}"
        for each, word in (("minItems", "at least"), ("maxItems", "at most"))
        if each in field
    ]
    return ", ".join([kind, *limits])


def robot_keys() -> Iterator[str]:
    """Each table of a robot's file and its keys, from the schema that checks them."""
    head = "| key | allowed | default | meaning, with unit |\n|---|---|---|---|\n"
    yield "### Top level\n\n" + head + "\n".join(_schema_rows(RobotFile, ""))
    for key, field in RobotFile.model_fields.items():
        kind = table_in(field)
        if kind is not None:
            title = f"[[{key}]]" if "list" in str(field.annotation) else f"[{key}]"
            yield f"### `{title}`\n\n" + head + "\n".join(_schema_rows(kind, key))


def _attributes(kind: type) -> dict[str, str]:
    """What the docstring of a class says of each of its attributes, without the shape."""
    text_of = re.split(r"^ +Attributes:\n", kind.__doc__ or "", flags=re.MULTILINE)[-1]
    meanings = {}
    for names, text in re.findall(r"^ {8}(\w[\w, ]*): (.*(?:\n {12}.*)*)", text_of, re.MULTILINE):
        about = re.sub(r"^\([^)]*\) ", "", " ".join(text.split()))
        meanings.update(dict.fromkeys(names.split(", "), about.removesuffix(".")))
    return meanings


def run_columns() -> Iterator[str]:
    """The groups of a run's log, their columns, and their flags."""
    for group in (runlog.Fixes, runlog.Decisions, runlog.Strokes, runlog.Truth):
        meanings = _attributes(group)
        rows = [
            f"| `{name}` | {column.unit} | `{column.dtype}` | {column.width or 1} | {meanings[name]} |"
            for name, column in group.columns().items()
        ]
        head = "| dataset | unit | type | numbers in a row | meaning |\n|---|---|---|---|---|\n"
        yield f"### `{group.NAME}`\n\n" + head + "\n".join(rows)
    source = Path(runlog.__file__).read_text(encoding="utf-8")
    for name, flag in (("fixes", runlog.FixFlag), ("decisions", runlog.DecisionFlag)):
        rows = []
        for bit in flag:
            said = re.search(rf"^    {bit.name} = {int(bit)}  # (.*)$", source, re.MULTILINE)
            rows.append(f"| {int(bit)} | {bit.name} | {said[1] if said else ''} |")
        yield f"### Bits of `{name}/flags`\n\n| bit | name | meaning |\n|---|---|---|\n" + "\n".join(rows)


def image_layout() -> Iterator[str]:
    """The description of the table image that stands above its code."""
    text = (layout.__doc__ or "").split("\n", 2)[2]
    before, _, table, after = re.split(r"^=+ =+ =+\n", text, flags=re.MULTILINE)
    rows = [
        f"| {line[:7].strip()} | `{line[7:20].strip()}` | {line[20:].strip()} |"
        for line in table.splitlines()
    ]
    yield before.strip()
    yield "\n".join(["| offset | type | meaning |", "|---|---|---|", *rows])
    parts = after.strip().split("``")  # every other one is code
    yield "".join(f"`{part}`" if k % 2 else re.sub(r"([][*])", r"\\\1", part) for k, part in enumerate(parts))


def link_frames() -> Iterator[str]:
    """The link's commands and events, then the fields of each."""
    yield frames.layout_table()
    yield from frames.field_tables()


def link_numbers() -> Iterator[str]:
    """The named numbers of fields."""
    yield from frames.number_tables()


def log_records() -> Iterator[str]:
    """The records of the log in the robot's RAM."""
    yield frames.records_table()


def supervisor() -> Iterator[str]:
    """What each event does in each state."""
    yield frames.supervisor_table()


PARTS: Mapping[str, Callable[[], Iterator[str]]] = {
    part.__name__: part
    for part in (
        commands, python, effects, law_channels, robot_keys, run_columns, image_layout, link_frames,
        link_numbers, log_records, supervisor,
    )
}  # fmt: skip


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Put the pictures beside the pages."""
    for picture in sorted((HOST / "pictures").iterdir()):
        files.append(File.generated(config, f"pictures/{picture.name}", abs_src_path=str(picture)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Fill the gaps of a page."""
    return GAP.sub(lambda gap: "\n\n".join(PARTS[gap[1]]()), markdown)
