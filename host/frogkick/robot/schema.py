"""The parts of a robot, and its file as it is written: each key with its type, its range and its meaning.

The pydantic models of a file's tables are made from the parts and are used only where a file enters. Checks,
new robots' files and the documentation follow from them.
"""

from __future__ import annotations

import types
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from inspect import isclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, create_model, field_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError, PydanticUndefined

from frogkick.core.weights import COSTS, WEIGHTS, Weight, Weights
from frogkick.robot.profile import Profile

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Pair = tuple[float, float]
ID_MAX = 15
ACTION_NAME_MAX = 20
ACTIONS_MAX = 32
"""As many as a table image has room for."""

LIMBS_MAX = 8
"""As many as a mask of limbs has bits."""

ActionName = Annotated[str, Field(max_length=ACTION_NAME_MAX, pattern=r"^[A-Za-z][A-Za-z0-9_\-]*$")]
Name = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_\-]+$")]


def key(about: str, default: Any = PydanticUndefined, **limits: Any) -> Any:
    """Declare a key: its meaning with unit, its default if it may be left out, and its limits."""
    return Field(default, description=about, **limits)


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=False)

    @field_validator("*", mode="before")
    @classmethod
    def _not_true_or_false(cls, value: Any) -> Any:
        """Refuse what pydantic takes for the numbers 1 and 0; no key is a truth value."""
        if any(isinstance(one, bool) for one in (value if isinstance(value, list) else [value])):
            raise PydanticCustomError("bool", "input should not be true or false")
        return value


class WaterTable(_Table):
    density_kg_per_m3: Positive = key("kg/m^3")


@dataclass(frozen=True)
class Frame:
    """The stiff body: a closed polygon of rods, corners counter-clockwise in the body frame."""

    corners_m: Annotated[tuple[Pair, ...], key(
        "m, x forward, y left, counter-clockwise; the origin is anywhere", min_length=3, max_length=64
    )]  # fmt: skip
    segments: Annotated[
        tuple[Annotated[int, Field(ge=1, le=500)], ...],
        key("pieces of each edge; edge i runs from corner i to corner i + 1"),
    ]
    mass_per_length_kg_per_m: Annotated[Positive, key("kg for each m of the outline")]
    added_mass_per_length_kg_per_m: Annotated[NotNegative, key("kg of water that moves with each m of it")]
    stretching_stiffness_n: Annotated[Positive, key("N, Young's modulus times section")]
    bending_stiffness_n_m2: Annotated[Positive, key("N m^2, Young's modulus times second moment of area")]
    drag_width_m: Annotated[NotNegative, key("m across the flow, the depth of the frame in water")]
    drag_normal: Annotated[NotNegative, key("drag coefficient across an edge")]
    drag_tangential: Annotated[NotNegative, key("drag coefficient along it")]
    centre_mass_share: Annotated[float, key(
        "share of that mass that sits at the centre of the corners, 0 to 0.95", ge=0.0, le=0.95
    )] = 0.0  # fmt: skip
    centre_mass_at_m: Pair = (0.0, 0.0)  # of that share, from the centre of the corners; set by effects only


