"""The supervisor's state table, read from ``supervisor.toml``: the effect of each event in each state."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources

from frogkick.link.layout import link_layout


@dataclass(frozen=True)
class Rule:
    """A cell of the table: next state, action and status of the answer, by name."""

    next_state: str
    action: str
    status: str


@dataclass(frozen=True)
class Supervisor:
    """The state table.

    Attributes:
        actions: name -> description, in the order of their numbers.
        docs: event -> description: commands, then others, in the order of their numbers.
        rules: cell of each event and state.
    """

    actions: dict[str, str]
    docs: dict[str, str]
    rules: dict[tuple[str, str], Rule]

    def number(self, event: str) -> int:
        """Number of an event; a command's is its frame's id."""
        return 1 + list(self.docs).index(event)


@cache
def supervisor() -> Supervisor:
    """The table of ``supervisor.toml``, read once."""
    text = resources.files("frogkick.link").joinpath("supervisor.toml").read_text(encoding="utf-8")
    raw = tomllib.loads(text)
    layout = link_layout()
    docs = {name: cells["doc"] for name, cells in raw["event"].items()}
    rules = {
        (name, state): Rule(*cells[state]) for name, cells in raw["event"].items() for state in layout.state
    }
    commands = [(message.id, name) for name, message in layout.messages.items() if message.command]
    assert commands == [(1 + place, name) for place, name in enumerate(list(docs)[: len(commands)])]
    for rule in rules.values():
        assert rule.next_state in layout.state and rule.action in raw["action"]
        assert rule.status in layout.status
    return Supervisor(raw["action"], docs, rules)
