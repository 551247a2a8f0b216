"""The benchmark runs and says what it should; its figures are not looked at."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from tests.bench import coremark, elastica_rod, rods, startup
from tests.conftest import from_ci
from tests.identification.made import robot

from frogkick.core.errors import InputError


@from_ci
def test_the_benchmark_tells_every_cost(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rods, "ROBOT", robot())
    rods.main(["--quick"])
    said = capsys.readouterr().out
    for title in ("lanes:", "actions:", "plates:", "nodes:", "library:", "a plain rod"):
        assert f"\n{title}" in said
    assert "nan" not in said


def test_what_a_command_costs_before_its_first_word(capsys: pytest.CaptureFixture[str]) -> None:
    ratios = startup.main(1)
    assert ratios.keys() == startup.COMMANDS.keys() and min(ratios.values()) > 0.0
    assert "times that" in capsys.readouterr().out


@pytest.mark.skipif(importlib.util.find_spec("elastica") is None, reason="pyelastica is not installed")
def test_both_codes_find_the_same_deflection() -> None:
    _, ours = elastica_rod.frogkick_rod(1, 1)
    _, theirs = elastica_rod.elastica_rod(1)
    assert ours == pytest.approx(theirs, rel=1e-3)


STAND_IN = """
#include "coremark.h"
MAIN_RETURN main(void)
{
    core_portable port;
    portable_init(&port, 0, 0);
    start_time();
    for (volatile ee_s32 n = 1000 * seed4_volatile; n > 0; --n) {
    }
    stop_time();
    if (time_in_secs(get_time()) >= 10u && %s) {
        ee_printf("Correct operation validated. See the rules.\\n");
    }
    portable_fini(&port);
    return 0;
}
"""
HEADER = """
#define SEED_VOLATILE 2
#define MEM_STATIC 0
#include "core_portme.h"
#define MAIN_RETURN int
typedef ee_u32 secs_ret;
extern volatile ee_s32 seed4_volatile;
void start_time(void);
void stop_time(void);
CORE_TICKS get_time(void);
secs_ret time_in_secs(CORE_TICKS ticks);
"""


@pytest.mark.parametrize("right", [1, 0])
def test_coremark_is_timed_by_the_cycles_of_its_iterations(
    right: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stand-in with the same port, one iteration a loop of a thousand turns: the real one is no package."""
    for name in coremark.SOURCES:
        (tmp_path / name).write_text("" if name != "core_main.c" else STAND_IN % right)
    with pytest.raises(InputError, match=r"no coremark\.h: give the folder"):
        coremark.main([str(tmp_path)])
    (tmp_path / "coremark.h").write_text(HEADER)
    if not right:
        with pytest.raises(InputError, match="did not validate its 3 iterations"):
            coremark.main([str(tmp_path), "3"])
        return
    most, least = coremark.main([str(tmp_path), "3"])
    assert 64e6 / 20e3 < most < least < 64e6 / 5e3
    assert "CoreMark at 64 MHz:" in capsys.readouterr().out
