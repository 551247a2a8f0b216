"""The robot file as it is written: each key with its type, its range and its meaning.

These pydantic models are used only where a file enters. Checks, new robots' files and the documentation
follow from them.
"""

from __future__ import annotations

from collections.abc import Iterator
from inspect import isclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, create_model
from pydantic.fields import FieldInfo

from frogkick.core.weights import WEIGHTS, Weight, Weights

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Pair = tuple[float, float]
ACTION_NAME_MAX = 20
ACTIONS_MAX = 32
"""As many as a table image has room for."""

ActionName = Annotated[str, Field(max_length=ACTION_NAME_MAX, pattern=r"^[A-Za-z][A-Za-z0-9_\-]*$")]
Name = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_\-]+$")]


def key(about: str, default: Any = ..., **limits: Any) -> Any:
    """Declare a key: its meaning with unit, its default if it may be left out, and its limits."""
    return Field(default, description=about, **limits)


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=False)


class WaterTable(_Table):
    density_kg_per_m3: Positive = key("kg/m^3")


class FrameTable(_Table):
    corners_m: list[Pair] = key(
        "m, x forward, y left, counter-clockwise; the origin is anywhere", min_length=3, max_length=64
    )
    segments: list[Annotated[int, Field(ge=1, le=500)]] = key(
        "pieces of each edge; edge i runs from corner i to corner i + 1"
    )
    mass_per_length_kg_per_m: Positive = key("kg for each m of the outline")
    added_mass_per_length_kg_per_m: NotNegative = key("kg of water that moves with each m of it")
    stretching_stiffness_n: Positive = key("N, Young's modulus times section")
    bending_stiffness_n_m2: Positive = key("N m^2, Young's modulus times second moment of area")
    drag_width_m: NotNegative = key("m across the flow, the depth of the frame in water")
    drag_normal: NotNegative = key("drag coefficient across an edge")
    drag_tangential: NotNegative = key("drag coefficient along it")
    centre_mass_share: float = key(
        "share of that mass that sits at the centre of the corners, 0 to 0.95", 0.0, ge=0.0, le=0.95
    )


class LimbTable(_Table):
    name: Name = key("letters, digits, - or _")
    corner: int = key("where it begins, counted from 0 in frame.corners_m", ge=0)
    clamp: Literal["previous", "next"] = key(
        "the edge at that corner that its root bends against: previous or next"
    )
    direction_deg: float = key(
        "degrees from forward, counter-clockwise, of its tangent at the root", ge=-360.0, le=360.0
    )
    length_m: Positive = key("m along the limb")
    segments: int = key("pieces", ge=2, le=500)
    rest_curvature_per_m: float = key(
        "1/m at rest, positive where it curls counter-clockwise towards its tip"
    )
    modulus_rest_pa: Positive = key("Pa, Young's modulus at rest")
    modulus_active_pa: Positive = key("Pa, while it is straightest")
    second_moment_m4: Positive = key("m^4, second moment of area")
    section_m2: Positive = key("m^2")
    root_stiffness_ratio: Positive = key("how much stiffer the clamp is than the limb")
    mass_per_length_kg_per_m: Positive = key("kg for each m")
    added_mass_per_length_kg_per_m: NotNegative = key("kg of water that moves with each m of it")
    drag_width_m: NotNegative = key("m across the flow")
    drag_normal: NotNegative = key("drag coefficient across the limb")
    drag_tangential: NotNegative = key("drag coefficient along it")


class ActionTable(_Table):
    name: ActionName = key("a letter, or a word of up to 20 letters, digits, - and _; up to 32 actions")
    first: list[str] = key("limbs that fire at the action's start")
    second: list[str] = key("limbs that fire second_delay_s later")


class GaitTable(_Table):
    lead: list[str] = key("of a steady gait: limbs that fire first")
    lag: list[str] = key("and those that fire a phase later")


class LibraryTable(_Table):
    forward_mps: Pair = key("m/s, lowest and highest speed at an action's start that tables are made for")
    left_mps: Pair = key("m/s, the same to the left")
    omega_deg_s: Pair = key("degrees/s, the same of the turn rate")


