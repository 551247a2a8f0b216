"""The robot file as it is written: pydantic models, used only where a file enters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model

from frogkick.core.weights import WEIGHTS, Weights

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Pair = tuple[float, float]
ACTION_NAME_MAX = 20
ACTIONS_MAX = 32
"""As many as a table image has room for."""

ActionName = Annotated[str, Field(max_length=ACTION_NAME_MAX, pattern=r"^[A-Za-z][A-Za-z0-9_\-]*$")]
Name = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_\-]+$")]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=False)


class WaterTable(_Table):
    density_kg_per_m3: Positive


class FrameTable(_Table):
    corners_m: Annotated[list[Pair], Field(min_length=3, max_length=64)]
    segments: list[Annotated[int, Field(ge=1, le=500)]]
    mass_per_length_kg_per_m: Positive
    added_mass_per_length_kg_per_m: NotNegative
    stretching_stiffness_n: Positive
    bending_stiffness_n_m2: Positive
    drag_width_m: NotNegative
    drag_normal: NotNegative
    drag_tangential: NotNegative
    centre_mass_share: Annotated[float, Field(ge=0.0, le=0.95)] = 0.0


class LimbTable(_Table):
    name: Name
    corner: Annotated[int, Field(ge=0)]
    clamp: Literal["previous", "next"]
    direction_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    length_m: Positive
    segments: Annotated[int, Field(ge=2, le=500)]
    rest_curvature_per_m: float
    modulus_rest_pa: Positive
    modulus_active_pa: Positive
    second_moment_m4: Positive
    section_m2: Positive
    root_stiffness_ratio: Positive
    mass_per_length_kg_per_m: Positive
    added_mass_per_length_kg_per_m: NotNegative
    drag_width_m: NotNegative
    drag_normal: NotNegative
    drag_tangential: NotNegative


class ActionTable(_Table):
    name: ActionName
    first: list[str]
    second: list[str]


class GaitTable(_Table):
    lead: list[str]
    lag: list[str]


class LibraryTable(_Table):
    forward_mps: Pair
    left_mps: Pair
    omega_deg_s: Pair


class GuardTable(_Table):
    pulse_max_s: Positive
    rest_min_s: NotNegative
    duty_max: Annotated[float, Field(gt=0.0, le=1.0)]
    duty_window_s: Positive
    limbs_at_once_max: Annotated[int, Field(ge=1, le=8)]
    fix_fresh_s: Positive = 0.5
    fix_lost_s: Positive = 2.0


if TYPE_CHECKING:
    PlannerTable = _Table
else:
    PlannerTable = create_model(
        "PlannerTable",
        __base__=_Table,
        cost=(Literal["paper", "route"], "paper"),
        **{
            name: (
                Annotated[float, Field(ge=weight.least, le=weight.most)],
                ... if weight.required else getattr(Weights, name),
            )
            for name, weight in WEIGHTS.items()
        },
        plan_time_s=(Annotated[float, Field(ge=0.0, le=1.0)], 0.0),
        depth=(Annotated[int, Field(ge=1, le=4)], ...),
    )


class BatteryTable(_Table):
    count: Annotated[int, Field(ge=1, le=64)]
    nominal_v: Positive
    low_v: Positive
    full_v: Positive
    measure: Annotated[str, Field(min_length=1, max_length=100)]
    inputs: Annotated[list[Annotated[int, Field(ge=0, le=7)]], Field(max_length=8)] = []
    divider: Annotated[float, Field(ge=1.0, le=100.0)] = 1.0


class ProfileTable(_Table):
    egain_percent: Annotated[float, Field(ge=0.0, le=100.0)]
    frequency_hz: Positive
    duration_s: Positive
    rest_curvature_per_m: Positive
    amplitude_per_m: list[float]
    centre_s: list[float]
    width_s: list[Positive]
    rms_per_m: NotNegative


class RobotFile(_Table):
    """All keys of a robot file; ``limb_default`` is merged into each limb before this is filled."""

    id: Annotated[str, Field(min_length=1, max_length=15, pattern=r"^[A-Za-z0-9_\-]+$")]
    title: Annotated[str, Field(min_length=1, max_length=200)]
    period_s: Positive
    pulse_s: Positive
    second_delay_s: NotNegative
    pulse_energy_j: NotNegative
    egain_percent: Annotated[float, Field(ge=0.0, le=100.0)]
    profile_frequency_hz: Positive
    velocity_resolution: tuple[Positive, Positive, Positive]
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
