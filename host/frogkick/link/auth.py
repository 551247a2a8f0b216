"""The host's side of an authenticated conversation with a robot that has an owner's key.

The protocol is described in ``firmware/core/fk_auth.h``. Codes are HMAC-SHA-256 (RFC 2104), cut to 8 bytes.

A file that is no key, or cannot be read or written, is an ``InputError``.
"""

from __future__ import annotations

import hmac
import os
import secrets
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from frogkick.core.errors import InputError

KEY_BYTES = 32
NONCE_BYTES = 16
CODE_BYTES = 8
TRAILER_BYTES = 4 + CODE_BYTES
_OF_ROBOT = b"frogkick robot".ljust(16, b"\0")
_OF_COMMAND = b"frogkick command"


def _code(key: bytes, *parts: bytes) -> bytes:
    return hmac.digest(key, b"".join(parts), "sha256")


@dataclass
class CommandCodes:
    """Authentication codes of commands, once the robot has proved that it has the key."""

    key: bytes = field(repr=False)
    counter: int = 0

    def code(self, number: int, sequence: int, payload: bytes) -> bytes:
        """Counter and code of the next command, which follow its payload.

        ``number`` is the frame's type with ``AUTH_BIT``, ``sequence`` its sequence number.
        """
        self.counter += 1
        counter = struct.pack("<I", self.counter)
        return counter + _code(self.key, bytes([number, sequence]), payload, counter)[:CODE_BYTES]


def challenge() -> bytes:
    """Random bytes that a robot is to answer for, fresh for each connection."""
    return secrets.token_bytes(NONCE_BYTES)


def words(name: str, content: bytes) -> dict[str, int | float | str]:
    """Bytes as little-endian words in the fields ``name_0``, ``name_1`` and so on."""
    return {f"{name}_{i}": word for i, (word,) in enumerate(struct.iter_unpack("<I", content))}


def from_words(name: str, values: Mapping[str, int | float | str], count: int) -> bytes:
    """The inverse of ``words``, for a number of words."""
    return struct.pack(f"<{count}I", *(int(values[f"{name}_{i}"]) for i in range(count)))


def begin(key: bytes, host_nonce: bytes, answer: Mapping[str, int | float | str]) -> CommandCodes | None:
    """Codes after a robot's answer to CHALLENGE; None if the robot has another key."""
    nonces = host_nonce + from_words("nonce", answer, 4)
    proof = _code(key, _OF_ROBOT, nonces)[:16]
    if not hmac.compare_digest(proof, from_words("proof", answer, 4)):
        return None
    return CommandCodes(_code(key, _OF_COMMAND, nonces))


def default_key_file() -> Path:
    """The file of the owner's key of this user."""
    home = os.environ.get("XDG_CONFIG_HOME") or os.environ.get("APPDATA")
    return (Path(home) if home else Path.home() / ".config") / "frogkick" / "owner.key"


def read_key(file: Path) -> bytes:
    """An owner's key from its file: 64 hexadecimal digits.

    Raises:
        InputError: there is no such file, or it does not hold a key.
    """
    try:
        text = file.read_text(encoding="ascii").strip()
        key = bytes.fromhex(text)
    except FileNotFoundError:
        raise InputError(f"no owner's key in {str(file)!r}: make one with 'frogkick own'") from None
    except OSError as error:
        raise InputError(
            f"owner's key {str(file)!r} cannot be read: {error.strerror}; check the path"
        ) from error
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES or not any(key):
        raise InputError(
            f"{str(file)!r} is not an owner's key: a key is 64 hexadecimal digits, not all zero; give the "
            "file that 'frogkick own' wrote"
        )
    return key


def make_key(file: Path) -> bytes:
    """Make an owner's key and write it to a file that only this user may read.

    Raises:
        InputError: the file exists already or cannot be written.
    """
    key = secrets.token_bytes(KEY_BYTES)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        number = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(number, "w", encoding="ascii") as stream:
            stream.write(key.hex() + "\n")
    except OSError as error:
        raise InputError(f"owner's key {str(file)!r} cannot be written: {error}") from error
    return key
