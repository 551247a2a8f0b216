"""The picture of a law: its field over the pool or its curve, beside the residuals of the nominal model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64
from frogkick.core.poses import world_from_body, wrap_angle
from frogkick.effects import Body, History, Law, Stroke
from frogkick.effects.law import CHANNELS
from frogkick.identification.outcome import Outcome
from frogkick.report import style
from frogkick.report.identify_figures import AXES, limb_panel
from frogkick.report.identify_residuals import Residuals, by_limb, pose_at

CELLS, FINE = 15, 60
"""Arrows and cells of a field along the pool's longer side."""
SPEED_MPS = 0.03
"""Resistance to motion is drawn for this speed."""
BESIDE_M = 0.06
RAW_LABEL, EXPLAINED_LABEL = "raw residual", "explained by the identified effects"
BOTH = (("raw", style.MEASURED, "o", RAW_LABEL), ("explained", style.PREDICTED, "x", EXPLAINED_LABEL))

_SCALED = {"N": (1e3, "mN"), "N m": (1e6, "uN m"), "m/s": (1e3, "mm/s"), "m": (1e3, "mm"), "1": (1.0, "1"),
           "s": (1.0, "s"), "rad": (57.29578, "deg")}  # fmt: skip
_LABELS = {
    "x_n": "force along x", "y_n": "force along y", "forward_n": "force forward", "left_n": "force left",
    "torque_nm": "torque", "x_mps": "flow along x", "y_mps": "flow along y", "gain": "share of the stroke",
    "delay_s": "delay", "duration_scale": "share of the duration", "x_m": "offset along x",
    "y_m": "offset along y", "heading_rad": "offset of the heading",
}  # fmt: skip
_UNITS = {key: unit for units in CHANNELS.values() for key, unit in units.items()}


def _seen(periods: Residuals, which: str, pool: bool) -> Float64:
    """(n, 3) residuals of the nominal model ("raw"), or their part that the effects explain ("explained").

    They are along the pool's axes (by the heading at the middle of the period) or the body's, and of the
    heading.
    """
    residuals = periods.residual_body("nominal") if which == "raw" else periods.explained
    return world_from_body(periods.middle[:, 2], residuals) if pool else residuals


DEPENDS: Mapping[str, tuple[str, str]] = {
    "chance": ("chance", "chance"), "x_m": ("place", "place"), "y_m": ("place", "place"),
    "time_s": ("time", "time"), "heading_rad": ("heading", "heading"), "forward_mps": ("speed", "speed"),
    "left_mps": ("speed", "speed"), "turn_radps": ("speed", "turning"),
    "strokes": ("time", "the number of strokes"),
}  # fmt: skip
"""Variable of a formula -> what runs must contain to show a law with it (a key of ``laws.NEEDS``), and the
variable in words. The first one in a law is what it mainly depends on."""


def depends_on(law: Law) -> str:
    """Return a key of NEEDS: the variable that a law mainly depends on."""
    main = next((name for name in DEPENDS if name in law.names), "")
    if main == "time_s" and "cycle" in law.names:
        return "time in cycles"
    if main:
        return DEPENDS[main][0]
    if "since_s" in law.names:
        return "rest"
    return "limbs" if law.on == "stroke" else "heading"


def law_figure(outcome: Outcome, law: Law, periods: Residuals) -> Figure:
    """Draw a law, and beside it the residuals with the part that the identified effects explain."""
    law.check(outcome.robot)
    place = depends_on(law) == "place"
    with style.new_figure(11.0, 4.4 if place else 4.0) as figure:
        if place:
            left, right = figure.subplots(1, 2)
            _field(figure, left, law, periods)
            _arrows(right, periods)
        elif depends_on(law) in ("limbs", "chance", "rest") and law.on == "stroke":
            left, *rest = figure.subplots(1, 3)
            _bars(left, law, outcome)
            of_limbs = [
                (shift, colour, legend, *by_limb(_seen(periods, which, False), periods.limbs))
                for (which, colour, _, legend), shift in zip(BOTH, (-0.12, 0.12), strict=True)
            ]
            for axes, axis in zip(rest, _explained_axes(periods, False), strict=True):
                limb_panel(axes, outcome.robot, axis, of_limbs, "Residuals by limb")
        else:
            left, *rest = figure.subplots(1, 3)
            name, values = _along(law, periods)
            _curve(left, law, name, values)
            pool = bool({"x_n", "y_n", "x_mps", "y_mps", "x_m", "y_m"} & set(law.formulas))
            for axes, axis in zip(rest, _explained_axes(periods, pool), strict=True):
                _dots(axes, periods, axis, name, values, pool)
        style.legend_below(figure, right if place else rest[0])
    return figure


