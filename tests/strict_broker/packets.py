# SPDX-License-Identifier: Apache-2.0
"""MQTT packets of both versions. Decodes a client's octets into a Packet, or rejects them with a reason where the specification
forbids them. Encodes a broker's Packets into octets. Pure. Section numbers are those of MQTT 5."""
import dataclasses
import enum
import struct


class Kind(enum.IntEnum):
    CONNECT = 1
    CONNACK = 2
    PUBLISH = 3
    PUBACK = 4
    PUBREC = 5
    PUBREL = 6
    PUBCOMP = 7
    SUBSCRIBE = 8
    SUBACK = 9
    UNSUBSCRIBE = 10
    UNSUBACK = 11
    PINGREQ = 12
    PINGRESP = 13
    DISCONNECT = 14


ACKNOWLEDGEMENTS = (Kind.PUBACK, Kind.PUBREC, Kind.PUBREL, Kind.PUBCOMP)
FLAGS_2 = (Kind.PUBREL, Kind.SUBSCRIBE, Kind.UNSUBSCRIBE)  # section 2.1.3: all others but PUBLISH have 0

MALFORMED, PROTOCOL_ERROR, UNSUPPORTED_VERSION, BAD_CLIENT_ID = 0x81, 0x82, 0x84, 0x85
KEEP_ALIVE_TIMEOUT, TAKEN_OVER, TOPIC_NAME_INVALID, PACKET_ID_NOT_FOUND = 0x8D, 0x8E, 0x90, 0x92
RECEIVE_MAXIMUM_EXCEEDED, TOPIC_ALIAS_INVALID, PACKET_TOO_LARGE, FILTER_INVALID = 0x93, 0x94, 0x95, 0x8F
SHARED_UNSUPPORTED = 0x9E
NO_SUBSCRIPTION = 0x11

WILL = "WILL"
_P, _W, _C, _K, _D = Kind.PUBLISH, WILL, Kind.CONNECT, Kind.CONNACK, Kind.DISCONNECT
# Section 2.2.2.2: number: (name, form, in which packets)
PROPERTIES = {
    0x01: ("payload_format", "B", {_P, _W}), 0x02: ("message_expiry", "I", {_P, _W}), 0x03: ("content_type", "text", {_P, _W}),
    0x08: ("response_topic", "text", {_P, _W}), 0x09: ("correlation", "octets", {_P, _W}),
    0x0B: ("subscription_id", "varint", {_P, Kind.SUBSCRIBE}), 0x11: ("session_expiry", "I", {_C, _K, _D}),
    0x12: ("assigned_client_id", "text", {_K}), 0x13: ("server_keep_alive", "H", {_K}), 0x15: ("auth_method", "text", {_C, _K}),
    0x16: ("auth_data", "octets", {_C, _K}), 0x17: ("request_problem", "B", {_C}), 0x18: ("will_delay", "I", {_W}),
    0x19: ("request_response", "B", {_C}), 0x1A: ("response_information", "text", {_K}), 0x1C: ("server_reference", "text", {_K, _D}),
    0x1F: ("reason_string", "text", {_K, _D, *ACKNOWLEDGEMENTS, Kind.SUBACK, Kind.UNSUBACK}), 0x21: ("receive_maximum", "H", {_C, _K}),
    0x22: ("topic_alias_maximum", "H", {_C, _K}), 0x23: ("topic_alias", "H", {_P}), 0x24: ("maximum_qos", "B", {_K}),
    0x25: ("retain_available", "B", {_K}), 0x26: ("user_property", "pair", set(Kind) | {WILL}), 0x27: ("maximum_packet", "I", {_C, _K}),
    0x28: ("wildcards_available", "B", {_K}), 0x29: ("ids_available", "B", {_K}), 0x2A: ("shared_available", "B", {_K}),
}
NUMBER_OF = {name: (number, form) for number, (name, form, _) in PROPERTIES.items()}
REPEATABLE = ("user_property", "subscription_id")  # the latter in PUBLISH; a client may send neither of them twice otherwise
NOT_ZERO = ("receive_maximum", "maximum_packet", "topic_alias", "subscription_id")


class ProtocolError(Exception):
    """The peer sent something forbidden; the connection ends with this reason."""

    def __init__(self, reason, text):
        super().__init__(text)
        self.reason = reason


@dataclasses.dataclass
class Packet:
    kind: Kind
    packet_id: int = 0
    reason: int = 0
    properties: dict = dataclasses.field(default_factory=dict)  # REPEATABLE ones have lists
    # PUBLISH, and the will of CONNECT
    topic: str = ""
    payload: bytes = b""
    qos: int = 0
    dup: bool = False
    retain: bool = False
    # SUBSCRIBE: (filter, options); UNSUBSCRIBE: filters; SUBACK and UNSUBACK: reasons
    entries: list = dataclasses.field(default_factory=list)
    # CONNECT; CONNACK has `session_present`
    version: int = 5
    client_id: str = ""
    clean_start: bool = True
    keep_alive: int = 0
    will: "Packet | None" = None
    session_present: bool = False


