"""Robots that advertise and hold conversations on virtual Bluetooth controllers, and bleak's way to them.

bleak's own scanner and client are what is tested. Below them stands bumble's host stack instead of the
operating system's, on a controller of its own: advertising, connecting, ATT, MTU and GATT happen for real,
packet by packet. No radio is modelled: nothing is lost between controllers, and there are no connection
intervals. A virtual controller answers a scan with the advertisement again and not with the scan response,
where the firmware has its name: here it stands in the advertisement. Nobody pairs here.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import bleak
import pytest
from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.client import BaseBleakClient, NotifyCallback
from bleak.backends.scanner import AdvertisementData, BaseBleakScanner
from bleak.backends.service import BleakGATTService, BleakGATTServiceCollection
from bleak.exc import BleakDeviceNotFoundError, BleakError, BleakGATTProtocolError
from bumble import att, core, gatt, hci
from bumble.controller import Controller
from bumble.device import Advertisement, Device, Peer
from bumble.host import Host
from bumble.link import LocalLink
from bumble.transport.common import AsyncPipeSink

from frogkick.link.ble import RECEIVE, SERVICE, TRANSMIT
from frogkick.link.pty_line import Listener

ADVERTISING_MS = 20.0
MTU = 247
_numbers = itertools.count(1)


def _device(link: LocalLink, name: str, address: str) -> Device:
    controller = Controller(name, link=link)
    return Device(name, hci.Address(address), host=Host(controller, AsyncPipeSink(controller)))


@dataclass
class Peripheral:
    """A robot on a radio.

    Attributes:
        robot: takes the bytes; None: it answers nothing.
        name: its advertised name.
        mtu: largest MTU of its radio.
        has_characteristics: whether it has the service that it advertises.
        wants_pairing: whether it refuses writes without pairing.
        asleep: whether it does not advertise.
        written: length of each write.
        connections: number of connections so far.
    """

    robot: Listener | None
    name: str = "frogkick"
    mtu: int = MTU
    has_characteristics: bool = True
    wants_pairing: bool = False
    asleep: bool = False
    written: list[int] = field(default_factory=list)
    connections: int = 0
    address: str = field(default_factory=lambda: f"C0:00:00:00:00:{next(_numbers):02X}")

    async def start(self, link: LocalLink) -> None:
        """Switch the radio on, in the running loop."""
        self.device = _device(link, self.name, self.address)
        permissions = att.Attribute.Permissions.WRITEABLE
        if self.wants_pairing:
            permissions |= att.Attribute.Permissions.WRITE_REQUIRES_AUTHENTICATION
        flags = gatt.Characteristic.Properties
        self._transmit: Any = gatt.Characteristic(TRANSMIT, flags.NOTIFY, att.Attribute.Permissions(0), b"")
        receive: Any = gatt.Characteristic(
            RECEIVE, flags.WRITE | flags.WRITE_WITHOUT_RESPONSE, permissions,
            gatt.CharacteristicValue(write=self._on_write),
        )  # fmt: skip
        held = [self._transmit, receive] if self.has_characteristics else []
        self.device.add_service(gatt.Service(SERVICE, held))
        self.device.gatt_server.max_mtu = self.mtu
        self.device.on("connection", self._on_connection)
        await self.device.power_on()
        self._ticking = asyncio.create_task(self._tick())
        if not self.asleep:
            await self.advertise()

    async def advertise(self) -> None:
        """Be heard, and again after each connection."""
        kinds = core.AdvertisingData.Type
        await self.device.start_advertising(
            auto_restart=True,
            advertising_data=bytes(
                core.AdvertisingData(
                    [
                        (kinds.FLAGS, b"\x06"),
                        (kinds.COMPLETE_LIST_OF_128_BIT_SERVICE_CLASS_UUIDS, bytes(core.UUID(SERVICE))),
                        (kinds.COMPLETE_LOCAL_NAME, self.name.encode()),
                    ]
                )
            ),
            advertising_interval_min=ADVERTISING_MS,
            advertising_interval_max=ADVERTISING_MS,
        )

    async def drop(self) -> None:
        """Cut the connection, as a robot does that goes under."""
        for connection in list(self.device.connections.values()):
            with contextlib.suppress(core.BaseBumbleError, hci.HCI_Error):
                await connection.disconnect()

    def _on_connection(self, connection: Any) -> None:
        self.connections += 1

    def _on_write(self, connection: Any, value: bytes) -> None:
        self.written.append(len(value))
        if self.robot is not None:
            self._send(self.robot.feed(value))

    def _send(self, stream: bytes) -> None:
        for connection in list(self.device.connections.values()):
            size = connection.att_mtu - 3
            for first in range(0, len(stream), size):
                part = stream[first : first + size]
                Air.keep(self.device.gatt_server.notify_subscriber(connection, self._transmit, part))

    async def _tick(self) -> None:
        while self.robot is not None:
            self._send(self.robot.tick())
            await asyncio.sleep(self.robot.sleep_s)


class Air:
    """The virtual radio between robots and host. It lives in the event loop of the first scan.

    Attributes:
        writes: the host's writes: bytes, and whether with response.
    """

    now: ClassVar[Air]
    _kept: ClassVar[set[asyncio.Task[None]]] = set()

    def __init__(self, *robots: Peripheral) -> None:
        self.robots = list(robots)
        self.writes: list[tuple[bytes, bool]] = []
        self.loop: asyncio.AbstractEventLoop | None = None

    @classmethod
    def keep(cls, coroutine: Any) -> None:
        """Run a task to its end."""
        task = asyncio.ensure_future(coroutine)
        cls._kept.add(task)
        task.add_done_callback(cls._kept.discard)

    async def ensure(self) -> None:
        """All radios are on, in the running loop."""
        if self.loop is asyncio.get_running_loop():
            return
        self.loop = asyncio.get_running_loop()
        self.link = LocalLink()
        self.central = _device(self.link, "host", f"F0:00:00:00:00:{next(_numbers):02X}")
        await self.central.power_on()
        for robot in self.robots:
            await robot.start(self.link)

    def call(self, make: Callable[[], Any]) -> None:
        """Run a coroutine in the loop, from another thread, and wait for it."""
        assert self.loop is not None
        asyncio.run_coroutine_threadsafe(make(), self.loop).result(10.0)


class VirtualScanner(BaseBleakScanner):
    """bleak's scanner, over a virtual controller."""

    def __init__(self, callback: Any, service_uuids: Any, _mode: str, **_options: Any) -> None:
        super().__init__(callback, service_uuids)

    async def start(self) -> None:
        await Air.now.ensure()
        self.seen_devices = {}
        Air.now.central.on("advertisement", self._heard)
        await Air.now.central.start_scanning(filter_duplicates=False)

    async def stop(self) -> None:
        Air.now.central.remove_listener("advertisement", self._heard)
        await Air.now.central.stop_scanning()

    def _heard(self, heard: Advertisement) -> None:
        kinds = core.AdvertisingData.Type
        name = heard.data.get(kinds.COMPLETE_LOCAL_NAME)
        uuids = heard.data.get(kinds.COMPLETE_LIST_OF_128_BIT_SERVICE_CLASS_UUIDS) or []
        services = [str(uuid.to_hex_str("-")).lower() for uuid in uuids]
        if not self.is_allowed_uuid(services):
            return
        address = heard.address.to_string(False)
        data = AdvertisementData(name, {}, {}, services, None, heard.rssi, ())
        device = self.create_or_update_device(address, address, name, heard.address, data)
        self.call_detection_callbacks(device, data)


