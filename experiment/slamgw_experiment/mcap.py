# SPDX-License-Identifier: Apache-2.0
"""Writes events as an MCAP file (mcap.dev/spec, version 0) for Foxglove and other readers. `ros2 bag play` plays no JSON.

One channel for each robot and message type, with the decoded message, and one with all events of each source. Messages are JSON;
each kind has its JSON schema. One chunk for each 1000 messages, with indexes, so that a reader can seek.
"""
import dataclasses
import json
import struct
import zlib

from slamgw_experiment.events import COLUMNS

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x08
STATISTICS, SUMMARY_OFFSET, DATA_END = 0x0B, 0x0E, 0x0F
MESSAGES_IN_A_CHUNK = 1000

_CM = {"type": "integer", "description": "centimetres"}
_POINT = {"type": "object", "properties": {"x": _CM, "y": _CM}, "required": ["x", "y"]}
_TYPES = {int: "integer", float: "number", str: "string"}

SCHEMAS = {
    "slam_gateway.Update": {
        "title": "slam_gateway.Update", "type": "object", "description": "A robot's place, and up to four obstacles",
        "properties": {"x": _CM, "y": _CM, "obstacles": {"type": "array", "items": _POINT}},
        "required": ["x", "y", "obstacles"]},
    "slam_gateway.Probe": {
        "title": "slam_gateway.Probe", "type": "object", "description": "Sequence number and the sender's clock",
        "properties": {"number": {"type": "integer"}, "sender_ms": {"type": "integer", "description": "milliseconds"}},
        "required": ["number", "sender_ms"]},
    "slam_gateway.Bytes": {
        "title": "slam_gateway.Bytes", "type": "object", "description": "A message of any other type",
        "properties": {"payload": {"type": "string", "description": "hexadecimal"}}, "required": ["payload"]},
    "slam_gateway.Event": {
        "title": "slam_gateway.Event", "type": "object", "description": "A line of events.csv; empty members are left out",
        "properties": {name: {"type": _TYPES[kind], "description": text} for name, (kind, text) in COLUMNS.items()},
        "required": ["t_us", "source", "event"]},
}