@dataclass(frozen=True)
class Limb:
    """An actuated rod, rooted at a corner of the frame. The order of limbs is the bit order of limb masks."""

    name: Annotated[Name, key("letters, digits, - or _")]
    corner: Annotated[int, key("where it begins, counted from 0 in frame.corners_m", ge=0)]
    clamp: Annotated[Literal["previous", "next"], key(
        "the edge at that corner that its root bends against: previous or next"
    )]  # fmt: skip
    direction_rad: Annotated[float, key(
        "degrees from forward, counter-clockwise, of its tangent at the root", ge=-360.0, le=360.0
    )]  # fmt: skip
    length_m: Annotated[Positive, key("m along the limb")]
    segments: Annotated[int, key("pieces", ge=2, le=500)]
    rest_curvature_per_m: Annotated[
        float, key("1/m at rest, positive where it curls counter-clockwise towards its tip")
    ]
    modulus_rest_pa: Annotated[Positive, key("Pa, Young's modulus at rest")]  # at activation 0
    modulus_active_pa: Annotated[Positive, key("Pa, while it is straightest")]  # at 1; linear in between
    second_moment_m4: Annotated[Positive, key("m^4, second moment of area")]
    section_m2: Annotated[Positive, key("m^2")]
    root_stiffness_ratio: Annotated[Positive, key("how much stiffer the clamp is than the limb")]
    mass_per_length_kg_per_m: Annotated[Positive, key("kg for each m")]
    added_mass_per_length_kg_per_m: Annotated[NotNegative, key("kg of water that moves with each m of it")]
    drag_width_m: Annotated[NotNegative, key("m across the flow")]
    drag_normal: Annotated[NotNegative, key("drag coefficient across the limb")]
    drag_tangential: Annotated[NotNegative, key("drag coefficient along it")]
    egain_mass_ratio: Annotated[NotNegative, key(
        "mass for each m that a limb of EGaIn alone would have more, over mass_per_length_kg_per_m"
    )] = 0.0  # fmt: skip
    tip_width_ratio: Annotated[float, key(
        "width at the tip over that at the root: drag and mass go with it, added mass with its square",
        gt=0.0, le=10.0,
    )] = 1.0  # fmt: skip
    tip_stiffness_ratio: Annotated[float, key(
        "bending stiffness at the tip over that at the root, linear in between", gt=0.0, le=10.0
    )] = 1.0  # fmt: skip
    egain_percent: Annotated[float | None, key(
        "the alloy of this limb, as in its [[profile]]; without it that of the robot", ge=0.0, le=100.0
    )] = None  # fmt: skip
    profiles: tuple[Profile, ...] = ()  # its own; without any, those of the robot
    # set by effects only: water that moves with it across but not along it, and the share of its momentum
    # that the tip leaves behind; see frogkick.der.plates
    plate_mass_per_length_kg_per_m: float = 0.0
    tip_shedding: float = 0.0

    def width_at(self, share: float) -> float:
        """The width at a share of the length from the root, over that at the root."""
        return 1.0 + (self.tip_width_ratio - 1.0) * share

    def with_egain(self, percent: float) -> Limb:
        """The limb with the mass that EGaIn gives it: its own per cent by volume, or else this."""
        if self.egain_mass_ratio == 0.0:
            return self
        percent = percent if self.egain_percent is None else self.egain_percent
        mass = self.mass_per_length_kg_per_m * (1.0 + self.egain_mass_ratio * percent / 100.0)
        return replace(self, mass_per_length_kg_per_m=mass, egain_mass_ratio=0.0)


@dataclass(frozen=True)
class VelocityBox:
    """Body velocities that a library covers: (low, high) per axis."""

    forward_mps: Annotated[
        Pair, key("m/s, lowest and highest speed at an action's start that tables are made for")
    ]
    left_mps: Annotated[Pair, key("m/s, the same to the left")]
    omega_rad_s: Annotated[Pair, key("degrees/s, the same of the turn rate")]


@dataclass(frozen=True)
class Guard:
    """Limits of the limbs that the robot enforces itself."""

    pulse_max_s: Annotated[
        Positive, key("s that no pulse is longer than, whatever is asked; a robot takes at most 0.1")
    ]
    rest_min_s: Annotated[NotNegative, key("s that a limb rests after a pulse")]
    duty_max: Annotated[float, key("share of the time that a limb is on, at most", gt=0.0, le=1.0)]
    duty_window_s: Annotated[Positive, key("s that this share is counted over")]
    limbs_at_once_max: Annotated[int, key("limbs that are on at a time, at most", ge=1, le=8)]
    fix_fresh_s: Annotated[Positive, key("s that a position fix is used for decisions")] = 0.5
    fix_lost_s: Annotated[Positive, key("s without a fix after which a run ends, disarmed")] = 2.0


