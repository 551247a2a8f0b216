"""A table: transitions simulated, fitted into 64 KiB, its error on unseen states, and one decision."""

import frogkick as fk

robot = fk.load_robot("frog2022")
library = fk.build_library(robot, states=100, sampling="visited", progress=True)
table = fk.fit_table(library, kind="affine", budget_kib=64, progress=True)
print(table)

error = table.error(states=16, sampling="visited")
print(f"a period ahead it errs by {1e3 * error['position_m']:.2f} mm and {error['heading_rad']:.4f} rad")
table.save("tables.fkt")

# From rest at the origin, three periods ahead, as the robot itself would decide.
plan = fk.Planner(fk.load_table("tables.fkt", robot), depth=3).plan([0, 0, 0, 0, 0, 0], fk.paths.sine())
print(f"do {plan.action} now, then {', '.join(plan.actions[1:])}")
