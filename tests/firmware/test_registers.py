"""The register header and the chip model against the manufacturer's SVD, which the pyocd wheel carries."""

from __future__ import annotations

import re
import zipfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import pytest
from bench_build import BENCH, build

from frogkick.pool.chip import VirtualChip

PYOCD = find_spec("pyocd")  # not imported, which takes longer than all of this
if PYOCD is None or PYOCD.origin is None:
    pytest.skip("pyocd is not installed: no SVD to check the registers against", allow_module_level=True)
SVD = Path(PYOCD.origin).parent / "debug" / "svd" / "svd_data.zip"

CORE = {
    "NVIC_ICPR0": 0xE000E280, "NVIC_ICPR1": 0xE000E284, "SCB_SCR": 0xE000ED10, "SCB_CPACR": 0xE000ED88,
}  # fmt: skip
"""Not in the SVD: ARMv7-M Architecture Reference Manual, B3.2 and B3.4."""

UNNAMED = {
    "CLOCK_ERRATUM_31": 0x4000053C, "CLOCK_ERRATUM_108": 0x40000EE4,
    "FICR_ERRATUM_31": 0x10000244, "FICR_ERRATUM_108": 0x10000258,
}  # fmt: skip
"""In no list of registers: Nordic's errata and their start-up code for nRF52832 give the addresses."""

# The SVD leaves RXDRDY out of UARTE0. The product specification has it (0x108), and so
# have UART0, the same block without DMA, and the UARTE0 of the nRF52840. Both are checked below.
RXDRDY = "EVENTS_RXDRDY"
TIMER_CHANNELS = 4  # the SVD gives every TIMER six CC; TIMER0 to TIMER2 have four (product specification)


def flat(register: str) -> str:
    """A register's name as macros have it: "CH_CONFIG" of "CH[0].CONFIG"."""
    return re.sub(r"\[\d+\]", "", register).replace(".", "_")


@cache
def svd(name: str) -> ElementTree.Element:
    with zipfile.ZipFile(SVD) as content:
        return ElementTree.fromstring(content.read(name))


def peripheral(name: str, file: str = "nrf52.svd") -> ElementTree.Element:
    return next(p for p in svd(file).iter("peripheral") if p.findtext("name") == name)


def number(element: ElementTree.Element, tag: str) -> int:
    return int(element.findtext(tag) or "0", 0)


@cache
def registers(name: str, file: str = "nrf52.svd") -> dict[str, ElementTree.Element]:
    """Registers by full name, arrays and clusters expanded, each with its offset as an attribute."""
    element = peripheral(name, file)
    source = element
    while source.find("registers") is None:
        source = peripheral(source.attrib["derivedFrom"], file)
    found: dict[str, ElementTree.Element] = {}

    def walk(parent: ElementTree.Element, prefix: str, begin: int) -> None:
        for child in parent:
            if child.tag not in ("register", "cluster"):
                continue
            count = number(child, "dim") or 1
            for i in range(count):
                label = prefix + (child.findtext("name") or "").replace("%s", str(i))
                offset = begin + number(child, "addressOffset") + i * number(child, "dimIncrement")
                if child.tag == "cluster":
                    walk(child, label + ".", offset)
                else:
                    copy = ElementTree.Element("register", {"offset": str(offset)})
                    copy.extend(list(child))
                    found[label] = copy

    walk(source.find("registers"), "", 0)
    return found


def header() -> dict[str, str]:
    """Macros of the header: name with its parameters -> text."""
    text = re.sub(r"/\*.*?\*/", "", (BENCH / "nrf52832_regs.h").read_text(), flags=re.S)
    return dict(re.findall(r"^#define (\w+(?:\([\w, ]+\))?) (.+)$", text, flags=re.M))


def value(text: str) -> int:
    return int(eval(re.sub(r"(?<=[0-9A-Fa-f])u\b", "", text)))