class Reader:
    def __init__(self, octets):
        self.octets, self.at = octets, 0

    def take(self, count):
        if self.at + count > len(self.octets):
            raise ProtocolError(MALFORMED, "the packet is shorter than its fields")
        self.at += count
        return self.octets[self.at - count:self.at]

    def number(self, form):
        return struct.unpack(">" + form, self.take(struct.calcsize(form)))[0]

    def varint(self):
        value = 0
        for place in range(4):
            octet = self.number("B")
            value |= (octet & 0x7F) << 7 * place
            if octet < 0x80:
                return value
        raise ProtocolError(MALFORMED, "a variable byte integer has more than four octets")

    def octets_field(self):
        return self.take(self.number("H"))

    def text(self):
        try:
            text = self.octets_field().decode("utf-8", "strict")
        except UnicodeDecodeError as error:
            raise ProtocolError(MALFORMED, f"invalid UTF-8: {error}") from None
        if "\0" in text:
            raise ProtocolError(MALFORMED, "U+0000 in a text")  # MQTT-1.5.4-2
        return text

    def has_more(self):
        return self.at < len(self.octets)

    def rest(self):
        return self.take(len(self.octets) - self.at)

    def properties(self, place):
        end_after = self.varint()
        inner = Reader(self.take(end_after))
        found = {}
        while inner.has_more():
            number = inner.varint()
            if number not in PROPERTIES:
                raise ProtocolError(MALFORMED, f"unknown property 0x{number:02x}")
            name, form, places = PROPERTIES[number]
            if place not in places:
                raise ProtocolError(PROTOCOL_ERROR, f"{name} in {place}")
            value = inner.field(form)
            if value == 0 and name in NOT_ZERO:
                raise ProtocolError(PROTOCOL_ERROR, f"{name} is 0")
            if name in REPEATABLE:
                found.setdefault(name, []).append(value)
            elif name in found:
                raise ProtocolError(PROTOCOL_ERROR, f"{name} twice")
            else:
                found[name] = value
        return found

    def field(self, form):
        if form == "pair":
            return self.text(), self.text()
        return {"text": self.text, "octets": self.octets_field, "varint": self.varint}.get(form, lambda: self.number(form))()


def decode(first, body, version):
    """`version`: of the connection; ignored for CONNECT."""
    try:
        kind = Kind(first >> 4)
    except ValueError:
        raise ProtocolError(MALFORMED, f"packet type {first >> 4}") from None
    if kind != Kind.PUBLISH and first & 15 != (2 if kind in FLAGS_2 else 0):
        raise ProtocolError(MALFORMED, f"flags {first & 15} of {kind.name}")
    packet, reader = Packet(kind, version=version), Reader(body)
    if kind == Kind.CONNECT:
        decode_connect(packet, reader)
    elif kind == Kind.PUBLISH:
        decode_publish(packet, first & 15, reader)
    elif kind in ACKNOWLEDGEMENTS:
        packet.packet_id = packet_id(reader)
        decode_reason(packet, reader)
    elif kind == Kind.DISCONNECT:
        decode_reason(packet, reader)
    elif kind in (Kind.SUBSCRIBE, Kind.UNSUBSCRIBE):
        decode_filters(packet, reader)
    elif kind in (Kind.CONNACK, Kind.SUBACK, Kind.UNSUBACK):
        raise ProtocolError(PROTOCOL_ERROR, f"{kind.name} from a client")
    if reader.has_more():
        raise ProtocolError(MALFORMED, f"{kind.name} is longer than its fields")
    return packet


def packet_id(reader):
    number = reader.number("H")
    if number == 0:
        raise ProtocolError(PROTOCOL_ERROR, "packet id 0")
    return number


def decode_connect(packet, reader):
    if reader.text() != "MQTT":
        raise ProtocolError(UNSUPPORTED_VERSION, "the protocol's name")
    packet.version = reader.number("B")
    if packet.version not in (4, 5):
        raise ProtocolError(UNSUPPORTED_VERSION, f"protocol level {packet.version}")
    flags = reader.number("B")
    has_will, will_qos, will_retain = bool(flags & 4), flags >> 3 & 3, bool(flags & 32)
    if flags & 1 or will_qos == 3 or not has_will and (will_qos or will_retain):
        raise ProtocolError(MALFORMED, f"CONNECT flags 0x{flags:02x}")
    if packet.version == 4 and flags & 0x40 and not flags & 0x80:
        raise ProtocolError(MALFORMED, "a password without a user name")
    packet.clean_start, packet.keep_alive = bool(flags & 2), reader.number("H")
    if packet.version == 5:
        packet.properties = reader.properties(Kind.CONNECT)
    packet.client_id = reader.text()
    if has_will:
        properties = reader.properties(WILL) if packet.version == 5 else {}
        topic, payload = topic_name(reader), reader.octets_field()
        packet.will = Packet(Kind.PUBLISH, properties=properties, topic=topic, payload=payload, qos=will_qos, retain=will_retain)
    if flags & 0x80:
        reader.text()
    if flags & 0x40:
        reader.octets_field()


