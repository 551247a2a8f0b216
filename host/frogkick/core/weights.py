"""The planner's costs and their weights, declared once.

The keys of a robot's file, ``PlanConfig`` and the settings of the Python planner are derived from them.
``python -m frogkick_codegen.frames`` writes ``fk_cost_t`` and ``fk_plan_config_t`` of the C planner and their
list in the firmware.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, NamedTuple, get_type_hints

COSTS: Mapping[str, str] = {
    "paper": "the paper's Eq. 19, as its authors ran it",
    "route": "distance and progress as stage cost, course as terminal cost: route.c",
}
"""Name in a robot's file -> meaning, as a comment in C. Its place is its number on the link."""


class Weight(NamedTuple):
    """Declaration of a weight: a finite number of at least 0, or of a place: one of either sign."""

    about: str  # meaning with its unit, as a comment in a robot's file
    meaning: str  # use in the planner, as a comment in C
    most: float = 1e6  # the largest value
    required: bool = False  # whether a robot's file must have it; otherwise the default is the paper's value
    least: float = 0.0  # 0, or -most of a place

    @property
    def limits(self) -> tuple[float, float]:
        """The least and the largest value."""
        return self.least, self.most


def _place(about: str, meaning: str) -> Weight:
    return Weight(about, meaning, most=1000.0, least=-1000.0)


@dataclass(frozen=True)
class Weights:
    """Weights and lengths of the costs with the paper's values as defaults; ``WEIGHTS`` has their
    meanings."""

    distance_weight_per_m: Annotated[float, Weight(
        "cost per m of distance from the path",
        "x distance to the nearest path point (paper: 500), or to the path (route)",
        required=True,
    )] = 500.0  # fmt: skip
    angle_weight_per_rad: Annotated[float, Weight(
        "cost per rad of deviation from its direction",
        "x angle between heading and path: its tangent there (paper: 50); route: between course and target "
        "point look_ahead_m further on, at a branch's end only",
        required=True,
    )] = 50.0  # fmt: skip
    progress_weight: Annotated[float, Weight(
        "used by the published cost only", "paper: x (1 - index / (count - 1)); paper: 300"
    )] = 300.0  # fmt: skip
    level_weight: Annotated[float, Weight(
        "used by the published cost only",
        "paper: a level's cost x (1 + level_weight * levels below it); paper: 0.3",
    )] = 0.3  # fmt: skip
    progress_weight_per_m: Annotated[float, Weight(
        "cost per m by which a stroke advances less along the path than the longest one",
        "route: x how much less a motion advances than the table's longest stroke",
    )] = 0.0  # fmt: skip
    look_ahead_m: Annotated[float, Weight(
        "m along the path to the point that the robot's course is aimed at",
        "route: how far along the path the course's target point lies",
    )] = 0.0  # fmt: skip
    soft_distance_m: Annotated[float, Weight(
        "m from the path; a smaller distance costs by its square",
        "route: threshold of the Huber loss, below which distance counts by its square",
    )] = 0.0  # fmt: skip
    turn_lead: Annotated[float, Weight(
        "share of its last turn by which a robot is assumed to turn further, 0 to 2",
        "route: x the last turn, by which the robot turns further",
        most=2.0,
    )] = 0.0  # fmt: skip
    course_weight_per_m: Annotated[float, Weight(
        "weight of the last motion, per m of it, against the heading in the robot's course",
        "route: x the last motion; with the heading it is the course of a branch's end",
    )] = 0.0  # fmt: skip
    glide_weight_per_m: Annotated[float, Weight(
        "cost per m of distance from the path where the robot glides to",
        "route: x distance from the path of the point to which a branch's end glides",
    )] = 0.0  # fmt: skip
    glide_lead: Annotated[float, Weight(
        "share of its last motion by which a robot is assumed to glide further, 0 to 2",
        "route: x the last motion, turned further, by which a branch's end glides",
        most=2.0,
    )] = 0.0  # fmt: skip
    wall_weight_per_m: Annotated[float, Weight(
        "cost per m that the robot's centre goes beyond the walls; 0: there are none",
        "route: x how far each motion's end, and the point to which the last glides, lie beyond the walls",
    )] = 0.0  # fmt: skip
    wall_glide: Annotated[float, Weight(
        "share of its last motion by which a robot is assumed to glide towards a wall",
        "route: x the last motion, by which the robot glides towards a wall",
        most=100.0,
    )] = 0.0  # fmt: skip
    wall_x_min_m: Annotated[
        float, _place("m, world: least x of the robot's centre", "route: where its centre may be, world")
    ] = -1000.0
    wall_x_max_m: Annotated[float, _place("m, world: largest x of the robot's centre", "likewise")] = 1000.0
    wall_y_min_m: Annotated[float, _place("m, world: least y of the robot's centre", "likewise")] = -1000.0
    wall_y_max_m: Annotated[float, _place("m, world: largest y of the robot's centre", "likewise")] = 1000.0


WEIGHTS: Mapping[str, Weight] = {
    name: hint.__metadata__[0] for name, hint in get_type_hints(Weights, include_extras=True).items()
}
"""Name -> declaration, in the order of ``fk_plan_config_t``."""
