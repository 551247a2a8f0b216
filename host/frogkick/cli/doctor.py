"""``frogkick doctor``: which tools are installed and work, and what to install for more."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import typer

from frogkick.cli.common import JsonOption, show

if TYPE_CHECKING:
    from frogkick.front.readiness import Finding


def _hint(finding: Finding) -> str:
    """Return what to do, unless the error itself says it."""
    return f" -> {finding.install}" if finding.install and finding.install not in finding.detail else ""


def doctor(json: JsonOption = False) -> None:
    """Check which tools this machine has. The exit code is 1 if the simulation loop cannot run here."""
    from frogkick.front.readiness import check_machine

    found = check_machine()
    values = found.as_json()
    lines = [f"frogkick {values['frogkick']}, Python {values['python']}, {values['cores']} cores"]
    for title, findings in (("needed", found.needed), ("for more", found.optional)):
        lines.append(f"{title}:")
        for finding in findings:
            mark = "ok     " if finding.works else "MISSING"
            lines.append(f"  {mark} {finding.name}: {finding.detail} ({finding.needed_for}){_hint(finding)}")
    lines.append("plugged in:")
    lines += [f"  {finding.name}: {finding.detail}" for finding in found.hardware]
    lines.append("ready for:")
    for stage in found.stages:
        lines.append(f"  {'ready    ' if stage.ready else 'NOT READY'} {stage.name}: {stage.begin}")
        lines += [
            f"            {finding.name}: {finding.detail}{_hint(finding)}"
            for finding in stage.findings
            if not finding.works
        ]
    show(values, json, "\n".join(lines))
    if not found.ready:
        print("frogkick: doctor found something missing", file=sys.stderr)
        raise typer.Exit(1)
