"""Makes C headers and the documentation's tables of the link, the supervisor and the planner's weights.

Run ``python -m frogkick_codegen.frames`` after a change of ``frames.toml``, ``supervisor.toml`` or
``core/weights.py``; a test fails until it was run.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

from frogkick.core.files import write_text
from frogkick.core.weights import COSTS, WEIGHTS
from frogkick.link.layout import Field, Payload, link_layout, supervisor
from frogkick_codegen.emit import filled
from frogkick_codegen.toolchain import firmware_sources

_FIRMWARE = firmware_sources()
HEADER = _FIRMWARE / "core" / "fk_frames_layout.h"
SUPERVISOR_HEADER = _FIRMWARE / "core" / "fk_supervisor_table.h"
PLANNER_HEADER = Path(__file__).parent / "planner" / "fk_planner.h"


def layout_header() -> str:
    return filled("fk_frames_layout.h", layout=link_layout())


def supervisor_header() -> str:
    return filled("fk_supervisor_table.h", table=supervisor(), layout=link_layout())


def _cell(fields: tuple[Field, ...]) -> str:
    return ", ".join(f"`{field.name}` {field.type}" for field in fields) or "-"


def layout_table() -> str:
    """The frames as a Markdown table."""
    lines = ["| type | frame | meaning | needs a code |", "|---|---|---|---|"]
    for message in link_layout().messages.values():
        kind = "event: " if message.event is not None else ""
        code = "yes" if message.needs_code else ""
        lines.append(f"| 0x{message.id:02x} | {message.name} | {kind}{message.doc} | {code} |")
    return "\n".join(lines)


def field_tables() -> Iterator[str]:
    """A Markdown table for each frame: the fields of its payloads, in the order on the wire."""
    for message in link_layout().messages.values():
        lines = ["| payload | field | type | unit | meaning |", "|---|---|---|---|---|"]
        for part in ("command", "answer", "event"):
            payload: Payload | None = getattr(message, part)
            if payload is not None:
                lines += _field_rows(part, payload.fields)
                lines += _field_rows(f"{part}, then up to {payload.repeat_max} times", payload.repeat)
        yield f"### {message.name}\n\n" + "\n".join(lines)


def _field_rows(part: str, fields: tuple[Field, ...]) -> list[str]:
    return [f"| {part} | `{field.name}` | {field.type} | {field.unit} | {field.doc} |" for field in fields]


def number_tables() -> Iterator[str]:
    """A Markdown table for each field whose numbers have names: status, state, fault and others."""
    text = resources.files("frogkick.link").joinpath("frames.toml").read_text(encoding="utf-8")
    for name, about, body in re.findall(r"^\[(\w+)\] +# (.*)\n((?:\w+ = -?\d.*\n|#.*\n)+)", text, re.M):
        rows = re.findall(r"^(\w+) = (-?\d+)(?: +# (.*))?$", body, re.M)
        lines = ["| number | name | meaning |", "|---|---|---|"]
        lines += [f"| {number} | {word} | {meaning} |" for word, number, meaning in rows]
        yield f"### `{name}`\n\n{about[0].upper()}{about[1:]}.\n\n" + "\n".join(lines)


def records_table() -> str:
    """The log's records as a Markdown table."""
    lines = ["| id | record | meaning | content |", "|---|---|---|---|"]
    for record in link_layout().records.values():
        rest = f"; then {record.rest}" if record.rest else ""
        lines.append(f"| {record.id} | {record.name} | {record.doc} | {_cell(record.payload.fields)}{rest} |")
    return "\n".join(lines)


def supervisor_table() -> str:
    """The supervisor's rules as a Markdown table: next state, then what is done, then a refusal's status."""
    table, states = supervisor(), link_layout().state
    lines = ["| event | " + " | ".join(states) + " |", "|---" * (1 + len(states)) + "|"]
    for event in table.docs:
        cells = []
        for state in states:
            rule = table.rules[event, state]
            parts = [rule.next_state if rule.next_state != state else ""]
            parts += [rule.action if rule.action != "NONE" else ""]
            parts += [f"refused: {rule.status}" if rule.status != "OK" else ""]
            cells.append(", ".join(part for part in parts if part) or "-")
        lines.append(f"| {event} | " + " | ".join(cells) + " |")
    lines += ["", *(f"- {event}: {doc}." for event, doc in table.docs.items() if doc != "command")]
    lines += [f"- {action}: {doc}." for action, doc in table.actions.items() if doc != "-"]
    return "\n".join(lines)


def plan_weights() -> str:
    """The planner's costs and weights in C: a list to go through, and how ``fk_plan_config_t`` begins."""
    lines = ["/* The cost of a motion. The numbers are part of the link's protocol. */", "typedef enum {"]
    for number, (cost, about) in enumerate(COSTS.items()):
        lines.append(f"    FK_COST_{cost.upper()} = {number}, /* {about} */")
    lines += [f"    FK_COST_LAST = {len(COSTS) - 1} /* the highest number */", "} fk_cost_t;", ""]
    limits = {name: f"{weight.least:.1f}f, {weight.most:.1f}f" for name, weight in WEIGHTS.items()}
    rows = [f"    WEIGHT({name}, {name.upper()}, {limits[name]})" for name in WEIGHTS]
    lines += [
        "/* Weights, lengths, places of the costs: WEIGHT(name, NAME, least 0 or -largest, largest). */"
    ]
    lines += [" \\\n".join(["#define FK_PLAN_WEIGHTS(WEIGHT)", *rows]), ""]
    lines += ["/* What to plan for. Weights of the other cost are only checked. */", "typedef struct {"]
    for name, weight in WEIGHTS.items():
        begin = f"    float {name + ';':{max(map(len, WEIGHTS)) + 1}} /* "
        words = textwrap.wrap(f"{weight.meaning} */", 118 - len(begin))
        lines.append(begin + f"\n{' ' * (len(begin) - 2)}* ".join(words))
    return "\n".join(lines)


def planner_header(text: str) -> str:
    """``text`` of fk_planner.h with today's costs and weights."""
    begin, end = "/* costs: made by python -m frogkick_codegen.frames */", "/* costs end */"
    head, _, rest = text.partition(begin)
    return f"{head}{begin}\n{plan_weights()}\n{end}{rest.partition(end)[2]}"


def main() -> None:
    write_text(HEADER, layout_header())
    write_text(SUPERVISOR_HEADER, supervisor_header())
    write_text(PLANNER_HEADER, planner_header(PLANNER_HEADER.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
