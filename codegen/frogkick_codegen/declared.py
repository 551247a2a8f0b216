"""The declarations of a shared library, read from its C files and built into it for its callers.

This reads the project's own C, not all C: statements outside of functions, integer macros, no conditions.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

SOURCE = "fk_declared.c"
"""How the file that carries the declarations is called."""

_DEFINE = re.compile(r"^#define (\w+)[ \t]+(.+?)[ \t]*$", re.M)
_EMPTY = re.compile(r"^#define (\w+)[ \t]*(?:__(?:attribute|declspec).*)?$", re.M)
_NUMBER = re.compile(r"\b(\d+|0x[0-9a-f]+)[uU]\b")
_TYPE = re.compile(r"^(?:typedef )?(?:struct|enum|union) ?(\w*) ?\{.*\} ?(\w*);$")


def declarations(files: Mapping[str, bytes]) -> dict[str, str]:
    """Return the functions and variables, and the types that they use, in an order that C accepts.

    Args:
        files: C files by name; everything with external linkage counts, in a ``.c`` too.

    Returns:
        Declaration -> name of the header that defines it as a complete type, or "".
    """
    texts = {name: re.sub(r"/\*.*?\*/", " ", files[name].decode(), flags=re.S) for name in _in_order(files)}
    empty = {macro for text in texts.values() for macro in _EMPTY.findall(text)}
    numbers: dict[str, int] = {}
    types: dict[str, tuple[str, str]] = {}
    symbols: dict[str, str] = {}
    for name, text in texts.items():
        header = name if name.endswith(".h") else ""
        local = _numbers(text, numbers)
        numbers = local if header else numbers
        for statement in _statements(text):
            plain = _dimensioned(" ".join(word for word in statement.split() if word not in empty), local)
            if named := _TYPE.match(plain):
                types.setdefault(named[2] or named[1], (plain, header))
            elif opaque := re.fullmatch(r"typedef struct (\w+) (\w+);", plain):
                types.setdefault(opaque[2], (plain, ""))
            elif function := re.match(r"(?!static |typedef )[^=]*?(\w+)\([^=]*$", plain):
                symbols.setdefault(function[1], plain)
            elif variable := re.match(r"(?!static |typedef )(?:extern )?([^=]+?)(\w+);$", plain):
                kind = re.sub(r"\* ?const |^const (?!.*\*)", lambda c: c[0][:-6], variable[1])
                symbols.setdefault(variable[2], f"extern {kind}{variable[2]};")  # cffi reads no constants
    wanted = {name for name, (text, _) in types.items() if text.startswith("typedef enum")}
    asked = list(symbols.values())
    while asked:
        fresh = {word for text in asked for word in re.findall(r"\w+", text) if word in types} - wanted
        wanted |= fresh
        asked = [types[name][0] for name in fresh]
    found = dict(types[name] for name in types if name in wanted)
    return found | dict.fromkeys(symbols.values(), "")


def source(files: Mapping[str, bytes]) -> bytes:
    """Return the C file that carries the declarations, and the size that the compiler gives each type."""
    found = declarations(files)
    # A library for Windows exports everything by itself, but where something is marked.
    marked = any(b"dllexport" in content for content in files.values())
    headers = dict.fromkeys(filter(None, found.values()))
    lines = ["#include <stdint.h>", *(f'#include "{header}"' for header in headers), ""]
    lines += ["typedef struct {", "    const char *text;", "    uint32_t bytes;", "} fk_declared_t;"]
    lines += ["#if defined(_WIN32)", "__declspec(dllexport)", "#endif"] if marked else []
    lines += ["extern const fk_declared_t fk_declared[];"]
    lines += ["const fk_declared_t fk_declared[] = {"]
    for text, header in found.items():
        named = _TYPE.match(text)
        kind = (named[2] or f"struct {named[1]}") if named else ""
        lines.append(f'    {{"{text}", {f"(uint32_t)sizeof({kind})" if header else "0u"}}},')
    return "\n".join([*lines, "    {0, 0u},", "};", ""]).encode()


def _in_order(files: Mapping[str, bytes]) -> Iterator[str]:
    """Headers as they include each other, then the rest."""
    seen: set[str] = set()

    def walk(name: str) -> Iterator[str]:
        if name in files and name not in seen:
            seen.add(name)
            if name.endswith(".h"):
                for inner in re.findall(rb'^#include "([^"]+)"', files[name], re.M):
                    yield from walk(inner.decode())
            yield name

    for name in sorted(files, key=lambda name: (not name.endswith(".h"), name)):
        yield from walk(name)


def _statements(text: str) -> Iterator[str]:
    """What stands outside of functions, each up to its semicolon; whitespace as one blank."""
    text = re.sub(r'extern "C" \{', "", re.sub(r"#ifdef __cplusplus\n\}\n#endif", "", text))
    text = re.sub(r"^#(?:[^\n]*\\\n)*[^\n]*$", "", text, flags=re.M)
    depth, begin = 0, 0
    for found in re.finditer(r"[{};]", text):
        depth += {"{": 1, "}": -1, ";": 0}[found[0]]
        statement = " ".join(text[begin : found.end()].split())
        if depth == 0 and found[0] == ";" and statement != ";":
            yield statement
        if depth == 0 and (
            found[0] == ";"
            or (found[0] == "}" and not re.match(r"typedef|struct|enum|union|static const", statement))
        ):
            begin = found.end()


def _numbers(text: str, known: Mapping[str, int]) -> dict[str, int]:
    """The integer macros of a file."""
    found = dict(known)
    for name, body in _DEFINE.findall(text):
        value = _value(body, found)
        if isinstance(value, int):
            found[name] = value
    return found


def _dimensioned(statement: str, known: Mapping[str, int]) -> str:
    """The statement with a number in each pair of brackets."""
    return re.sub(r"\[([^]]+)\]", lambda found: f"[{_value(found[1], known)}]", statement)


def _value(expression: str, known: Mapping[str, int]) -> int | str:
    """The value of an expression of integers; the expression itself if it is none."""
    plain = _NUMBER.sub(
        r"\1", re.sub(r"\b[A-Z]\w+\b", lambda word: str(known.get(word[0], word[0])), expression)
    )
    if re.fullmatch(r"[\d\s()+*/-]+|0x[0-9a-fA-F]+", plain) is None:
        return expression
    try:
        return int(eval(plain.replace("/", "//"), {"__builtins__": {}}))
    except SyntaxError:
        return expression
