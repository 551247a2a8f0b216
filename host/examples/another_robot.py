"""Another robot: a TOML file that changes a few keys of the paper's robot, its table, a run, its firmware."""

from pathlib import Path

import frogkick as fk

# All other keys are those of frog2022. Every key is listed in host/docs/pages/reference/robot-files.md.
Path("mine.toml").write_text(
    """
base = "frog2022"
id = "mine"
title = "the paper's robot with a slower clock"
period_s = 1.8
"""
)
mine = fk.load_robot("mine.toml")
print(mine)

table = fk.fit_table(fk.build_library(mine, states=50, sampling="planned", progress=True))
run = fk.run(table, "line", robot="pool", progress=True)
print(run)

firmware = fk.build_firmware(table)
print(f"its firmware takes {firmware.flash_bytes} bytes of flash and {firmware.ram_bytes} of RAM")
