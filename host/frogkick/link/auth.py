"""The host's side of an authenticated conversation with a robot that has an owner's key.

The protocol is described in ``firmware/core/fk_auth.h``. Codes are HMAC-SHA-256 (RFC 2104), cut to 8 bytes.

A key file has a line for each key: 64 hexadecimal digits, and after a space where the robot with this key
is. Each robot gets a key of its own, as a first key travels in the clear and must not open another robot.

A file that is no key, or cannot be read or written, is an ``InputError``.
"""

from __future__ import annotations

import hmac
import os
import secrets
import struct
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from frogkick.core.errors import InputError
from frogkick.link.layout import AUTH_BIT, link_layout

KEY_BYTES = 32
NONCE_BYTES = 16
CODE_BYTES = 8
TRAILER_BYTES = 4 + CODE_BYTES
_OF_ROBOT = b"frogkick robot".ljust(16, b"\0")
_OF_COMMAND = b"frogkick command"


def _code(key: bytes, *parts: bytes) -> bytes:
    return hmac.digest(key, b"".join(parts), "sha256")


@dataclass(frozen=True)
class OwnerKey:
    """A line of a key file."""

    secret: bytes = field(repr=False)
    place: str = ""  # of the robot that has it, as ``Wire.place``; "": unknown, or it was released


@dataclass
class CommandCodes:
    """Authentication codes of commands, once the robot has proved that it has the key."""

    key: bytes = field(repr=False)
    counter: int = 0  # of the last command other than FIX
    fix_counter: int = 0  # of the last FIX

    def code(self, number: int, sequence: int, payload: bytes) -> bytes:
        """Counter and code of the next command, which follow its payload.

        ``number`` is the frame's type with ``AUTH_BIT``, ``sequence`` its sequence number.
        """
        is_fix = number == link_layout().messages["FIX"].id | AUTH_BIT
        self.fix_counter += is_fix
        self.counter += not is_fix
        counter = struct.pack("<I", self.fix_counter if is_fix else self.counter)
        return counter + _code(self.key, bytes([number, sequence]), payload, counter)[:CODE_BYTES]


def challenge() -> bytes:
    """Random bytes that a robot is to answer for, fresh for each conversation."""
    return secrets.token_bytes(NONCE_BYTES)


def words(name: str, content: bytes) -> dict[str, int | float | str]:
    """Bytes as little-endian words in the fields ``name_0``, ``name_1`` and so on."""
    return {f"{name}_{i}": word for i, (word,) in enumerate(struct.iter_unpack("<I", content))}


def from_words(name: str, values: Mapping[str, int | float | str], count: int) -> bytes:
    """The inverse of ``words``, for a number of words."""
    return struct.pack(f"<{count}I", *(int(values[f"{name}_{i}"]) for i in range(count)))


def begin(key: bytes, host_nonce: bytes, answer: Mapping[str, int | float | str]) -> CommandCodes | None:
    """Codes after a robot's answer to CHALLENGE; None if the robot has another key."""
    robot_nonce = from_words("nonce", answer, 4)
    proof = _code(key, _OF_ROBOT, host_nonce, robot_nonce)[:16]
    if not hmac.compare_digest(proof, from_words("proof", answer, 4)):
        return None
    return CommandCodes(_code(key, _OF_COMMAND, robot_nonce))


def default_key_file() -> Path:
    """The file of this user's keys."""
    home = os.environ.get("XDG_CONFIG_HOME") or os.environ.get("APPDATA")
    return (Path(home) if home else Path.home() / ".config") / "frogkick" / "owner.key"


def read_keys(file: Path) -> list[OwnerKey]:
    """The keys in a file.

    Raises:
        InputError: there is no such file, or it holds anything else.
    """
    keys = []
    try:
        for line in file.read_text(encoding="utf-8", errors="surrogateescape").split("\n"):
            digits, _, place = line.strip().partition(" ")
            if digits:
                keys.append(OwnerKey(bytes.fromhex(digits), place.strip()))
    except FileNotFoundError:
        raise InputError(f"no owner's key in {str(file)!r}: make one with 'frogkick own'") from None
    except OSError as error:
        raise InputError(
            f"owner's key {str(file)!r} cannot be read: {error.strerror}; check the path"
        ) from error
    except ValueError:
        keys = []
    if not keys or any(len(key.secret) != KEY_BYTES or not any(key.secret) for key in keys):
        raise InputError(
            f"{str(file)!r} is not an owner's key: a key is 64 hexadecimal digits, not all zero, and after a "
            "space in its line stands where its robot is; give the file that 'frogkick own' wrote"
        )
    return keys


def new_key(file: Path) -> OwnerKey:
    """Make a key, and add it to a file that only this user may read.

    Raises:
        InputError: the file holds anything else than keys, or cannot be written.
    """
    key = OwnerKey(secrets.token_bytes(KEY_BYTES))
    _write_keys(file, [*(read_keys(file) if file.exists() else []), key])
    return key


def note_place(file: Path, place: str, owner: OwnerKey | None) -> None:
    """Note in a key file that the robot at a place has a key of it, or that it has none.

    Raises:
        InputError: the file cannot be read or written.
    """

    def noted(key: OwnerKey) -> OwnerKey:
        if owner is None:
            return replace(key, place="") if key.place == place else key
        return replace(key, place=place) if key.secret == owner.secret else key

    before = read_keys(file)
    keys = [noted(key) for key in before]
    if place and keys != before:
        _write_keys(file, keys)


def _write_keys(file: Path, keys: Sequence[OwnerKey]) -> None:
    """Write the file completely or not at all."""
    final, name = file.resolve(), ""
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        number, name = tempfile.mkstemp(prefix=f".{final.name}.", dir=final.parent)  # for this user alone
        with os.fdopen(number, "w", encoding="utf-8", errors="surrogateescape", newline="\n") as stream:
            stream.writelines(f"{key.secret.hex()} {key.place}".strip() + "\n" for key in keys)
            stream.flush()
            os.fsync(number)
        os.replace(name, final)
    except OSError as error:
        with suppress(OSError):
            os.unlink(name)
        raise InputError(f"owner's key {str(file)!r} cannot be written: {error}") from error
