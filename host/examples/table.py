"""A table: simulated transitions fitted into 64 KiB, the error on unseen states, and one decision."""

import frogkick as fk

robot = fk.load_robot("frog2022")
library = fk.build_library(robot, states=100, sampling="visited", progress=True)
table = fk.fit_table(library, kind="affine", budget_kib=64, progress=True)
print(table)

error = table.error(states=16, sampling="visited")
print(f"error one period ahead: {1e3 * error['position_m']:.2f} mm and {error['heading_rad']:.4f} rad RMS")
table.save("tables.fkt")

# From rest at the origin, planned three periods ahead, with the same bits as on the robot.
plan = fk.Planner(fk.load_table("tables.fkt", robot), depth=3).plan([0, 0, 0, 0, 0, 0], fk.paths.sine())
print(f"do {plan.action} now, then {', '.join(plan.actions[1:])}")