@dataclass(frozen=True)
class Battery:
    """The batteries of the limbs. Simulations use none."""

    count: Annotated[int, key("how many", ge=1, le=64)]
    nominal_v: Annotated[Positive, key("V of each")]
    low_v: Annotated[Positive, key("V at rest below which nothing is armed")]
    full_v: Annotated[Positive, key("V at rest when full")]
    measure: Annotated[str, key("where a person measures it", min_length=1, max_length=100)]
    inputs: Annotated[tuple[Annotated[int, Field(ge=0, le=7)], ...], key(
        "AIN0 to AIN7 of the chip, one for each battery that is wired to one", max_length=8
    )] = ()  # fmt: skip
    divider: Annotated[float, key("V of the battery for 1 V at the input", ge=1.0, le=100.0)] = 1.0


@dataclass(frozen=True, kw_only=True)
class PlannerDefaults(Weights):
    """Cost, weights, depth and time of the planner."""

    cost: str
    depth: int
    plan_time_s: float


class ProfileTable(_Table):
    egain_percent: float = key("the alloy that was measured", ge=0.0, le=100.0)
    frequency_hz: Positive = key("strokes a second at which it was measured")
    duration_s: Positive = key("s of the measurement, one stroke")
    rest_curvature_per_m: Positive = key("1/m, size of the curvature at rest")
    amplitude_per_m: list[float] = key("1/m of each term: amplitude / (1 + exp(-(t - centre) / width))")
    centre_s: list[float] = key("s of each term")
    width_s: list[Positive] = key("s of each term")
    rms_per_m: NotNegative = key("1/m that the terms miss the measurement by, root mean square")
    start_per_m: NotNegative = key(
        "1/m at the pulse's start; above 0: one term up to straightest_s, one from there on", 0.0
    )
    straightest_s: NotNegative = key("s at which the limb is straightest, with start_per_m", 0.0)


class ActionTable(_Table):
    name: ActionName = key("a letter, or a word of up to 20 letters, digits, - and _; up to 32 actions")
    first: list[str] = key("limbs that fire at the action's start")
    second: list[str] = key("limbs that fire second_delay_s later")


class GaitTable(_Table):
    lead: list[str] = key("of a steady gait: limbs that fire first")
    lag: list[str] = key("and those that fire a phase later")


@cache
def keys_of(part: Hashable) -> dict[str, str]:
    """Key in a file of each field of a part that has one, by the field. Angles are in degrees there."""
    hints = get_type_hints(part, include_extras=True).items()
    return {name: name.replace("_rad", "_deg") for name, hint in hints if get_origin(hint) is Annotated}


def _table_of(part: type, name: str) -> type[_Table]:
    """The table of a file with the keys of a part; what is a tuple there is a list here."""
    hints: dict[str, Any] = get_type_hints(part, include_extras=True)
    fields: dict[str, Any] = {}
    for field, key_name in keys_of(part).items():
        kind, default = get_args(hints[field])[0], getattr(part, field, ...)
        if get_origin(kind) is tuple and get_args(kind)[1:] == (...,):
            kind, default = types.GenericAlias(list, get_args(kind)[0]), [] if default == () else default
        fields[key_name] = (Annotated[(kind, *hints[field].__metadata__)], default)
    table: type[_Table] = create_model(name, __base__=_Table, **fields)
    return table


def _weight(name: str, weight: Weight) -> tuple[type[float], Any]:
    default = ... if weight.required else getattr(Weights, name)
    return float, key(weight.about, default, ge=weight.least, le=weight.most)


if TYPE_CHECKING:
    FrameTable = Any
    LimbTable = Any
    LibraryTable = Any
    GuardTable = Any
    BatteryTable = Any
    PlannerTable = Any
