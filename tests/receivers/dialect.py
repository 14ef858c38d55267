"""Compares the MAVLink dialect of Lookout, src/mavlink/dialect.xml, and its table CRC_EXTRA with pymavlink's.

    python dialect.py

Fails at a message or field that differs and at a value of an enumeration that is missing.
"""

import pathlib
import re
import xml.etree.ElementTree as ElementTree

from pymavlink.dialects.v20 import ardupilotmega as mavlink

SOURCE = pathlib.Path(__file__).resolve().parents[2] / "src" / "mavlink"


def check_message(message):
    """Extension fields that pymavlink does not know."""
    theirs = mavlink.mavlink_map[int(message.get("id"))]
    fields = [field for field in message if field.tag == "field"]
    assert theirs.msgname == message.get("name"), theirs.msgname
    known = len(theirs.fieldnames)
    assert theirs.fieldnames == [field.get("name") for field in fields[:known]], theirs.fieldnames
    assert message.find("extensions") is not None or known == len(fields), theirs.fieldnames
    for field, kind in zip(fields, theirs.fieldtypes):
        base, _, length = field.get("type").partition("[")
        place = theirs.ordered_fieldnames.index(field.get("name"))
        count = theirs.array_lengths[place]
        assert base.removesuffix("_mavlink_version") == kind, (message.get("name"), field.get("name"), kind)
        assert int(length.removesuffix("]") or 0) == count, (message.get("name"), field.get("name"), count)
        enum = theirs.fieldenums_by_name.get(field.get("name"))
        assert enum == field.get("enum"), (message.get("name"), field.get("name"), enum)
    return len(fields) - known


def check_enum(enum):
    """Every value that pymavlink knows is listed: a message with another one is not decoded. Names do not go on a link."""
    theirs = mavlink.enums[enum.get("name")].items()
    values = {value for value, entry in theirs if not entry.name.endswith("_ENUM_END")}
    missing = values - {int(entry.get("value")) for entry in enum}
    assert not missing, (enum.get("name"), missing)


def check_types():
    """The table of heartbeat.rs has every MAV_TYPE that pymavlink knows, under its number."""
    table = (SOURCE / "component" / "heartbeat.rs").read_text().partition("const TYPES")[2].partition("];")[0]
    ours = dict(enumerate(re.findall(r'\("([A-Z0-9_]+)", (?:true|false)\)', table)))
    theirs = {number: entry.name.removeprefix("MAV_TYPE_") for number, entry in mavlink.enums["MAV_TYPE"].items()}
    # Some kinds of VTOL have other names in ArduPilot's definitions.
    same = lambda a, b: a == b or a.startswith("VTOL_") and str(b).startswith("VTOL_")  # noqa: E731
    wrong = {n: name for n, name in theirs.items() if name != "ENUM_END" and not same(name, ours.get(n))}
    assert not wrong and len(theirs) > 45, wrong
    return len(theirs) - 1


def main():
    dialect = ElementTree.parse(SOURCE / "dialect.xml").getroot()
    messages, absent = [], []
    for message in dialect.iter("message"):
        (messages if int(message.get("id")) in mavlink.mavlink_map else absent).append(message)
    # Commands are read by their number.
    enums = [enum for enum in dialect.iter("enum") if enum.get("name") != "MAV_CMD"]
    # ArduPilot's definitions lack a few of MAVLink's common messages.
    assert len(messages) > 5 * len(absent), [message.get("name") for message in absent]
    younger = sum(map(check_message, messages))
    for enum in enums:
        check_enum(enum)
    table = (SOURCE / "dialect.rs").read_text().partition("const CRC_EXTRA")[2].partition("];")[0]
    extra = {int(number): int(crc) for number, crc in re.findall(r"\((\d+), (\d+)\)", table)}
    both = extra.keys() & mavlink.mavlink_map.keys()
    wrong = [number for number in both if mavlink.mavlink_map[number].crc_extra != extra[number]]
    assert not wrong, f"CRC_EXTRA of the messages {wrong}"
    assert len(both) > 300, len(both)
    print(
        f"dialect: {len(messages)} messages ({younger} fields younger than pymavlink's), {len(enums)} enumerations, "
        f"not known to pymavlink: {', '.join(message.get('name') for message in absent)}; "
        f"{len(both)} of {len(extra)} CRC_EXTRA as in pymavlink; {check_types()} kinds of heartbeats"
    )


main()
