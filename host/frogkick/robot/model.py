"""The robot as frozen dataclasses, and its shape as lines and as a picture."""

from __future__ import annotations

import hashlib
import html
import math
import os
import string
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.files import file_to_write, write_text
from frogkick.robot.profile import Actuation, Profile, actuation
from frogkick.robot.schema import Battery, Frame, Guard, Limb, PlannerDefaults, VelocityBox
from frogkick.robot.toml_text import to_toml

STANDARD_GRAVITY_MPS2 = 9.80665

PERIOD_SAME = 0.02
"""Relative difference up to which a period counts as the robot's own."""


def outline_of(frame: Frame) -> Float64:
    """(corners + 1, 2) the frame as a closed line, m."""
    return np.array([*frame.corners_m, frame.corners_m[0]])


def limb_points(frame: Frame, limb: Limb, drop_per_m: float = 0.0) -> Float64:
    """(segments + 1, 2) nodes of a limb from root to tip, m, in the robot file's body coordinates.

    ``drop_per_m`` is the drop of its curvature by a stroke, 1/m.
    """
    curvature = limb.rest_curvature_per_m - math.copysign(drop_per_m, limb.rest_curvature_per_m)
    step = limb.length_m / limb.segments
    turn = 2.0 * math.atan(0.5 * curvature * step)  # between chords: curvature 2 tan(turn / 2) / step
    angle = limb.direction_rad + (np.arange(limb.segments) + 0.5) * turn
    chords = step * np.column_stack([np.cos(angle), np.sin(angle)])
    root = np.array([frame.corners_m[limb.corner]])
    return np.concatenate([root, root + np.cumsum(chords, axis=0)])


def svg_of(frame: Frame, limbs: tuple[Limb, ...]) -> str:
    """A robot at rest as an SVG picture from above, forward up, with the limbs' names."""
    lines = {limb.name: limb_points(frame, limb) for limb in limbs}
    outline = outline_of(frame)
    points = np.concatenate([outline, *lines.values()])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.12 * float((high - low).max())
    wide, tall = (float(size) + 2.0 * margin for size in (high - low)[::-1])

    def line(points: Float64) -> str:
        return " ".join(f"{high[1] + margin - y:.5f},{high[0] + margin - x:.5f}" for x, y in points)

    stroke = f"fill='none' stroke-width='{0.012 * wide:.5f}' stroke-linejoin='round'"
    drawn = [f"<polyline points='{line(outline)}' {stroke} stroke='#333'/>"]
    for name, points in lines.items():
        x, y = line(points[-1:]).split(",")
        drawn.append(f"<polyline points='{line(points)}' {stroke} stroke='#1f77b4'/>")
        drawn.append(
            f"<text x='{x}' y='{y}' font-size='{0.045 * wide:.5f}' text-anchor='middle'>"
            f"{html.escape(name)}</text>"
        )
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' width='320' viewBox='0 0 {wide:.5f} {tall:.5f}'>"
        f"{''.join(drawn)}</svg>"
    )


@dataclass(frozen=True)
class Action:
    """A stroke: the limbs of first_mask fire, those of second_mask one delay later (bit i = limb i)."""

    name: str
    first_mask: int
    second_mask: int


def in_a_row(names: Sequence[str]) -> str:
    """Names of actions in one text: letters side by side, words with spaces between them."""
    return ("" if all(len(name) == 1 for name in names) else " ").join(names)


@dataclass(frozen=True, eq=False)
class Loaded:
    """What a robot was loaded from.

    Attributes:
        text: the canonical text.
        write: gives the canonical text of a robot with other values.
        values: of the robot's attributes then.
    """

    text: str
    write: Callable[[Robot], str]
    values: dict[str, Any] = field(default_factory=dict)


