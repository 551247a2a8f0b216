"""What the model with the identified effects still misses: a wrench, failed strokes, errors of fixes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from frogkick.identification.outcome import Outcome
from frogkick.report import style

GAP_S = 3.0
"""Gap between runs that are drawn one after the other."""


def missing_figure(outcome: Outcome) -> Figure | None:
    """Draw it over the time of the training runs; None if laws were not looked for."""
    missing = outcome.residuals
    if missing is None or missing["wrench"] is None:
        return None
    begins, at_s = {}, 0.0
    for swim in outcome.train:
        begins[swim.name] = at_s - float(swim.start_s[0])
        at_s += float(swim.end_s[-1] - swim.start_s[0]) + GAP_S

    def times(runs: list[str], time_s: list[float]) -> list[float]:
        return [begins[run] + time for run, time in zip(runs, time_s, strict=True)]

    wrench, strokes, fixes = missing["wrench"], missing["strokes"], missing["fixes"]
    spread = np.sqrt(np.array(wrench["covariance"])[:, [0, 4, 8]])
    middle = np.array(times(wrench["run"], wrench["time_s"]))
    runs = np.array(wrench["run"])
    with style.new_figure(11.0, 8.4) as figure:
        force, torque, fired, seen = figure.subplots(4, 1, sharex=True)
        rows = (
            (force, "forward_n", 0, 1e3, style.TRUE, "forward"),
            (force, "left_n", 1, 1e3, style.MEASURED, "left"),
            (torque, "torque_nm", 2, 1e6, style.TRUE, "torque"),
        )
        for axes, key, k, unit, colour, label in rows:
            values = unit * np.array(wrench[key])
            for name in dict.fromkeys(wrench["run"]):
                mine = runs == name
                band, shown = 2.0 * unit * spread[mine, k], values[mine]
                legend = label if name == wrench["run"][0] else None
                axes.plot(middle[mine], shown, color=colour, linewidth=1.0, label=legend)
                axes.fill_between(
                    middle[mine], shown - band, shown + band, color=colour, alpha=0.25, linewidth=0
                )
        force.set_ylabel("missing force (mN)")
        torque.set_ylabel("missing torque (µN m)")
        for limb in outcome.robot.limbs:
            mine_too = [each for each in strokes if each["limb"] == limb.name]
            fired.plot(
                times([each["run"] for each in mine_too], [each["time_s"] for each in mine_too]),
                [each["log_ratio"] for each in mine_too],
                ".",
                markersize=4,
                label=limb.name,
            )
        fired.axhline(0.0, color=style.FLOOR, linewidth=0.8)
        fired.set_ylabel("fired to not fired\n(log likelihood ratio)")
        at = times(fixes["run"], fixes["time_s"])
        for key, colour in (("x", style.TRUE), ("y", style.MEASURED), ("heading", style.ESTIMATED)):
            seen.plot(at, fixes[key], ".", markersize=2, color=colour, label=key)
        seen.set_ylabel("innovation (std. dev.)")
        seen.set_xlabel("time in the training runs, one after the other (s)")
        for axes in (force, fired, seen):
            axes.legend(loc="upper right", fontsize=7, ncols=4)
    return figure