class GuardTable(_Table):
    pulse_max_s: Positive = key("s that no pulse is longer than, whatever is asked")
    rest_min_s: NotNegative = key("s that a limb rests after a pulse")
    duty_max: float = key("share of the time that a limb is on, at most", gt=0.0, le=1.0)
    duty_window_s: Positive = key("s that this share is counted over")
    limbs_at_once_max: int = key("limbs that are on at a time, at most", ge=1, le=8)
    fix_fresh_s: Positive = key("s that a position fix is used for decisions", 0.5)
    fix_lost_s: Positive = key("s without a fix after which a run ends, disarmed", 2.0)


def _weight(name: str, weight: Weight) -> tuple[type[float], Any]:
    default = ... if weight.required else getattr(Weights, name)
    return float, key(weight.about, default, ge=weight.least, le=weight.most)


if TYPE_CHECKING:
    PlannerTable = _Table
else:
    PlannerTable = create_model(
        "PlannerTable",
        __base__=_Table,
        cost=(
            Literal["paper", "route"],
            key("route: progress along the path; paper: the published cost", "paper"),
        ),
        **{name: _weight(name, weight) for name, weight in WEIGHTS.items()},
        plan_time_s=(float, key("s that a decision may take on the robot; 0: no limit", 0.0, ge=0.0, le=1.0)),
        depth=(int, key("levels to look ahead, 1 to 4", ge=1, le=4)),
    )


class BatteryTable(_Table):
    count: int = key("how many", ge=1, le=64)
    nominal_v: Positive = key("V of each")
    low_v: Positive = key("V at rest below which nothing is armed")
    full_v: Positive = key("V at rest when full")
    measure: str = key("where a person measures it", min_length=1, max_length=100)
    inputs: list[Annotated[int, Field(ge=0, le=7)]] = key(
        "AIN0 to AIN7 of the chip, one for each battery that is wired to one", [], max_length=8
    )
    divider: float = key("V of the battery for 1 V at the input", 1.0, ge=1.0, le=100.0)


class ProfileTable(_Table):
    egain_percent: float = key("the alloy that was measured", ge=0.0, le=100.0)
    frequency_hz: Positive = key("strokes a second at which it was measured")
    duration_s: Positive = key("s of the measurement, one stroke")
    rest_curvature_per_m: Positive = key("1/m, size of the curvature at rest")
    amplitude_per_m: list[float] = key("1/m of each term: amplitude / (1 + exp(-(t - centre) / width))")
    centre_s: list[float] = key("s of each term")
    width_s: list[Positive] = key("s of each term")
    rms_per_m: NotNegative = key("1/m that the terms miss the measurement by, root mean square")


class RobotFile(_Table):
    """All keys of a robot file; ``limb_default`` is merged into each limb before this is filled."""

    id: str = key(
        "1 to 15 letters, digits, - or _; tables, firmware and logs carry it",
        min_length=1,
        max_length=15,
        pattern=r"^[A-Za-z0-9_\-]+$",
    )
    title: str = key("for people", min_length=1, max_length=200)
    period_s: Positive = key("s from one action to the next; a stroke is to end within it")
    pulse_s: Positive = key("s that a limb is heated for a stroke")
    second_delay_s: NotNegative = key("s from the action's first limbs to its second ones")
    pulse_energy_j: NotNegative = key(
        "J, electrical, of one pulse on one limb; only costs of transport need it"
    )
    egain_percent: float = key("the limbs' alloy, as in [[profile]]", ge=0.0, le=100.0)
    profile_frequency_hz: Positive = key(
        "Hz of the [[profile]] that strokes are taken from, near 1 / period_s"
    )
    velocity_resolution: tuple[Positive, Positive, Positive] = key(
        "m/s, m/s, rad/s: one step of a table's velocities"
    )
    water: WaterTable
    frame: FrameTable
    limb: Annotated[list[LimbTable], Field(min_length=1, max_length=8)]
    action: Annotated[list[ActionTable], Field(min_length=1, max_length=ACTIONS_MAX)]
    gait: GaitTable
    library: LibraryTable
    guard: GuardTable
    planner: PlannerTable
    profile: Annotated[list[ProfileTable], Field(min_length=1)]
    battery: BatteryTable | None = None
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