def _explained_axes(periods: Residuals, pool: bool) -> list[int]:
    """The two axes of the residuals of which the identified effects explain the largest share."""
    raw, explained = ((_seen(periods, which, pool) ** 2).sum(axis=0) for which in ("raw", "explained"))
    share = explained / np.maximum(raw, 1e-30)
    return sorted(np.argsort(-share)[:2].tolist())


def _area(periods: Residuals) -> tuple[Float64, Float64]:
    places = periods.middle[:, :2]
    return places.min(axis=0) - BESIDE_M, places.max(axis=0) + BESIDE_M


def _field(figure: Figure, axes: Axes, law: Law, periods: Residuals) -> None:
    """Arrows of a force, a flow or an offset over the pool; colours of resistance or of strokes."""
    moves = bool(law.names & {"forward_mps", "left_mps", "turn_radps"})
    coloured = moves or law.on == "stroke" or not {"x_n", "x_mps", "x_m"} & set(law.formulas)
    low, high = _area(periods)
    step = float((high - low).max()) / (FINE if coloured else CELLS)
    x, y = np.meshgrid(*(np.arange(a + 0.5 * step, b, step) for a, b in zip(low, high, strict=True)))
    still = dict.fromkeys(("time_s", "heading_rad", "left_mps", "turn_radps", "strokes"), np.zeros_like(x))
    given = law.over({**still, "x_m": x, "y_m": y, "forward_mps": np.full_like(x, SPEED_MPS), "chance": 0.5})
    if coloured:
        key = next(iter(law.formulas))
        scale, unit = _SCALED[_UNITS[key]]
        shown = axes.pcolormesh(100.0 * x, 100.0 * y, scale * given[key], cmap="cividis", shading="nearest")
        beside = f" at {1e3 * SPEED_MPS:g} mm/s forward" if moves else ""
        figure.colorbar(shown, ax=axes, label=f"{_LABELS[key]}{beside} ({unit})", shrink=0.8)
        axes.grid(visible=False)
    else:
        first = next(key for key in ("x_n", "x_mps", "x_m") if key in law.formulas)
        other = "y" + first[1:]
        scale, unit = _SCALED[_UNITS[first]]
        along, aside = scale * given[first], scale * given.get(other, np.zeros_like(x))
        largest = max(float(np.hypot(along, aside).max()), 1e-12)
        step_cm = 100.0 * float(np.diff(x[0])[0]) if x.shape[1] > 1 else 1.0
        look = {**style.TO_SCALE, "scale": largest / step_cm, "color": style.PREDICTED, "width": 0.004}
        arrows = axes.quiver(100.0 * x, 100.0 * y, along, aside, **look)
        axes.quiverkey(arrows, 0.84, 1.04, largest, f"{largest:.3g} {unit}", labelpos="E")
    axes.plot(*(100.0 * periods.middle[:, :2].T), ".", color=style.DESIRED, markersize=2)
    style.pool_axes(axes)
    axes.set_title("The law over the pool; dots: where the runs were")


def _arrows(axes: Axes, periods: Residuals) -> None:
    """Residuals in the pool as arrows, raw and explained, at one scale."""
    reach = 100.0 * float(max(*(_area(periods)[1] - _area(periods)[0])))
    sizes = 100.0 * np.hypot(*_seen(periods, "raw", True)[:, :2].T)
    factor = style.round_factor(0.12 * reach / max(float(np.percentile(sizes, 90)), 1e-9))
    for (which, colour, _, label), width, above in zip(BOTH, (0.004, 0.002), (2, 3), strict=True):
        look = style.look(color=colour, width=width, zorder=above, label=label)
        arrows = 100.0 * factor * _seen(periods, which, True)[:, :2].T
        axes.quiver(*(100.0 * periods.middle[:, :2].T), *arrows, **style.TO_SCALE, **look)
    style.pool_axes(axes)
    axes.set_title(f"Residuals a period ahead, magnified {factor:g} times")