def update_of(payload_hex):
    """Returns the members of an update, or None for invalid octets. Valid: 4 + 4n, and one stray octet."""
    octets = bytes.fromhex(payload_hex)
    if len(octets) < 4 or len(octets) > 21 or len(octets) % 4 > 1:
        return None
    numbers = struct.unpack(f"<{len(octets) // 4 * 2}h", octets[:len(octets) // 4 * 4])
    pairs = [{"x": x, "y": y} for x, y in zip(numbers[::2], numbers[1::2])]
    return {**pairs[0], "obstacles": pairs[1:]}


def decoded(event):
    """Returns (schema, members) of an arrived message."""
    if event.type == "update":
        update = update_of(event.payload)
        if update:
            return "slam_gateway.Update", update
    if event.type == "probe" and event.sender_ms is not None:
        return "slam_gateway.Probe", {"number": event.number, "sender_ms": event.sender_ms}
    return "slam_gateway.Bytes", {"payload": event.payload}


def messages_of(event):
    """Returns [(topic, schema, members)] for an event."""
    members = {name: value for name, value in dataclasses.asdict(event).items() if value not in (None, "")}
    out = [(f"/events/{event.source}", "slam_gateway.Event", members)]
    if event.is_arrival_of(event.type) and event.type:
        schema, message = decoded(event)
        out.append((f"/robot/{event.robot}/{event.type}", schema, message))
    return out


def _text(text):
    octets = text.encode()
    return struct.pack("<I", len(octets)) + octets


def _map(entries):
    body = b"".join(entries)
    return struct.pack("<I", len(body)) + body


def _record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


class Writer:
    """Times are nanoseconds since 1970."""

    def __init__(self, file):
        self._file = file
        self._offset = 0
        self._schemas = {}    # name: (id, record)
        self._channels = {}   # (topic, schema): (id, record)
        self._counts = {}
        self._chunk = bytearray()
        self._index = {}      # channel: [(time, offset)]
        self._chunk_indexes = []
        self._times = []
        self._all_times = [None, None]
        self._put(MAGIC)
        self._put(_record(HEADER, _text("") + _text("slam-gateway-experiment")))

    def _put(self, octets):
        self._file.write(octets)
        self._offset += len(octets)

    def _schema_id(self, name):
        if name not in self._schemas:
            number = len(self._schemas) + 1
            text = json.dumps(SCHEMAS[name]).encode()
            body = struct.pack("<H", number) + _text(name) + _text("jsonschema") + struct.pack("<I", len(text)) + text
            self._schemas[name] = number, _record(SCHEMA, body)
            self._chunk += self._schemas[name][1]
        return self._schemas[name][0]

    def _channel_id(self, topic, schema):
        if (topic, schema) not in self._channels:
            number = len(self._channels) + 1
            body = struct.pack("<HH", number, self._schema_id(schema)) + _text(topic) + _text("json") + _map([])
            self._channels[topic, schema] = number, _record(CHANNEL, body)
            self._chunk += self._channels[topic, schema][1]
        return self._channels[topic, schema][0]

    def write(self, topic, schema, members, at_ns):
        channel = self._channel_id(topic, schema)
        sequence = self._counts[channel] = self._counts.get(channel, 0) + 1
        self._index.setdefault(channel, []).append((at_ns, len(self._chunk)))
        text = json.dumps(members, allow_nan=False).encode()
        self._chunk += _record(MESSAGE, struct.pack("<HIQQ", channel, sequence, at_ns, at_ns) + text)
        self._times.append(at_ns)
        if len(self._times) >= MESSAGES_IN_A_CHUNK:
            self._end_chunk()

    def _end_chunk(self):
        if not self._chunk:
            return
        first, last = (min(self._times), max(self._times)) if self._times else (0, 0)
        begin = self._offset
        body = struct.pack("<QQQI", first, last, len(self._chunk), zlib.crc32(self._chunk)) + _text("") + struct.pack(
            "<Q", len(self._chunk)) + bytes(self._chunk)
        self._put(_record(CHUNK, body))
        length = self._offset - begin
        offsets = []
        for channel, entries in sorted(self._index.items()):
            offsets.append(struct.pack("<HQ", channel, self._offset))
            self._put(_record(MESSAGE_INDEX, struct.pack("<H", channel) + _map([struct.pack("<QQ", *one) for one in entries])))
        index_length = self._offset - begin - length
        self._chunk_indexes.append(_record(CHUNK_INDEX, struct.pack("<QQQQ", first, last, begin, length) + _map(offsets) +
                                           struct.pack("<Q", index_length) + _text("") +
                                           struct.pack("<QQ", len(self._chunk), len(self._chunk))))
        if self._times:
            known = [one for one in self._all_times if one is not None]
            self._all_times = [min(known + [first]), max(known + [last])]
        self._chunk, self._index, self._times = bytearray(), {}, []

    def close(self):
        self._end_chunk()
        self._put(_record(DATA_END, struct.pack("<I", 0)))
        summary = self._offset
        groups = []
        for opcode, records in ((SCHEMA, [one for _, one in self._schemas.values()]),
                                (CHANNEL, [one for _, one in self._channels.values()]),
                                (STATISTICS, [self._statistics()]), (CHUNK_INDEX, self._chunk_indexes)):
            begin = self._offset
            for record in records:
                self._put(record)
            if records:
                groups.append(_record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, begin, self._offset - begin)))
        offsets = self._offset
        for record in groups:
            self._put(record)
        self._put(_record(FOOTER, struct.pack("<QQI", summary, offsets, 0)))
        self._put(MAGIC)

    def _statistics(self):
        first, last = (one or 0 for one in self._all_times)
        body = struct.pack("<QHIIIIQQ", sum(self._counts.values()), len(self._schemas), len(self._channels), 0, 0,
                           len(self._chunk_indexes), first, last)
        return _record(STATISTICS, body + _map([struct.pack("<HQ", *one) for one in sorted(self._counts.items())]))


def write(path, events, begin_wall_us):
    """`begin_wall_us`: the wall clock at t_us = 0, in microseconds since 1970."""
    with open(path, "wb") as file:
        writer = Writer(file)
        for event in events:
            for topic, schema, members in messages_of(event):
                writer.write(topic, schema, members, max(0, begin_wall_us + event.t_us) * 1000)
        writer.close()
