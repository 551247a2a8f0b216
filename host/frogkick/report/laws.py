"""Laws in a report: in words, as a formula, as a figure, and what runs must contain to show them."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.poses import world_from_body, wrap_angle
from frogkick.effects import Body, History, Law, Stroke
from frogkick.effects.law import CHANNELS
from frogkick.identification.outcome import Outcome
from frogkick.report import style
from frogkick.report.identify_figures import AXES, limb_panel
from frogkick.report.identify_residuals import Residuals, all_residuals, by_limb, pose_at
from frogkick.report.page import Section

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
"""Variable of a formula -> a key of NEEDS, and the variable in words. A law mainly depends on the first of
these that it contains."""


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


ACTS = 0.1
"""A law counts as acting in a period if it is more than this share of its largest value."""

_PLACE = "({at_x:.2f}, {at_y:.2f}) m"
_EVERY = "every {cycle:.2f} s, for {share:.0%} of that time"
SENTENCES: Mapping[str, str] = {
    "spring": f"A spring or cable pulls the robot to the point {_PLACE}, with {{stiffness:.3g}} N for each "
    "metre beyond {slack:.2f} m from it.",
    "attraction": f"The point {_PLACE} attracts the robot, more strongly the nearer it is, down to a "
    "distance of about {near:.2f} m.",
    "push beyond a line": "Beyond a line across the pool a force pushes the robot back, with "
    "{stiffness:.3g} N for each metre beyond it.",
    "push": "A steady force of {to_x:.3g} N along x and {to_y:.3g} N along y pushes the robot.",
    "patch": f"Around the point {_PLACE} the water resists more, by {{drag:.3g}} N s/m, up to a distance of "
    "about {size:.2f} m.",
    "patch with an end": f"Around the point {_PLACE} the water resists more, by {{drag:.3g}} N s/m in its "
    "middle, and less and less up to a distance of {size:.2f} m.",
    "drag beyond a line": "Beyond a line across the pool the water resists more, by {drag:.3g} N s/m.",
    "drag by speed": "The water resists in proportion to the speed, by {drag:.3g} N s/m.",
    "drag power": "The water resists with the power {power:.2g} of the speed: {forward_drag:.3g} N forward "
    "and {left_drag:.3g} N sideways at {speed:.2f} m/s.",
    "compass": "A torque turns the robot towards one heading, as a magnet does.",
    "gusts": "A force on the robot oscillates with a period of {cycle:.2f} s.",
    "push from a moment on": "From {at:.1f} s on a force of {to_x:.3g} N along x and {to_y:.3g} N along y "
    "pushes the robot.",
    "push by time": "A force that grows with time pushes the robot: each second adds {to_x:.3g} N along x "
    "and {to_y:.3g} N along y.",
    "drag from a moment on": "From {at:.1f} s on the water resists more, by {drag:.3g} N s/m.",
    "torque by speed": "A torque turns the robot in proportion to its speed.",
    "push at intervals": f"A force of {{to_x:.3g}} N along x and {{to_y:.3g}} N along y acts {_EVERY}.",
    "sloshing": "The water moves to and fro with a period of {cycle:.2f} s.",
    "flow that dies down": "The water flows at first and comes to rest: about a third of the flow is left "
    "after {fade:.1f} s.",
    "flow by time": "The water flows faster and faster: each second adds {to_x:.3g} m/s along x and "
    "{to_y:.3g} m/s along y.",
    "flow in a band": "The water flows in a band across the pool, with {to_x:.3g} m/s along x and "
    "{to_y:.3g} m/s along y in its middle.",
    "flow near a place": f"The water flows around the point {_PLACE}, with {{to_x:.3g}} m/s along x and "
    "{to_y:.3g} m/s along y there, up to a distance of about {size:.2f} m.",
    "flow from a moment on": "From {at:.1f} s on the water flows.",
    "flow at intervals": f"The water flows {_EVERY}.",
    "fixes off from a moment on": "From {at:.1f} s on the fixes have an offset.",
    "fixes off at intervals": f"The fixes have an offset {_EVERY}.",
    "fixes late from a moment on": "From {at:.1f} s on the fixes are {late:.3f} s older than stated.",
    "fixes late at intervals": f"The fixes are {{late:.3f}} s older than stated, {_EVERY}.",
    "misfire": "LIMB does nothing in {failing:.0%} of its strokes, at random.",
    "stroke from a moment on": "From {at:.1f} s on the strokes of LIMB are weaker by {loss:.0%}.",
    "stroke in rhythm": "The strokes of LIMB get weaker and stronger with a period of {cycle:.2f} s.",
    "stroke by time": "The strokes of LIMB get weaker with time, by {rate:.2%} a second.",
    "stroke by heading": "The strokes of LIMB depend on the robot's heading.",
    "stroke by place": "The strokes of LIMB depend on the robot's position in the pool.",
    "stroke by speed": "The strokes of LIMB depend on the robot's speed.",
    "stroke after a rest": "The strokes of LIMB are weaker by up to {loss:.0%} soon after the one before, "
    "and recover within about {fade:.1f} s.",
    "stroke tires": "The strokes of LIMB get weaker by up to {loss:.0%}, most of it within {fade:.0f} "
    "strokes.",
}  # fmt: skip
"""Title of a law -> its sentence; LIMB is the limb. Laws with other titles are described by what they act
on."""

WHAT: Mapping[str, str] = {
    "wrench": "A force on the body",
    "flow": "A flow of the water",
    "stroke": "A change of the strokes of LIMB",
    "fix": "An error of the fixes",
}
NEEDS: Mapping[str, str] = {
    "place": "runs that cross the place from several sides and also keep away from it; a spring needs ten "
    "periods with the cable taut",
    "time in cycles": "three to five of its cycles, and strokes that are not synchronous with them",
    "time": "five to ten periods on each side of the moment, or a long run if the change is slow",
    "heading": "headings all around, with the same actions at different headings",
    "speed": "slow and fast periods: starts from rest, turns, and straight stretches",
    "chance": "at least twenty strokes of the limb, or a hundred fixes",
    "rest": "strokes of the limb soon after each other, and others after long rests",
    "limbs": "periods in which the limbs fire together and periods in which each fires without the other. No "
    "action of the paper's robot fires a rear limb without a front one",
}
"""What a law depends on -> what runs must contain to show it."""


def sentence_of(law: Law) -> str:
    """Return a law in words, with its numbers."""
    limb = "all limbs" if law.limb == "all" else law.limb
    values = {p.name: law.value(p.name) for p in law.parameters}
    try:
        sentence = SENTENCES[law.title].format(**values)
    except KeyError:  # a user's law, under any title
        since = sorted(name for name in law.names if name.startswith("since_") and name != "since_s")
        others = [name.removeprefix("since_").removesuffix("_s") for name in since]
        on = {words for name, (_, words) in DEPENDS.items() if name in law.names}
        if others:
            on.add(f"how long ago {' and '.join(others)} fired")
        sentence = f"{WHAT[law.on]}" + (f" that depends on {' and '.join(sorted(on))}." if on else ".")
    return sentence.replace("LIMB", limb)


def formula_of(law: Law) -> list[str]:
    """Return each formula of a law with its numbers in it: ``x_n (N) = ...``."""
    numbers = {p.name: f"{law.value(p.name):.4g}" for p in law.parameters}
    values = {name: f"({text})" if text[0] == "-" else text for name, text in numbers.items()}
    lines = []
    for key, text in law.formulas.items():
        filled = re.sub(r"\b[A-Za-z_]\w*\b", lambda found: values.get(found[0], found[0]), text)
        lines.append(f"{key} ({CHANNELS[law.on][key]}) = {filled}")
    return lines


def laws_of(outcome: Outcome) -> list[tuple[str, Law]]:
    """Return the laws among the effects found, with their titles."""
    effects = [(term.title, term.effect()) for term in outcome.terms]
    return [(title, effect) for title, effect in effects if isinstance(effect, Law)]


def figure_of_law(outcome: Outcome, law: int) -> Figure:
    """Return the picture of one of the laws found.

    Raises:
        InputError: there is no law of that number.
    """
    laws = laws_of(outcome)
    if not 0 <= law < len(laws):
        raise InputError(f"law is {law}, but {len(laws)} were found, counted from 0: give a smaller number")
    return law_figure(outcome, laws[law][1], all_residuals(outcome))


def law_section(outcome: Outcome) -> Section:
    """Return the section; there must be a law."""
    periods = all_residuals(outcome)
    text, images = [], []
    for title, law in laws_of(outcome):
        formulas = "; ".join(formula_of(law))
        text.append(f"{title}: {sentence_of(law)} As a formula: {formulas}.")
        text.append(
            f"To show a law like this, runs must contain {NEEDS[depends_on(law)]}.{_contained(law, periods)}"
        )
        caption = (
            f"{title}. Left: the law. Right: the residual of each period of all runs, by the nominal model "
            "one period ahead, and the part of it that the identified effects explain."
        )
        images.append((law_figure(outcome, law, periods), caption))
    if outcome.law_test is not None:
        text.append(
            f"An experiment to confirm or refute a law: {outcome.law_test.text}. If the model predicts the "
            "new run as well as the noise of its fixes allows, the law is confirmed. If the model without "
            "the law predicts it better, the law is refuted."
        )
    return Section("Laws: effects that are formulas", text, images=images)


def _contained(law: Law, periods: Residuals) -> str:
    """Return how much these runs contain of what shows a law, if that can be counted."""
    x, y, heading = periods.middle.T
    forward, left, turn = periods.velocity.T
    own = {p.name for p in law.parameters}
    if "cycle" in own:
        return f" The longest of these runs contains {periods.at_s.max() / law.value('cycle'):.1f} cycles."
    if "at" in own:
        later = int((periods.at_s > law.value("at")).sum())
        earlier = len(periods.at_s) - later
        return f" These runs contain {earlier} periods before that moment and {later} after it."
    if law.on == "stroke" or law.by_chance:
        return ""
    given = law.over(
        {
            "time_s": periods.at_s, "x_m": x, "y_m": y, "heading_rad": heading, "forward_mps": forward,
            "left_mps": left, "turn_radps": turn,
        }
    )  # fmt: skip
    size = np.sqrt(sum(np.broadcast_to(values, x.shape) ** 2 for values in given.values()))
    acting = int((size > ACTS * size.max()).sum())
    return (
        f" In {acting} of the {len(x)} periods of these runs, the law is more than a tenth of its largest "
        "value in them."
    )
