"""What a library declares is read from its C, and compared with what the compiler made of it."""

from __future__ import annotations

from pathlib import Path

import _cffi_backend
import pytest
from tests.conftest import REPOSITORY

from frogkick.core.errors import FrogkickError
from frogkick.core.shared_library import load
from frogkick_codegen.declared import declarations
from frogkick_codegen.native import build_shared

HEADER = b"""#ifndef A_H
#define A_H
#include <stdint.h>
#define A_MAX 4U /* things */
#define A_BYTES (A_MAX * 2u + 1u)
#define A_SCALE 1e-9f
#define A_EXPORT
typedef char a_fits[(A_MAX <= 8u) ? 1 : -1];
typedef enum {
    A_GOOD = 0, /* { and ; in a comment */
    A_BAD = -1
} a_error_t;
typedef struct {
    uint8_t bytes[A_BYTES];
    float halves[A_MAX / 2u];
} a_part_t;
typedef struct a_whole a_whole_t;
struct a_whole {
    a_part_t parts[A_MAX];
};
typedef struct { uint8_t unused; } a_unused_t;
static inline int32_t a_hidden(int32_t x) { return x; }
A_EXPORT int32_t a_sum(const a_whole_t *whole,
                       uint32_t count);
extern const uint32_t a_number;
extern const uint8_t *const a_table;
#endif
"""
SOURCE = b"""#include "a.h"
#define LOCAL 3
static int32_t a_own(void);
typedef struct { int32_t x[LOCAL]; } a_mine_t;
int32_t a_take(a_mine_t *mine);
const uint32_t a_number = 7u;
uint8_t a_switch;
static int32_t a_own(void) { return 1; }
static const uint8_t table[] = {1u, 2u};
const uint8_t *const a_table = table;
int32_t a_take(a_mine_t *mine) { return mine->x[LOCAL - 1] + a_own() + table[1] + a_switch; }
int32_t a_sum(const a_whole_t *whole, uint32_t count) { return whole->parts[count].bytes[8]; }
"""


def test_what_is_declared_to_others_and_the_types_that_it_takes() -> None:
    assert declarations({"b.c": SOURCE, "a.h": HEADER}) == {
        "typedef enum { A_GOOD = 0, A_BAD = -1 } a_error_t;": "a.h",
        "typedef struct { uint8_t bytes[9]; float halves[2]; } a_part_t;": "a.h",
        "typedef struct a_whole a_whole_t;": "",
        "struct a_whole { a_part_t parts[4]; };": "a.h",
        "typedef struct { int32_t x[3]; } a_mine_t;": "",
        "int32_t a_sum(const a_whole_t *whole, uint32_t count);": "",
        "extern uint32_t a_number;": "",
        "extern const uint8_t *a_table;": "",
        "int32_t a_take(a_mine_t *mine);": "",
        "extern uint8_t a_switch;": "",
    }


def test_a_library_is_called_by_what_it_carries() -> None:
    ffi, library = load(build_shared("declared", {"b.c": SOURCE, "a.h": HEADER}))
    whole, mine = ffi.new("a_whole_t *"), ffi.new("a_mine_t *", {"x": [0, 0, 5]})
    whole.parts[2].bytes[8] = 11
    assert (library.a_sum(whole, 2), library.a_number, library.a_table[1]) == (11, 7, 2)
    library.a_switch = 100
    assert library.a_take(mine) == 5 + 1 + 2 + 100
    assert load(build_shared("declared", {"b.c": SOURCE, "a.h": HEADER}))[0] is ffi


@pytest.mark.parametrize(
    "change", [(b"    float halves", b"#ifdef NOWHERE\n    float more;\n#endif\n    float halves"),
               (b"4U /* things */", b"4U\n#undef A_MAX\n#define A_MAX (1U ? 6U : 5U)")],
)  # fmt: skip
def test_a_type_that_was_read_otherwise_is_refused(change: tuple[bytes, bytes]) -> None:
    changed = HEADER.replace(*change)
    assert changed != HEADER
    with pytest.raises(FrogkickError, match="bytes in 'declared-"):
        load(build_shared("declared", {"b.c": SOURCE, "a.h": changed}))


def test_a_library_that_says_nothing_is_refused() -> None:
    with pytest.raises(FrogkickError, match="contains no declarations"):
        load(Path(_cffi_backend.__file__))


def test_nobody_writes_declarations_by_hand() -> None:
    files = [path for top in ("host", "codegen", "tests") for path in (REPOSITORY / top).rglob("*.py")]
    held = {path.name for path in files if ".cdef" + "(" in path.read_text(encoding="utf-8")}
    assert held == {"shared_library.py"}
