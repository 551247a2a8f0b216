"""Verdicts on planted effects, kind by kind."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick_studies.verdicts import Case, Result


def verdicts_figure(results: Mapping[Case, Result]) -> Figure:
    """Left: share of right verdicts for each kind. Right: errors over the noise floor, before and after."""
    names = list(dict.fromkeys(case.kind for case in results))
    place = np.arange(len(names))[::-1]
    with style.styled():
        figure = Figure(figsize=(11.0, 2.2 + 0.28 * len(names)), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for at, name in zip(place, names, strict=True):
            some = [result for case, result in results.items() if case.kind == name]
            share = 100.0 * float(np.mean([result.right for result in some]))
            wrong = 100.0 * float(np.mean([result.wrong for result in some]))
            left.barh(at, share, 0.7, color=style.TRUE, label="right" if at == place[0] else None)
            left.barh(at, wrong, 0.3, color=style.ALARM, label="wrongly found" if at == place[0] else None)
            left.text(2.0, at, str(len(some)), va="center", color="white", fontsize=7)
            for errors, colour, label in (
                ("before", style.DESIRED, "nominal"),
                ("after", style.TRUE, "with what was found"),
            ):
                over = [getattr(result, errors)[0] / result.floor[0] for result in some]
                right.plot(
                    over,
                    np.full(len(over), at),
                    "|",
                    color=colour,
                    markersize=9,
                    label=label if at == place[0] else None,
                )
        left.axvline(95.0, color=style.DESIRED, linestyle="--", linewidth=0.8)
        left.set_xlim(0.0, 100.0)
        left.set_yticks(place, names)
        left.set_xlabel("of the cases, % (white: how many)")
        left.set_title("Verdicts")
        left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.6 / figure.get_figheight()), ncols=2)
        right.axvline(1.0, color=style.ALARM, linestyle="--", linewidth=0.8)
        right.set_xscale("log")
        right.set_xlabel("position missed a period ahead, over the noise floor (test runs)")
        right.set_title("Errors before and after")
        right.set_xlim(0.5, None)
        right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.6 / figure.get_figheight()), ncols=2)
    return figure
