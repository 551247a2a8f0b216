"""A worn limb: true in the pool but not in the model, identified from logs, and added to the model."""

import frogkick as fk

robot = fk.load_robot("frog2022")
table = fk.fit_table(fk.build_library(robot, states=100, sampling="visited", progress=True))

world = fk.World([fk.effects.LimbWear(limb="rear_left", gain=0.7)])
runs = [fk.run(table, path, robot="pool", world=world) for path in ("line", "sine", "ellipse")]

# The last run is the test run: nothing is fitted to it, and the errors are those of its prediction.
found = fk.identify(runs[:2], robot=robot, test=runs[2:], progress=True)
print(found)
for effect in found.effects:
    for name, value in effect.parameters.items():
        low, high = value.interval
        print(f"{effect.name} {effect.options}: {name} {value.value:.3f} (95 %: {low:.3f} to {high:.3f})")
found.robot.save("worn.toml")
found.report("worn.html")