class VirtualClient(BaseBleakClient):
    """bleak's client, over a virtual controller."""

    def __init__(self, address_or_device: Any, **options: Any) -> None:
        super().__init__(address_or_device, **options)
        self._details = getattr(address_or_device, "details", None)
        self._connection: Any = None
        self._subscribed: dict[int, NotifyCallback] = {}

    @property
    def name(self) -> str:
        return str(self.address)

    @property
    def mtu_size(self) -> int:
        return int(self._connection.att_mtu)

    @property
    def is_connected(self) -> bool:
        return self._connection is not None

    async def connect(self, pair: bool, **_options: Any) -> None:
        try:
            connection = await Air.now.central.connect(self._details, timeout=self._timeout)
        except core.TimeoutError as error:
            raise TimeoutError from error
        except core.BaseBumbleError as error:
            raise BleakDeviceNotFoundError(self.address, str(error)) from error
        self._connection = connection
        connection.on("disconnection", self._on_disconnection)
        try:
            self._peer = Peer(connection)
            await self._peer.request_mtu(MTU)
            await self._peer.discover_services()
            services = BleakGATTServiceCollection()
            for service in self._peer.services:
                await service.discover_characteristics()
                ours = BleakGATTService(service, service.handle, str(service.uuid.to_hex_str("-")).lower())
                services.add_service(ours)
                for one in service.characteristics:
                    await one.discover_descriptors()
                    flags = gatt.Characteristic.Properties
                    names = {flags.WRITE: "write", flags.NOTIFY: "notify"} | {
                        flags.WRITE_WITHOUT_RESPONSE: "write-without-response"
                    }
                    properties: Any = [text for flag, text in names.items() if flag & one.properties]
                    services.add_characteristic(
                        BleakGATTCharacteristic(
                            one, one.handle, str(one.uuid.to_hex_str("-")).lower(), properties,
                            lambda: self.mtu_size - 3, ours,
                        )
                    )  # fmt: skip
        except (core.BaseBumbleError, att.ATT_Error, asyncio.CancelledError) as error:
            if self._connection is None:
                raise BleakError("failed to discover services, device disconnected") from error
            raise
        self.services = services

    def _on_disconnection(self, _reason: int) -> None:
        self._connection = None
        if self._disconnected_callback is not None:
            self._disconnected_callback()

    async def disconnect(self) -> None:
        if self._connection is not None:
            await self._connection.disconnect()

    async def write_gatt_char(self, characteristic: Any, data: Any, response: bool) -> None:
        if self._connection is None:
            raise BleakError("Not connected")
        Air.now.writes.append((bytes(data), response))
        try:
            await characteristic.obj.write_value(bytes(data), with_response=response)
        except att.ATT_Error as error:
            raise BleakGATTProtocolError(error.error_code) from error
        except asyncio.CancelledError as error:
            if self._connection is None:
                raise BleakError("Not connected") from error
            raise

    async def start_notify(self, characteristic: Any, callback: NotifyCallback, **_options: Any) -> None:
        try:
            await characteristic.obj.subscribe(lambda value: callback(bytearray(value)))
        except asyncio.CancelledError as error:
            if self._connection is None:
                raise BleakError("Not connected") from error
            raise

    async def stop_notify(self, characteristic: Any) -> None:
        await characteristic.obj.unsubscribe()

    async def pair(self, *_options: Any, **_more: Any) -> None:
        raise NotImplementedError

    async def unpair(self) -> None:
        raise NotImplementedError

    async def read_gatt_char(self, characteristic: Any, **_options: Any) -> bytearray:
        raise NotImplementedError

    async def read_gatt_descriptor(self, descriptor: Any, **_options: Any) -> bytearray:
        raise NotImplementedError

    async def write_gatt_descriptor(self, descriptor: Any, data: Any) -> None:
        raise NotImplementedError


def breathe(monkeypatch: pytest.MonkeyPatch, *robots: Peripheral) -> Air:
    """Let bleak find these robots and no others."""
    logging.getLogger("bumble").setLevel(logging.CRITICAL)
    Air.now = Air(*robots)
    monkeypatch.setattr(bleak, "get_platform_scanner_backend_type", lambda: (VirtualScanner, "virtual"))
    monkeypatch.setattr(bleak, "get_platform_client_backend_type", lambda: (VirtualClient, "virtual"))
    return Air.now