MACROS = {k: v for k, v in header().items() if not k.startswith("FK_") and k != "NRF52832_REGS_H"}
ACCESSORS = {k: v for k, v in MACROS.items() if v.startswith("FK_REGISTER")}


def test_header_is_read() -> None:
    assert len(ACCESSORS) > 40
    assert len(MACROS) > 80


@pytest.mark.parametrize("macro", sorted(k for k in MACROS if k.endswith(("_BASE", "_IRQ"))))
def test_bases_and_interrupts(macro: str) -> None:
    name, kind = macro.rsplit("_", 1)
    element = peripheral(name)
    if kind == "BASE":
        assert value(MACROS[macro]) == number(element, "baseAddress")
    else:
        assert value(MACROS[macro]) in [number(i, "value") for i in element.iter("interrupt")]


@pytest.mark.parametrize("macro", sorted(ACCESSORS))
def test_addresses(macro: str) -> None:
    name = macro.split("(")[0]
    address = re.fullmatch(r"FK_REGISTER\((.+)\)", ACCESSORS[macro])
    assert address is not None
    if name in CORE | UNNAMED:
        text = re.sub(r"(\w+_BASE)", lambda found: MACROS[found[1]], address[1])
        assert value(text) == (CORE | UNNAMED)[name]
        return
    block, register = name.split("_", 1)
    instances = ("TIMER0", "TIMER1", "TIMER2") if block == "TIMER" else (block,)
    for instance in instances:
        base = number(peripheral(instance), "baseAddress")
        known = registers(instance)
        for n in range(4) if "n)" in macro else (None,):
            text = address[1].replace("(timer)", str(base)).replace("(n)", str(n))
            text = re.sub(r"\w+_BASE", str(base), text)
            spelled = (
                register if n is None else re.sub(r"^(CH|FORK|TASKS_CHG)_(.+)$", rf"\1[{n}].\2", register)
            )
            if n is not None and spelled == register:
                spelled = f"{register}[{n}]"
            spelled = re.sub(r"^(PSEL|RXD|TXD|RESULT)_", r"\1.", spelled)
            if (instance, spelled) == ("UARTE0", RXDRDY):
                offset = 0x108
            else:
                offset = int(known[spelled].attrib["offset"])
            assert value(text) == base + offset, (instance, spelled)


def test_rxdrdy_where_the_svd_of_uarte0_lacks_it() -> None:
    assert RXDRDY not in registers("UARTE0")  # when it comes in, the exception above goes
    assert number(peripheral("UART0"), "baseAddress") == number(peripheral("UARTE0"), "baseAddress")
    assert registers("UART0")[RXDRDY].attrib["offset"] == str(0x108)
    assert registers("UARTE0", "nrf52840.svd")[RXDRDY].attrib["offset"] == str(0x108)


def fields() -> list[str]:
    return sorted(
        k for k in MACROS
        if k not in ACCESSORS and not k.endswith(("_BASE", "_IRQ")) and not k.startswith("SCB_")
    )  # fmt: skip


@pytest.mark.parametrize("macro", fields())
def test_fields_and_values(macro: str) -> None:
    """BLOCK_REGISTER_FIELD_Msk, _Pos, or BLOCK_REGISTER_FIELD_Value."""
    block, rest = macro.split("_", 1)
    instance = "TIMER0" if block == "TIMER" else block
    given = value(MACROS[macro])
    # UARTE0's RXDRDY bit is missing as its register is: the nRF52840's file has both.
    file = "nrf52840.svd" if "RXDRDY" in macro else "nrf52.svd"
    candidates = [
        (register, field)
        for name, register in registers(instance, file).items()
        for field in register.iter("field")
        if rest.startswith(f"{flat(name)}_{field.findtext('name')}_")
    ]
    assert candidates, f"{macro}: no such register and field in the SVD"
    _, field = candidates[0]
    tail = macro.rsplit("_", 1)[1]
    text = field.findtext("bitRange")
    if text:
        high, low = (int(x) for x in text.strip("[]").split(":"))
    elif field.findtext("msb"):
        high, low = number(field, "msb"), number(field, "lsb")
    else:
        low = number(field, "bitOffset")
        high = low + number(field, "bitWidth") - 1
    if tail == "Msk":
        assert given == ((1 << (high - low + 1)) - 1) << low
    elif tail == "Pos":
        assert given == low
    else:
        values = {e.findtext("name"): number(e, "value") for e in field.iter("enumeratedValue")}
        assert given == values[tail]


