"""The link over Bluetooth LE: the Nordic UART Service with bleak, in a thread with its own event loop.

What goes wrong is a ``WireError`` with its cause and what to do: adapter, permission, robot or firmware.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from dataclasses import dataclass
from typing import NoReturn

from bleak import BleakClient, BleakScanner
from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import AdvertisementData
from bleak.exc import (
    BleakBluetoothNotAvailableError,
    BleakBluetoothNotAvailableReason,
    BleakCharacteristicNotFoundError,
    BleakDBusError,
    BleakError,
    BleakGATTProtocolError,
    BleakGATTProtocolErrorCode,
)

from frogkick.core.errors import printable
from frogkick.link.frames import DELIMITER
from frogkick.link.wire import Delivery, Wire, WireError

SERVICE = "6e400001-b5a3-f393-e0a9-e50e24dcca9e"
RECEIVE = "6e400002-b5a3-f393-e0a9-e50e24dcca9e"
"""The robot receives here."""
TRANSMIT = "6e400003-b5a3-f393-e0a9-e50e24dcca9e"

SCAN_S = 10.0
LOOK_ROUND_S = 1.0  # for a second robot of the same name: robots advertise at least every 0.15 s
CONNECT_S = 10.0
CONNECT_TRIES = 3
FIXES_WAITING = 2
"""Number of position fixes that wait for the radio; an older one is dropped."""
_AGAIN_S = 0.05
_Queue = asyncio.Queue[tuple[bytes, bool]]  # frames, and whether the radio acknowledges them
_PART_MIN = 20  # bytes that every Bluetooth device takes at once
_DEFINITE = (
    BleakGATTProtocolErrorCode.INSUFFICIENT_AUTHENTICATION,
    BleakGATTProtocolErrorCode.INSUFFICIENT_AUTHORIZATION,
    BleakGATTProtocolErrorCode.INSUFFICIENT_ENCRYPTION,
)


@dataclass(frozen=True)
class Heard:
    """A robot that advertises."""

    name: str  # advertised name, or ""
    address: str  # its address on this computer
    signal_dbm: int  # strength of the last advertisement


def _name(device: BLEDevice, advertised: AdvertisementData) -> str:
    return printable(advertised.local_name or device.name or "")


def listen(scan_s: float) -> list[Heard]:
    """Robots that advertise within a time, the strongest first, without connecting to them."""
    seen: dict[str, Heard] = {}
    failed: list[Exception] = []

    def heard(device: BLEDevice, advertised: AdvertisementData) -> None:
        seen[device.address] = Heard(_name(device, advertised), device.address, advertised.rssi)

    async def live() -> None:
        async with BleakScanner(heard, service_uuids=[SERVICE]):
            await asyncio.sleep(scan_s)

    def run() -> None:
        try:
            asyncio.run(live())
        except Exception as error:
            failed.append(error)

    # In another thread, as a notebook's event loop runs in this one.
    thread = threading.Thread(target=run, name="listen", daemon=True)
    thread.start()
    thread.join()
    if failed:
        raise explained(failed[0], "a robot") from failed[0]
    return sorted(seen.values(), key=lambda robot: (-robot.signal_dbm, robot.address))


class BleWire(Wire):
    """A wire over Bluetooth. A robot that drops out is found again by its address and reconnected."""

    window = 4  # frames: the robot's receive buffer holds six

    def __init__(
        self,
        place: str,
        scan_s: float = SCAN_S,
        greeting: bytes = DELIMITER,
    ) -> None:
        """Find the robot by its advertised name or its address, within ``scan_s``, and connect.

        ``greeting`` is sent at each connection; a delimiter ends what a partial frame has left in the robot's
        receiver.
        """
        super().__init__()
        self.name = f"ble:{place}"
        self._place, self._scan_s = place, scan_s
        self._greeting = greeting
        self.address: str | None = None  # the robot's on this computer
        self.part_bytes = 0  # bytes in one write, as negotiated
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop = asyncio.Event()
        self._commands: _Queue = asyncio.Queue()
        self._fixes: _Queue = asyncio.Queue()
        self._urgent: _Queue = asyncio.Queue()
        self._urgents = 0  # number of them so far
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()
        try:
            while not (self.wait_up(1.0) or self.connections):
                continue
        except BaseException:
            self.close()
            raise

    @property
    def place(self) -> str:
        return f"ble:{self.address}"

    def send(self, encoded: bytes, how: Delivery) -> None:
        """Send a frame; only the newest fixes wait for the radio."""
        if self._loop is not None and self.is_up:
            with contextlib.suppress(RuntimeError):  # the loop has just ended
                self._loop.call_soon_threadsafe(self._queue, encoded, how)

    def close(self) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(CONNECT_S)

    def _queue(self, encoded: bytes, how: Delivery) -> None:
        if how is Delivery.URGENT:
            self._urgents += 1
            for queue in (self._commands, self._fixes):
                while not queue.empty():
                    queue.get_nowait()
            # The delimiter ends a frame of which not all parts are written yet.
            self._urgent.put_nowait((DELIMITER + encoded, False))
            return
        if how is not Delivery.NEWEST:
            self._commands.put_nowait((encoded, how is Delivery.ACKNOWLEDGED))
            return
        self._fixes.put_nowait((encoded, False))
        while self._fixes.qsize() > FIXES_WAITING:
            self._fixes.get_nowait()

    def _run(self) -> None:
        try:
            asyncio.run(self._live())
        except Exception as error:
            self.lost(explained(error, self._place))

    async def _live(self) -> None:
        self._loop = asyncio.get_running_loop()
        tries, deadline_s = CONNECT_TRIES, 0.0
        while not self._stop.is_set():
            connections = self.connections
            error: Exception | None = None
            try:
                await self._converse(await self._find())
            except Exception as raised:
                error = raised
            if self.connections > connections:
                deadline_s = time.monotonic() + self.reconnect_s
            if error is None:
                continue
            tries -= 1
            why = explained(error, self._place)
            is_first = self.connections == 0
            if is_definite(error, is_first) or (is_first and tries <= 0):
                raise why from error
            if not is_first and time.monotonic() > deadline_s:
                raise WireError(f"{self.name} dropped out for {self.reconnect_s:g} s: {why}") from error
            await asyncio.sleep(_AGAIN_S)

    async def _find(self) -> BLEDevice:
        seen: dict[str, tuple[BLEDevice, str]] = {}
        wanted = (self.address or self._place).lower()
        found = asyncio.Event()

        def addressed() -> list[BLEDevice]:
            return [device for device, _ in seen.values() if device.address.lower() == wanted]

        def named() -> list[BLEDevice]:
            """Only until the address is known."""
            return [device for device, name in seen.values() if name == self._place and not self.address]

        def heard(device: BLEDevice, advertised: AdvertisementData) -> None:
            seen[device.address] = (device, _name(device, advertised))
            if addressed() or named():
                found.set()

        async with BleakScanner(heard, service_uuids=[SERVICE]):
            stop = asyncio.create_task(self._stop.wait())
            look = asyncio.create_task(found.wait())
            await asyncio.wait({stop, look}, timeout=self._scan_s, return_when=asyncio.FIRST_COMPLETED)
            stop.cancel()
            look.cancel()
            if found.is_set() and not addressed():
                await asyncio.sleep(LOOK_ROUND_S)
        if len(choice := addressed()[:1] or named()) > 1:
            addresses = sorted(device.address for device in choice)
            raise _Definite(
                f"{len(choice)} robots are called {self._place!r} ({', '.join(addresses)}): switch the "
                f"others off, or give the address, as --robot ble:{addresses[0]}"
            )
        if choice:
            return choice[0]
        others = sorted({name or device.address for device, name in seen.values()})
        raise _NotFound(
            f"no robot {self._place!r} advertises within {self._scan_s:g} s (heard: "
            f"{', '.join(others) or 'none'}): switch it on, charge it, bring it nearer, and disconnect other "
            "hosts from it"
        )

    async def _converse(self, device: BLEDevice) -> None:
        """Connect, and exchange frames until the connection drops or closes."""
        gone = asyncio.Event()
        client = BleakClient(device, disconnected_callback=lambda _client: gone.set(), timeout=CONNECT_S)
        tasks: list[asyncio.Task[object]] = []
        try:
            await client.connect()
            receiver = client.services.get_characteristic(RECEIVE)
            if receiver is None:
                raise BleakCharacteristicNotFoundError(RECEIVE)
            await client.start_notify(TRANSMIT, lambda _from, data: self.put(bytes(data)))
            self._commands, self._fixes, self._urgent = asyncio.Queue(), asyncio.Queue(), asyncio.Queue()
            self._commands.put_nowait((self._greeting, True))
            self.address = device.address
            self.part_bytes = max(_PART_MIN, receiver.max_write_without_response_size)
            unmixed = asyncio.Lock()
            tasks = [
                asyncio.create_task(self._write(client, receiver, self._commands, unmixed)),
                asyncio.create_task(self._write(client, receiver, self._fixes, unmixed)),
                asyncio.create_task(self._write(client, receiver, self._urgent, asyncio.Lock())),
                asyncio.create_task(gone.wait()),
                asyncio.create_task(self._stop.wait()),
            ]
            self.connected()
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            self.lost()
            for task in tasks:
                task.cancel()
            with contextlib.suppress(Exception):  # it may be gone already
                await client.disconnect()

    async def _write(
        self,
        client: BleakClient,
        receiver: BleakGATTCharacteristic,
        queue: _Queue,
        unmixed: asyncio.Lock,
    ) -> NoReturn:
        """Write the frames of a queue in parts of the negotiated length, without mixing two frames.

        What is left of a frame when an urgent one comes is not written any more.
        """
        while True:
            encoded, acknowledged = await queue.get()
            urgents = self._urgents
            size = self.part_bytes = max(_PART_MIN, receiver.max_write_without_response_size)
            async with unmixed:
                if len(encoded) > size:
                    for first in range(0, len(encoded), size):
                        if urgents != self._urgents:
                            break
                        part = encoded[first : first + size]
                        await client.write_gatt_char(receiver, part, response=acknowledged)
                    continue
            # Others need not wait for the acknowledgement of a frame in one write.
            if urgents == self._urgents:
                await client.write_gatt_char(receiver, encoded, response=acknowledged)


class _Definite(WireError):
    """An error that another try would not remove."""


class _NotFound(WireError):
    """No such robot advertises."""


def is_definite(error: Exception, is_first: bool) -> bool:
    """Whether another try would not help. A robot that was connected before may be heard again."""
    if isinstance(error, _NotFound):
        return is_first
    if isinstance(error, BleakGATTProtocolError):
        return error.code in _DEFINITE
    return isinstance(
        error,
        _Definite
        | BleakBluetoothNotAvailableError
        | BleakCharacteristicNotFoundError
        | PermissionError
        | FileNotFoundError,
    )


def explained(error: Exception, place: str) -> WireError:
    """The cause in one line (adapter, permission, robot or firmware), with what to do."""
    if isinstance(error, WireError):
        return error
    reasons = BleakBluetoothNotAvailableReason
    reason = error.reason if isinstance(error, BleakBluetoothNotAvailableError) else None
    dbus = error.dbus_error if isinstance(error, BleakDBusError) else ""
    if reason is reasons.POWERED_OFF or dbus.endswith("NotReady"):
        text = "Bluetooth is switched off here: switch it on ('bluetoothctl power on' on Linux)"
    elif (
        reason in (reasons.DENIED_BY_USER, reasons.DENIED_BY_SYSTEM, reasons.DENIED_BY_UNKNOWN)
        or isinstance(error, PermissionError)
        or dbus.endswith("AccessDenied")
    ):
        text = (
            "no permission for Bluetooth here: allow it for this program (Linux: group bluetooth, then log "
            f"in again; macOS, Windows: privacy settings) ({error.args[0] if error.args else error})"
        )
    elif reason is not None:
        text = f"no Bluetooth adapter that could talk with a robot here ({error.args[0]}): plug one in"
    elif isinstance(error, FileNotFoundError | ConnectionError) or dbus.endswith("ServiceUnknown"):
        text = f"no Bluetooth service runs here ({error}): install and start it (Linux: bluez, 'bluetoothd')"
    elif isinstance(error, BleakCharacteristicNotFoundError):
        text = f"{place!r} has no Nordic UART Service, so it has other firmware: flash it"
    elif isinstance(error, BleakGATTProtocolError) and error.code in _DEFINITE:
        text = (
            f"{place!r} wants pairing: pair with it in the system's Bluetooth settings; the passkey stands "
            "on the robot and on its console"
        )
    elif isinstance(error, TimeoutError):
        text = f"{place!r} advertises and takes no connection within {CONNECT_S:g} s: bring it nearer"
    elif isinstance(error, BleakError):
        text = f"Bluetooth with {place!r} failed ({error}): bring it nearer, switch it off and on"
    else:
        text = f"Bluetooth failed ({type(error).__name__}: {error}): switch it off and on"
    return WireError(text)
