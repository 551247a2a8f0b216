"""CoreMark on the virtual chip, by the least and the most of its cost model.

    PYTHONPATH=. .venv/bin/python -m tests.bench.coremark FOLDER [ITERATIONS]

FOLDER has EEMBC's sources (core_list_join.c, core_main.c, core_matrix.c, core_state.c, core_util.c and
coremark.h), which are not part of this project. Nordic publishes 215 for the nRF52832 at 64 MHz, from flash
with the cache on, by another compiler: here the chip's model and the project's compiler are timed together.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.firmware.bench_build import BENCH, build

from frogkick.core.errors import InputError
from frogkick.pool.chip import VirtualChip
from frogkick.pool.chip.cost import LEAST_COST, CostModel

SOURCES = ("core_list_join.c", "core_main.c", "core_matrix.c", "core_state.c", "core_util.c")
PORT = Path(__file__).parent / "coremark_port"
CLOCK_HZ = 64e6
PUBLISHED = 215.0


def firmware(folder: Path, to: Path) -> Path:
    """Build CoreMark around the port.

    Raises:
        InputError: a source is not there.
    """
    missing = [name for name in (*SOURCES, "coremark.h") if not (folder / name).is_file()]
    if missing:
        raise InputError(f"{folder} has no {missing[0]}: give the folder of EEMBC's CoreMark sources")
    renamed = to / "core_main_renamed.c"
    renamed.write_text(f'#define main coremark_main\n#include "{folder.resolve() / "core_main.c"}"\n')
    others = [folder / name for name in SOURCES if name != "core_main.c"]
    files = [renamed, *others, PORT / "core_portme.c", BENCH / "startup.c"]
    options = ("-w", f"-I{PORT}", f"-I{folder}")
    return build(files, to / "coremark.elf", *options, drivers=False)


def cycles(elf: Path, cost: CostModel, iterations: int) -> float:
    """Of one iteration: what twice as many take more.

    Raises:
        InputError: CoreMark does not find its own results right.
    """
    chip = VirtualChip(elf, cost)
    chip.run_until(1e6)
    taken = []
    for count in (iterations, 2 * iterations):
        right, each = chip.call("coremark_run", count)
        if not right:
            raise InputError(f"CoreMark did not validate its {count} iterations: the sources were changed")
        taken.append(each)
    return (taken[1] - taken[0]) / iterations


def main(arguments: list[str]) -> tuple[float, float]:
    """Print and return CoreMark at 64 MHz by the most and by the least of the cost model."""
    folder, iterations = Path(arguments[0]), int(arguments[1]) if len(arguments) > 1 else 10
    with tempfile.TemporaryDirectory() as place:
        elf = firmware(folder, Path(place))
        most, least = (CLOCK_HZ / cycles(elf, cost, iterations) for cost in (CostModel(), LEAST_COST))
    print(
        f"CoreMark at 64 MHz: {most:.0f} to {least:.0f} by the cost model; Nordic publishes {PUBLISHED:.0f}"
    )
    return most, least


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except (InputError, IndexError) as error:
        sys.exit(f"tests.bench.coremark: {error}" if isinstance(error, InputError) else __doc__)
