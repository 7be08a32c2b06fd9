# SPDX-License-Identifier: Apache-2.0
"""One line of events.csv: one step of one message on its way.

Sources are the gateway (`slam-gatewayctl --json watch`), the robots (`slam-gateway-sim --trace`) and the broker (a subscriber).
All three are read leniently: a member that is missing or of another type is left empty, an unknown one is ignored.
"""
import csv
import dataclasses
import datetime
import re
import string

GATEWAY, ROBOTS, BROKER = "gateway", "robots", "broker"
LARGEST = 2 ** 53  # the largest number that survives JSON and a double

# name: (type, description for the documentation)
COLUMNS = {
    "t_us": (int, "microseconds since the run began, on a clock that makes no steps"),
    "at": (str, "the time that the source gave, ISO 8601; empty: t_us is when the line was read"),
    "source": (str, "who saw it: gateway, robots (simulated ones only) or broker"),
    "event": (str, "what happened: arrived, repeat, published, acknowledged, ...; robots: sent, refused, link_repeat, ..."),
    "robot": (str, "the robot's id"),
    "mesh": (str, "ble or thread"),
    "type": (str, "message type: update, probe, adv, ..."),
    "direction": (str, "up or down"),
    "qos": (int, "0, 1 or 2"),
    "message_id": (str, "the mesh's own number of the message"),
    "dup": (int, "1: marked as a repeat by the robot"),
    "bytes": (int, "octets of the payload"),
    "rssi_dbm": (float, "received signal strength"),
    "ttl": (int, "BLE Mesh: as it arrived"),
    "hops": (int, "BLE Mesh: relays that it passed; 0: none"),
    "latency_us": (int, "since the message arrived at the gateway"),
    "outcome": (str, "of a command, or why a message was refused"),
    "number": (int, "robots: their count of the message; probes: the sequence number inside"),
    "sender_ms": (int, "probes: the sender's milliseconds"),
    "payload": (str, "hexadecimal"),
    "topic": (str, "MQTT topic"),
}


@dataclasses.dataclass
class Event:
    t_us: int = 0
    at: str = ""
    source: str = ""
    event: str = ""
    robot: str = ""
    mesh: str = ""
    type: str = ""
    direction: str = ""
    qos: int | None = None
    message_id: str = ""
    dup: int | None = None
    bytes: int | None = None
    rssi_dbm: float | None = None
    ttl: int | None = None
    hops: int | None = None
    latency_us: int | None = None
    outcome: str = ""
    number: int | None = None
    sender_ms: int | None = None
    payload: str = ""
    topic: str = ""

    def is_arrival_of(self, message_type):
        return (self.source == GATEWAY and self.event == "arrived" and self.direction != "down"
                and self.type == message_type)


class WrongColumns(Exception):
    """events.csv was written by another version."""


def microseconds_since_1970(text):
    """Returns the microseconds of an ISO 8601 time with any number of decimals; None for an invalid one."""
    try:
        moment = datetime.datetime.fromisoformat(str(text).replace("Z", "+00:00"))
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.timezone.utc)
    since = moment - datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
    return since // datetime.timedelta(microseconds=1)


