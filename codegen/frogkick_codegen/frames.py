"""Makes the firmware's view of the link from its one layout: a C header and a table for the README.

Run ``python -m frogkick_codegen.frames`` after a change of ``frames.toml``; a test fails until it was run.
"""

from __future__ import annotations

from pathlib import Path

import jinja2

from frogkick.files import write_text
from frogkick.link.layout import Field, Payload, link_layout

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
HEADER = FIRMWARE / "core" / "fk_frames_layout.h"
README = FIRMWARE / "README.md"
_BEGIN, _END = "<!-- frames: made by python -m frogkick_codegen.frames -->", "<!-- frames end -->"


def layout_header() -> str:
    """The C header with ids, structures and their packing."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("frogkick_codegen"),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,
    )
    return environment.get_template("fk_frames_layout.h.jinja").render(layout=link_layout())


def _cell(fields: tuple[Field, ...]) -> str:
    return ", ".join(f"`{field.name}` {field.type}" for field in fields) or "-"


def _command_cell(payload: Payload) -> str:
    rows = f"; then up to {payload.repeat_max} x ({_cell(payload.repeat)})" if payload.repeat else ""
    return _cell(payload.fields) + rows


def layout_table() -> str:
    """The layout as a Markdown table."""
    lines = ["| id | frame | meaning | carries | answer |", "|---|---|---|---|---|"]
    for message in link_layout().messages.values():
        if message.command is not None and message.answer is not None:
            carries, answer = _command_cell(message.command), _cell(message.answer.fields)
        else:
            assert message.event is not None
            carries, answer = _cell(message.event.fields), "(event)"
        lines.append(f"| 0x{message.id:02x} | {message.name} | {message.doc} | {carries} | {answer} |")
    return "\n".join(lines)


def readme_with_table(text: str) -> str:
    """``text`` with the part between the markers replaced by today's table."""
    head, _, rest = text.partition(_BEGIN)
    _, _, tail = rest.partition(_END)
    return f"{head}{_BEGIN}\n{layout_table()}\n{_END}{tail}"


def main() -> None:
    """Write the header and the README's table."""
    write_text(HEADER, layout_header())
    write_text(README, readme_with_table(README.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
