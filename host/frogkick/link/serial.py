"""The link over a serial line: a development kit's USB port, or an adapter at the robot's UART.

A port that does not open is a ``WireError``.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import threading
import time
from typing import Any

from frogkick.link.frames import DELIMITER
from frogkick.link.wire import BAUD, Delivery, Wire, WireError

_AGAIN_S = 0.1
_READ_S = 0.05
_WRITE_S = 1.0


class SerialWire(Wire):
    """A wire over a serial port, which is opened again when a pulled cable is back."""

    window = 1  # a chip that erases flash receives no more than a buffer meanwhile

    def __init__(self, port: str, baud: int = BAUD, greeting: bytes = DELIMITER) -> None:
        """Open a port (``/dev/ttyACM0``, ``COM3``) with ``baud`` bits per second.

        ``greeting`` is sent at each connection; a delimiter ends what noise has left in the robot's receiver.
        """
        super().__init__()
        self.name = f"serial:{port}"
        self._port, self._baud, self._greeting = port, baud, greeting
        self._serial = importlib.import_module("serial")
        self._closing = threading.Event()
        self._write_lock = threading.Lock()
        self._line: Any = self._open()
        self.connected()
        self._thread = threading.Thread(target=self._live, name=self.name, daemon=True)
        self._thread.start()

    def send(self, encoded: bytes, how: Delivery) -> None:
        """Send a frame; it is lost while the line is down."""
        line = self._line
        # Errors are left to the reading thread, which opens the port again.
        with self._write_lock, contextlib.suppress(self._serial.SerialException, OSError, TypeError):
            if line is not None:
                # The delimiter ends a frame that was cut off when the line was too slow.
                line.write(DELIMITER + encoded if how is Delivery.URGENT else encoded)

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
        line, self._line = self._line, None
        if line is not None:
            with contextlib.suppress(self._serial.SerialException, OSError):
                line.close()

    def _open(self) -> Any:
        try:
            line = self._serial.Serial(
                self._port, self._baud, timeout=_READ_S, write_timeout=_WRITE_S, exclusive=True
            )
            line.write(self._greeting)
        except (self._serial.SerialException, OSError, ValueError) as error:
            raise WireError(_account(self._port, error)) from error
        return line

    def _live(self) -> None:
        while not self._closing.is_set():
            try:
                data = self._line.read(max(1, self._line.in_waiting))
            # A pulled cable is an OSError on some systems, a TypeError on others.
            except (self._serial.SerialException, OSError, TypeError):
                self.lost()
                if not self._open_again():
                    return
                self.connected()
                continue
            if data:
                self.put(bytes(data))

    def _open_again(self) -> bool:
        line, self._line = self._line, None
        with contextlib.suppress(self._serial.SerialException, OSError):
            line.close()
        deadline_s = time.monotonic() + self.reconnect_s
        while not self._closing.wait(_AGAIN_S):
            try:
                self._line = self._open()
                return True
            except WireError as error:
                if time.monotonic() > deadline_s:
                    self.lost(WireError(f"{self.name} went away for {self.reconnect_s:g} s: {error}"))
                    return False
        return False


def ports() -> list[str]:
    """Names of the serial ports of this computer."""
    return sorted(port.device for port in importlib.import_module("serial.tools.list_ports").comports())


def _account(port: str, error: Exception) -> str:
    """The error in one line, with what to do."""
    code, text = getattr(error, "errno", None), str(error).lower()
    if code == errno.EBUSY or "lock" in text:
        return f"serial port {port!r} is in use by another program: close that one (a terminal, another run)"
    if code == errno.EACCES or "access is denied" in text:
        return (
            f"no permission for serial port {port!r}: on Linux add yourself to its group (sudo usermod -aG "
            "dialout $USER, then log in again); on Windows close the program that has it open"
        )
    if code in (errno.ENOENT, errno.ENXIO, errno.ENODEV) or "cannot find" in text:
        there = ", ".join(ports()) or "none"
        return f"serial port {port!r} is not there (ports here: {there}): plug it in or name another"
    if "configure" in text or code == errno.ENOTTY:
        return f"{port!r} is not a serial port: give one, as /dev/ttyACM0 (ports here: {', '.join(ports())})"
    return f"serial port {port!r} does not open: {error}"