def _along(law: Law, periods: Residuals) -> tuple[str, Float64]:
    """The variable that a law's curve is drawn over, and its values in the periods."""
    main = depends_on(law)
    if main == "heading":
        return "heading_rad", np.asarray(wrap_angle(periods.middle[:, 2]))
    if main == "speed":
        for axis, name in enumerate(("forward_mps", "left_mps", "turn_radps")):
            if name in law.names:
                return name, periods.velocity[:, axis]
    return ("strokes" if "strokes" in law.names else "time_s"), periods.at_s


_VARIABLES = {
    "heading_rad": (57.29578, "heading (deg)"), "forward_mps": (1e3, "speed forward (mm/s)"),
    "left_mps": (1e3, "speed to the left (mm/s)"), "turn_radps": (57.29578, "turn rate (deg/s)"),
    "time_s": (1.0, "time in the run (s)"), "strokes": (1.0, "strokes before (1)"),
}  # fmt: skip


def _curve(axes: Axes, law: Law, name: str, values: Float64) -> None:
    """The law over one variable, with all others at 0."""
    low, high = (-np.pi, np.pi) if name == "heading_rad" else (float(values.min()), float(values.max()))
    low = 0.0 if name in ("time_s", "strokes") else low
    along = np.linspace(low, high, 400)
    names = ("time_s", "x_m", "y_m", "heading_rad", "forward_mps", "left_mps", "turn_radps", "strokes")
    rest = {other: np.zeros(len(along)) for other in names}
    factor, label = _VARIABLES[name]
    beside = ""
    if name != "forward_mps" and "forward_mps" in law.names:
        rest["forward_mps"] += SPEED_MPS
        beside = f" at {1e3 * SPEED_MPS:g} mm/s forward"
    given = law.over({**rest, "since_s": np.full(len(along), 1e3), "chance": 0.5, name: along})
    keys = [key for key in given if not (key == "left_n" and name == "forward_mps" and "forward_n" in given)]
    scale, unit = _SCALED[_UNITS[keys[0]]]
    styles = ("-", "--", ":", "-.")
    for key, line in zip(keys, styles, strict=False):
        shown = np.broadcast_to(scale * given[key], along.shape)
        axes.plot(factor * along, shown, line, color=style.PREDICTED, label=_LABELS[key])
    axes.set_xlabel(label)
    what = _LABELS[keys[0]] if len(keys) == 1 else _LABELS[keys[0]].split(" ")[0]
    axes.set(ylabel=f"{what}{beside} ({unit})", title="The law")
    if len(keys) > 1:
        axes.margins(y=0.25)
        axes.legend(loc="upper right", ncols=2)


def _dots(axes: Axes, periods: Residuals, axis: int, name: str, values: Float64, pool: bool) -> None:
    """Residuals of each period over the law's variable."""
    factor, label = _VARIABLES["time_s" if name == "strokes" else name]
    what, unit, scale = AXES[axis]
    what = ("along x", "along y", what)[axis] if pool else what
    for which, colour, marker, legend in BOTH:
        residuals = scale * _seen(periods, which, pool)[:, axis]
        axes.plot(factor * values, residuals, marker, color=colour, markersize=3.5, label=legend)
    axes.axhline(0.0, color=style.DESIRED, linewidth=0.8)
    axes.set(xlabel=label, ylabel=f"residual of a period ({unit})", title=f"Residuals: {what}")


def _bars(axes: Axes, law: Law, outcome: Outcome) -> None:
    """The gain of each limb's strokes by the law, averaged over the runs; lines: least and most."""
    gains: dict[str, list[float]] = {limb.name: [] for limb in outcome.robot.limbs}
    rng, names = np.random.default_rng(0), list(gains)
    for swim in (*outcome.train, *outcome.test):
        for k, (time_s, limb) in enumerate(swim.strokes):
            x, y, heading = pose_at(swim, np.array([time_s]))[0].tolist()
            stroke = Stroke(names[limb], limb, time_s, body=Body(time_s, (x, y, heading), (0.0, 0.0, 0.0)))
            given = law.stroke(stroke, History(list(swim.strokes[:k])), rng) or stroke
            gains[names[limb]].append(given.gain)
    for at, some in enumerate(gains.values()):
        if some:
            mean = float(np.mean(some))
            axes.bar(at, mean, 0.6, color=style.PREDICTED)
            axes.plot((at, at), (min(some), max(some)), color=style.FLOOR, linewidth=1.2)
    axes.set_xticks(range(len(names)), [name.replace("_", "\n") for name in names])
    axes.set(
        xlabel="limb", ylabel="share of the stroke (1)", title="The law: mean, least and most in the runs"
    )