def decode_publish(packet, flags, reader):
    packet.dup, packet.qos, packet.retain = bool(flags & 8), flags >> 1 & 3, bool(flags & 1)
    if packet.qos == 3 or packet.dup and packet.qos == 0:
        raise ProtocolError(MALFORMED, f"PUBLISH flags {flags}")
    packet.topic = topic_name(reader)
    if packet.qos > 0:
        packet.packet_id = packet_id(reader)
    if packet.version == 5:
        packet.properties = reader.properties(Kind.PUBLISH)
    packet.payload = reader.rest()


def topic_name(reader):
    topic = reader.text()
    if not topic or "+" in topic or "#" in topic:
        raise ProtocolError(TOPIC_NAME_INVALID, f"the topic name '{topic}'")
    return topic


def decode_reason(packet, reader):
    if packet.version == 5 and reader.has_more():
        packet.reason = reader.number("B")
        if reader.has_more():
            packet.properties = reader.properties(packet.kind)


def decode_filters(packet, reader):
    packet.packet_id = packet_id(reader)
    if packet.version == 5:
        packet.properties = reader.properties(packet.kind)
        if len(packet.properties.get("subscription_id", [])) > 1:
            raise ProtocolError(PROTOCOL_ERROR, "two subscription identifiers")
    while reader.has_more():
        topic_filter = reader.text()
        if packet.kind == Kind.UNSUBSCRIBE:
            packet.entries.append(topic_filter)
            continue
        options = reader.number("B")
        is_reserved = options & 0xC0 or options >> 4 & 3 == 3 if packet.version == 5 else options & 0xFC
        if is_reserved or options & 3 == 3:
            raise ProtocolError(MALFORMED, f"subscription options 0x{options:02x}")
        packet.entries.append((topic_filter, options))
    if not packet.entries:
        raise ProtocolError(PROTOCOL_ERROR, f"{packet.kind.name} without a filter")


def encode(packet, version):
    kind, flags, body = packet.kind, 2 if packet.kind in FLAGS_2 else 0, b""
    properties = encode_properties(packet.properties) if version == 5 else b""
    if kind == Kind.PUBLISH:
        flags = packet.dup << 3 | packet.qos << 1 | packet.retain
        body = text_field(packet.topic) + (number_field(packet.packet_id) if packet.qos else b"") + properties + packet.payload
    elif kind == Kind.CONNACK:
        body = bytes([packet.session_present, packet.reason]) + properties
    elif kind in ACKNOWLEDGEMENTS:
        body = number_field(packet.packet_id) + (bytes([packet.reason]) if version == 5 and packet.reason else b"")
    elif kind in (Kind.SUBACK, Kind.UNSUBACK):
        body = number_field(packet.packet_id) + properties + (bytes(packet.entries) if kind == Kind.SUBACK or version == 5 else b"")
    elif kind == Kind.DISCONNECT:
        body = bytes([packet.reason]) + properties if version == 5 else b""
    return bytes([kind << 4 | flags]) + encode_varint(len(body)) + body


def encode_properties(properties):
    octets = b""
    for name, values in properties.items():
        number, form = NUMBER_OF[name]
        for value in values if name in REPEATABLE else [values]:
            octets += encode_varint(number) + encode_field(form, value)
    return encode_varint(len(octets)) + octets


def encode_field(form, value):
    if form == "pair":
        return text_field(value[0]) + text_field(value[1])
    encoders = {"text": text_field, "octets": octets_field, "varint": encode_varint}
    return encoders[form](value) if form in encoders else struct.pack(">" + form, value)


def encode_varint(value):
    octets = bytearray()
    while True:
        value, octet = value >> 7, value & 0x7F
        octets.append(octet | (0x80 if value else 0))
        if not value:
            return bytes(octets)


def number_field(number):
    return struct.pack(">H", number)


def octets_field(octets):
    return number_field(len(octets)) + octets


def text_field(text):
    return octets_field(text.encode())


def take_packet(buffer):
    """Removes the first packet from the buffer and returns (first octet, body); None while it is not complete."""
    size = 0
    for place in range(1, 5):
        if place >= len(buffer):
            return None
        size |= (buffer[place] & 0x7F) << 7 * (place - 1)
        if buffer[place] < 0x80:
            break
    else:
        raise ProtocolError(MALFORMED, "the length has more than four octets")
    if len(buffer) < place + 1 + size:
        return None
    first, body = buffer[0], bytes(buffer[place + 1:place + 1 + size])
    del buffer[:place + 1 + size]
    return first, body