def _as(kind, value):
    if value is None or value == "":
        return "" if kind is str else None
    if kind is str:
        return value if isinstance(value, str) else str(value)
    try:
        number = kind(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if abs(number) <= LARGEST else None  # NaN fails the comparison


def _hex(value):
    """Returns octets in hexadecimal digits; empty for any other value."""
    text = _as(str, value)
    return text if len(text) % 2 == 0 and not set(text) - set(string.hexdigits) else ""


def read_probe(payload_hex):
    """Returns sequence number (u16) and milliseconds (u32), little-endian; None if the payload is not a probe's."""
    try:
        octets = bytes.fromhex(payload_hex)
    except ValueError:
        return None
    if len(octets) != 6:
        return None
    return int.from_bytes(octets[:2], "little"), int.from_bytes(octets[2:], "little")


def from_members(source, members):
    """Returns an Event without its time, from the members of one line of a source."""
    event = Event(source=source)
    for name, (kind, _) in COLUMNS.items():
        if name in members and name not in ("t_us", "source"):
            setattr(event, name, _as(kind, members[name]))
    event.payload = _hex(event.payload or members.get("payload_hex"))
    event.outcome = event.outcome or _as(str, members.get("why"))
    if not event.event and source == GATEWAY:
        event.event = "command" if event.direction == "down" else "arrived"
    if event.bytes is None and event.payload:
        event.bytes = len(event.payload) // 2
    if event.type == "probe" and event.payload:
        probe = read_probe(event.payload)
        if probe:
            event.number, event.sender_ms = probe
    return event


# The same as in web/page/shown.js and daemon/core/utf8.cpp: tests/vectors/shown.json checks all three.
_HIDDEN = ("\xad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b-\u200f\u2028-\u202e\u2060-\u206f\u3164"
           "\ufe00-\ufe0f\ufeff\uffa0\ufff9-\ufffb\U000e0000-\U000e0fff")
_FOREIGN = ("\xa0\u0250-\u058f\u13a0-\u13ff\u1c80-\u1c8f\u1f00-\u1fff\u2000-\u200a\u2010-\u2015\u202f\u205f"
            "\u2160-\u217f\u2212\u2c80-\u2cff\u2de0-\u2dff\u3000\ua640-\ua69f\uab70-\uabbf\uff00-\uff5e\U0001d400-\U0001d7ff")
_LOOK_ALIKE = ("\u0391\u0392\u0395-\u0397\u0399\u039a\u039c\u039d\u039f\u03a1\u03a4\u03a5\u03a7\u03b1\u03b9\u03ba\u03bd"
               "\u03bf\u03c1\u03c4\u03c5\u03c7\u03f2\u03f3\u03f9\u0405\u0406\u0408\u0410\u0412\u0415\u041a\u041c-\u041e\u0420-\u0423"
               "\u0425\u0430\u0435\u043e\u0440\u0441\u0443\u0445\u0455\u0456\u0458\u04ae\u04af\u04ba\u04bb\u04c0\u04cf\u0501"
               "\u051a-\u051d\uff21-\uff5a\U0001d400-\U0001d7ff")
_CONTROL = "\x00-\x1f\x7f-\x9f"
_WORD = re.compile("[0-9A-Za-z\x80-\U0010ffff]+")
_DECEIVES = re.compile(f"[0-9{_HIDDEN}]*[{_LOOK_ALIKE}][0-9{_HIDDEN}{_LOOK_ALIKE}]*")
_FORMULA = re.compile(r"'*[=+\-@\t\r]")


def _escape(found):
    units = found[0].encode("utf-16-be", "surrogatepass").hex()
    return "".join("\\u" + units[at:at + 4] for at in range(0, len(units), 4))


def _escape_foreign(found):
    word = found[0]
    deceives = re.search("[A-Za-z]", word) or _DECEIVES.fullmatch(word)
    return re.sub(f"[{_FOREIGN}]", _escape, word) if deceives else word


def to_cell(value):
    """Returns a cell that is not a formula in a spreadsheet, without characters that make a name look like another."""
    if value is None:
        return ""
    if not isinstance(value, str):
        return value
    text = "'" + value if _FORMULA.match(value) else value
    return re.sub(f"[{_HIDDEN}{_CONTROL}]", _escape, _WORD.sub(_escape_foreign, text))


def from_cell(text):
    """Returns the argument of to_cell()."""
    def original(found):
        characters = bytes.fromhex(found[0].replace("\\u", "")).decode("utf-16-be", "surrogatepass")
        return re.sub(f"[^{_HIDDEN}{_FOREIGN}{_CONTROL}]", _escape, characters)
    text = re.sub(r"(\\u[0-9a-f]{4})+", original, text)
    return text[1:] if _FORMULA.match(text[1:]) and text[0] == "'" else text


def write_header(file):
    csv.writer(file, lineterminator="\n").writerow(COLUMNS)


def write_row(file, event):
    row = [getattr(event, name) for name in COLUMNS]
    csv.writer(file, lineterminator="\n").writerow([to_cell(value) for value in row])


def read_csv(path):
    """Returns all events of the file, in order of time, without a truncated last line."""
    events = []
    with open(path, newline="", encoding="utf-8") as file:
        rows = csv.reader(file)
        header = next(rows, None)
        if header != list(COLUMNS):
            raise WrongColumns(f"{path} does not begin with the columns of this version: {','.join(COLUMNS)}")
        for row in rows:
            if len(row) != len(COLUMNS):
                continue
            values = {name: _as(kind, from_cell(text)) for (name, (kind, _)), text in zip(COLUMNS.items(), row)}
            values["payload"] = _hex(values["payload"])
            if values["t_us"] is not None:
                events.append(Event(**values))
    events.sort(key=lambda event: event.t_us)
    return events