@pytest.fixture(scope="module")
def chip(tmp_path_factory: pytest.TempPathFactory) -> VirtualChip:
    folder = tmp_path_factory.mktemp("idle")
    source = folder / "idle.c"
    source.write_text('int main(void);\nint main(void) { for (;;) { __asm__ volatile("wfe"); } }\n')
    return VirtualChip(build([source], folder / "idle.elf"))


def test_model_knows_what_the_svd_knows(chip: VirtualChip) -> None:
    checked = 0
    for block in chip.peripherals:
        if block.name == "SCS":
            for register in block.by_offset.values():
                assert block.base + register.offset == CORE[register.name]
            continue
        assert block.base == number(peripheral(block.name), "baseAddress")
        interrupts = [number(i, "value") for i in peripheral(block.name).iter("interrupt")]
        assert not block.INTERRUPT_EVENTS or interrupts == [block.irq]
        known = registers(block.name)
        for register in block.by_offset.values():
            checked += 1
            if (full := f"{block.name}_{register.name}") in UNNAMED:
                assert block.base + register.offset == UNNAMED[full]
                continue
            if (block.name, register.name) == ("UARTE0", RXDRDY):
                continue
            element = known[register.name]
            assert register.offset == int(element.attrib["offset"]), (block.name, register.name)
            access = {"read-only": "r", "write-only": "w", "read-write": "rw"}[
                element.findtext("access") or ""
            ]
            assert register.access == access, (block.name, register.name)
    assert checked > 120


def test_model_interrupt_bits(chip: VirtualChip) -> None:
    for block in chip.peripherals:
        for bit, event in block.INTERRUPT_EVENTS.items():
            file = "nrf52840.svd" if event == RXDRDY else "nrf52.svd"
            name = event.removeprefix("EVENTS_").replace("[", "").replace("]", "")
            field = next(
                f for f in registers(block.name, file)["INTENSET"].iter("field") if f.findtext("name") == name
            )
            assert int(field.findtext("lsb") or field.findtext("bitOffset") or "-1") == bit or (
                field.findtext("bitRange") == f"[{bit}:{bit}]"
            )


def test_header_and_model_hold_the_same_registers(chip: VirtualChip) -> None:
    """What the firmware may touch and what the model knows do not drift apart."""
    modelled = {
        f"{b.name}_{r.name}" for b in chip.peripherals for r in b.by_offset.values() if b.name != "SCS"
    }
    flat = {re.sub(r"\[\d+\]", "", m).replace(".", "_") for m in modelled} | set(CORE)
    wanted = set()
    for macro in ACCESSORS:
        name = macro.split("(")[0]
        wanted |= {name.replace("TIMER_", f"TIMER{i}_") for i in range(3)} if "TIMER_" in name else {name}
    assert wanted <= flat
    # Beyond the header: what belongs to a register that is used (INTENCLR, RXD.AMOUNT).
    assert flat - wanted <= {"UARTE0_RXD_AMOUNT", *(f"TIMER{i}_INTENCLR" for i in range(3))}


def test_board_pins() -> None:
    text = Path(BENCH / "board.h").read_text()
    pins = re.search(r"FK_BOARD_LIMB_PINS \{(.+)\}", text)
    assert pins is not None
    from frogkick.pool.virtual_robot import LIMB_PINS

    assert tuple(int(p.strip().rstrip("u")) for p in pins[1].split(",")) == LIMB_PINS