@typed
@dataclass(frozen=True, repr=False)
class Robot:
    """A robot. Robots are equal if all attributes but ``folder`` are.

    Attributes:
        id: at most 15 ASCII characters, written into table images.
        title: one line for people.
        period_s: time from the start of one action to that of the next.
        pulse_s: heating time of one limb.
        second_delay_s: time from the first group of an action to the second.
        pulse_energy_j: electrical energy of one pulse on one limb; None: unknown.
        water_density_kg_per_m3: of the fluid, for drag.
        egain_percent, profile_frequency_hz: which of ``profiles`` the strokes of actions are taken from.
        gait_lead_mask, gait_lag_mask: the two groups of the cyclic gait; the second lags by the phase.
        velocity_resolution: velocity per code of a table image, (m/s, m/s, rad/s).
        integrator: key of frogkick.der.stepping.SCHEMES, the method of the time steps.
        drag_law: whether drag goes with the square of each component of the velocity, or with the speed.
        battery: of the limbs; None if its file has none.
        found_from: id of the robot from whose runs its effects were found; "" if they were not.
        effects: tables of its effects in its file (see frogkick.effects.effects_of).
        loaded: what it was loaded from.
        folder: folder of its own effects' files; None if the text has no folder.
    """

    id: str
    title: str
    period_s: float
    pulse_s: float
    second_delay_s: float
    pulse_energy_j: float | None
    water_density_kg_per_m3: float
    egain_percent: float
    profile_frequency_hz: float
    gait_lead_mask: int
    gait_lag_mask: int
    frame: Frame
    limbs: tuple[Limb, ...]
    actions: tuple[Action, ...]
    profiles: tuple[Profile, ...]
    velocity_resolution: tuple[float, float, float]
    library_box: VelocityBox
    guard: Guard
    planner: PlannerDefaults
    loaded: Loaded = field(compare=False)
    integrator: str = "generalised-alpha"
    drag_law: str = "component"
    battery: Battery | None = None
    found_from: str = ""
    effects: tuple[Mapping[str, Any], ...] = ()
    folder: Path | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if not self.loaded.values:  # of the first one; those that are made of it by replace share it
            self.loaded.values.update({at.name: getattr(self, at.name) for at in fields(self) if at.compare})

    @property
    def changed(self) -> tuple[str, ...]:
        """Names of the attributes that ``dataclasses.replace`` has changed since the robot was loaded."""
        return tuple(name for name, was in self.loaded.values.items() if getattr(self, name) != was)

    @cached_property
    def toml(self) -> str:
        """The canonical text, with values that were replaced; load_robot reads it back to the same robot.

        Raises:
            InputError: a replaced value is out of its range, or no file can hold it.
        """
        return self.loaded.write(self) if self.changed else self.loaded.text

    @cached_property
    def sha256(self) -> bytes:
        """Hash of that text, 32 bytes."""
        return hashlib.sha256(self.toml.encode("utf-8")).digest()

    def __repr__(self) -> str:
        return (
            f"Robot({self.id!r}: {len(self.limbs)} limbs, {len(self.actions)} actions, "
            f"period {self.period_s:g} s, {1e3 * self.mass_kg:.0f} g, {len(self.effects)} effects)"
        )

    def _repr_html_(self) -> str:
        picture = svg_of(self.frame, self.limbs)
        return f"<div><b>{html.escape(self.title)}</b><br>{html.escape(repr(self))}<br>{picture}</div>"

    def save(self, file: Path | str) -> None:
        """Write the TOML, with relative paths of the user's own effects.

        Raises:
            InputError: the file cannot be written, or an effect's file is unknown.
        """
        text, target = self.toml, file_to_write(file)
        if any("file" in table for table in self.effects):
            if self.folder is None:
                raise InputError(
                    f"robot {self.id!r} has an effect in a file whose folder is unknown: copy both"
                )
            table = tomllib.loads(text)
            for row in table["effect"]:
                if "file" in row:
                    row["file"] = os.path.relpath(self.folder / str(row["file"]), target.resolve().parent)
            text = to_toml(table)
        write_text(target, text)

    def swam(self, robot_id: str) -> bool:
        """Whether the runs of this id are the robot's."""
        return robot_id in (self.id, self.found_from)

    @property
    def mass_kg(self) -> float:
        """Mass of frame and limbs, kg, without the added mass of the water."""
        perimeter = 0.0
        for i, (x, y) in enumerate(self.frame.corners_m):
            x2, y2 = self.frame.corners_m[(i + 1) % len(self.frame.corners_m)]
            perimeter += ((x2 - x) ** 2 + (y2 - y) ** 2) ** 0.5
        limbs = sum(
            limb.length_m * limb.with_egain(self.egain_percent).mass_per_length_kg_per_m * limb.width_at(0.5)
            for limb in self.limbs
        )
        return perimeter * self.frame.mass_per_length_kg_per_m + limbs

    def cost_of_transport(self, pulses: float, time_s: float, speed_mps: float) -> float:
        """Mean electrical power over weight in air and speed, P / (m g v); ``pulses`` are those in a time.

        Infinite without forward motion; NaN if the energy of a pulse is not known.
        """
        if self.pulse_energy_j is None:
            return math.nan
        power_w = pulses * self.pulse_energy_j / time_s
        return power_w / (self.mass_kg * STANDARD_GRAVITY_MPS2 * speed_mps) if speed_mps > 0.0 else math.inf

    @property
    def cost_unknown(self) -> str:
        """Why costs of transport are unknown, and what to write; "" if they are not."""
        if self.pulse_energy_j is not None:
            return ""
        return (
            f"cost of transport unknown: write pulse_energy_j = J of one pulse on one limb in the file of "
            f"robot {self.id!r}"
        )

    @property
    def reach_m(self) -> float:
        """Bound of the distance of any part from the body origin, m: farthest corner plus longest limb."""
        corner_m: float = max((x * x + y * y) ** 0.5 for x, y in self.frame.corners_m)
        return corner_m + max(limb.length_m for limb in self.limbs)

    def actuation(self, egain_percent: float | None = None, frequency_hz: float | None = None) -> Actuation:
        """The stroke of a limb, by default that of the actions.

        Raises:
            InputError: outside of the measured profiles.
        """
        egain = self.egain_percent if egain_percent is None else egain_percent
        frequency = self.profile_frequency_hz if frequency_hz is None else frequency_hz
        return actuation(self.profiles, egain, frequency)

    def strokes(
        self,
        egain_percent: float | None = None,
        frequency_hz: float | None = None,
        shared: Actuation | None = None,
    ) -> tuple[Actuation, ...]:
        """The stroke of each limb, by default that of the actions; ``shared`` is that of limbs without own.

        Raises:
            InputError: outside of the measured profiles.
        """
        egain = self.egain_percent if egain_percent is None else egain_percent
        frequency = self.profile_frequency_hz if frequency_hz is None else frequency_hz
        known: dict[tuple[float, tuple[Profile, ...]], Actuation] = {}
        found = []
        for limb in self.limbs:
            key = egain if limb.egain_percent is None else limb.egain_percent, limb.profiles
            if key not in known and shared is not None and key == (egain, ()):
                known[key] = shared
            if key not in known:
                try:
                    known[key] = actuation(limb.profiles or self.profiles, key[0], frequency)
                except InputError as error:
                    where = f"limb {limb.name!r}: " if limb.profiles else ""
                    raise InputError(f"{where}{error}") from None
            found.append(known[key])
        return tuple(found)

    def at_period(self, period_s: float) -> Robot:
        """The robot with another period and the profile of its frequency; unchanged within ``PERIOD_SAME``.

        Raises:
            InputError: a period of zero, or a frequency outside of the measured profiles.
        """
        if period_s == 0.0:
            raise InputError("period_s is 0: give a time above 0")
        if abs(period_s / self.period_s - 1.0) <= PERIOD_SAME:
            return self
        self.strokes(frequency_hz=1.0 / period_s)
        period_s, frequency_hz = float(period_s), 1.0 / float(period_s)
        return replace(self, period_s=period_s, profile_frequency_hz=frequency_hz)

    @property
    def action_codes(self) -> tuple[str, ...]:
        """Characters of the actions in a table image: one-letter names, and free letters for words."""
        names = [action.name for action in self.actions]
        free = (letter for letter in string.ascii_uppercase + string.ascii_lowercase if letter not in names)
        return tuple(name if len(name) == 1 else next(free) for name in names)

    def action(self, name: str) -> Action:
        """The action of that name (case ignored).

        Raises:
            InputError: no such action.
        """
        for action in self.actions:
            if action.name.upper() == str(name).upper():
                return action
        known = ", ".join(action.name for action in self.actions)
        raise InputError(f"robot {self.id!r} has no action {name!r}: choose from {known}")
