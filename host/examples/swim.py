"""A swim: three actions in the rod simulation, and the gait of the paper."""

import frogkick as fk

robot = fk.load_robot("frog2022")
print(robot)

# Action B fires both front limbs and then both rear limbs, C one side only: see `frogkick robot show`.
swim = fk.simulate(robot, "BBC")
x_m, y_m, heading_rad = swim.pose_world[-1]
print(f"after {swim.time_s[-1]:.2f} s: {1e3 * x_m:.1f}, {1e3 * y_m:.1f} mm, turned by {heading_rad:.2f} rad")

gait = fk.simulate(robot, egain_percent=10, frequency_hz=0.8, cycles=8)
print(f"the gait swims at {1e3 * gait.speed_mps:.1f} mm/s, cost of transport {gait.cost_of_transport:.0f}")
