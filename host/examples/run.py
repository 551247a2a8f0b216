"""A run: the robot's C core steers a simulated robot along a path of waypoints, and the run is drawn."""

import frogkick as fk

robot = fk.load_robot("frog2022")
table = fk.fit_table(fk.build_library(robot, states=100, sampling="visited", progress=True))

path = fk.paths.from_waypoints([(0.0, 0.0), (0.2, 0.05), (0.4, 0.0)])
run = fk.run(table, path, robot="pool", seed=1, progress=True)
print(run)
print(f"mean distance from the path: {1e3 * run.tracking.mean_distance_m:.1f} mm")

run.save("run.h5")
fk.load_run("run.h5").plot().savefig("run.png")