else:
    FrameTable = _table_of(Frame, "FrameTable")
    LimbTable = create_model(
        "LimbTable",
        __base__=_table_of(Limb, "LimbKeys"),
        profile=(
            list[ProfileTable],
            key("its own [[limb.profile]] tables, or a profiles_file; without any, those of the robot", []),
        ),
    )
    LibraryTable, GuardTable = _table_of(VelocityBox, "LibraryTable"), _table_of(Guard, "GuardTable")
    BatteryTable = _table_of(Battery, "BatteryTable")
    PlannerTable = create_model(
        "PlannerTable",
        __base__=_Table,
        cost=(
            Literal[tuple(COSTS)],
            key("route: progress along the path; paper: the published cost", "paper"),
        ),
        **{name: _weight(name, weight) for name, weight in WEIGHTS.items()},
        plan_time_s=(float, key("s that a decision may take on the robot; 0: no limit", 0.0, ge=0.0, le=1.0)),
        depth=(int, key("levels to look ahead, 1 to 4; route: from 3 on a beam of four more", ge=1, le=4)),
    )


class RobotFile(_Table):
    """All keys of a robot file; ``limb_default`` is merged into each limb before this is filled."""

    id: str = key(
        "1 to 15 letters, digits, - or _; tables, firmware and logs carry it",
        min_length=1,
        max_length=ID_MAX,
        pattern=r"^[A-Za-z0-9_\-]+$",
    )
    title: str = key("for people", min_length=1, max_length=200)
    period_s: Positive = key("s from one action to the next; a stroke is to end within it")
    pulse_s: Positive = key("s that a limb is heated for a stroke")
    second_delay_s: NotNegative = key("s from the action's first limbs to its second ones")
    pulse_energy_j: NotNegative | None = key(
        "J, electrical, of one pulse on one limb; only costs of transport need it, unknown without it", None
    )
    egain_percent: float = key("the limbs' alloy, as in [[profile]]", ge=0.0, le=100.0)
    profile_frequency_hz: Positive = key(
        "Hz of the [[profile]] that strokes are taken from, near 1 / period_s"
    )
    velocity_resolution: tuple[Positive, Positive, Positive] = key(
        "m/s, m/s, rad/s: one step of a table's velocities"
    )
    integrator: Literal["generalised-alpha", "backward-euler"] = key(
        "time steps of simulations: generalised-alpha, or backward-euler of 1 ms as the paper's",
        "generalised-alpha",
    )
    drag_law: Literal["component", "speed"] = key(
        "drag across and along a rod: component, each with its own square; speed, each with the speed's |v|",
        "component",
    )
    water: WaterTable
    frame: FrameTable
    limb: Annotated[list[LimbTable], Field(min_length=1, max_length=LIMBS_MAX)]
    action: Annotated[list[ActionTable], Field(min_length=1, max_length=ACTIONS_MAX)]
    gait: GaitTable
    library: LibraryTable
    guard: GuardTable
    planner: PlannerTable
    profile: Annotated[list[ProfileTable], Field(min_length=1)]
    battery: BatteryTable | None = None
    found_from: str = key(
        "id of the robot whose runs these effects were found from; its runs are taken for this robot's",
        "",
        max_length=ID_MAX,
    )
    effect: list[dict[str, str | bool | int | float | dict[str, dict[str, str | int | float]]]] = []


def table_in(field: FieldInfo) -> type[BaseModel] | None:
    """The table that a key holds, alone or in a list; None for a value."""
    kinds = (field.annotation, *get_args(field.annotation))
    return next((kind for kind in kinds if isclass(kind) and issubclass(kind, BaseModel)), None)


def _descriptions() -> Iterator[tuple[str, str]]:
    for name, field in RobotFile.model_fields.items():
        if (table := table_in(field)) is not None:
            yield from ((f"{name}.{inner}", str(at.description)) for inner, at in table.model_fields.items())
        elif name != "effect":
            yield name, str(field.description)


ABOUT = dict(_descriptions())
"""Key with its table -> description with unit."""
