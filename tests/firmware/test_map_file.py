"""The map beside an image says what lies in it and where, each byte of code once."""

from __future__ import annotations

import re
from itertools import pairwise

from tests.runs import rig

from frogkick.pool.chip.image import unwanted


def test_the_map_says_what_is_where() -> None:
    built = rig.firmware("bench")
    text = built.files["map"].read_text()
    rows = [
        (int(found[1], 16), int(found[2]), found[3], found[4])
        for found in re.finditer(r"^0x([0-9a-f]{8}) +(\d+)  (\.\S+)  (\S+)$", text, re.MULTILINE)
    ]
    names = {name for *_, name in rows}
    assert {"fk_robot_tick", "fk_guard_allow", "fk_plan", "fk_reset"} <= names
    # A set: some functions have several names.
    code = sorted({(address, size) for address, size, section, _ in rows if section == ".text"})
    assert len(code) > 100
    assert all(one[0] + one[1] <= two[0] for one, two in pairwise(code)), "no overlap"
    sections = re.findall(r"^0x[0-9a-f]{8} +(\d+)  (\.\S+)$", text, re.MULTILINE)
    (text_bytes,) = (int(size) for size, name in sections if name == ".text")
    used = sum(size for _, size in code)
    assert 0.9 * text_bytes <= used <= text_bytes, "the map tells of nearly all of it"
    assert unwanted(names) == [], "no 64-bit division, float in software, libm, heap"
