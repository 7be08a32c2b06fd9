# SPDX-License-Identifier: Apache-2.0
"""A client's session at the broker: subscriptions, open handshakes in both directions, and waiting messages. Pure.

Packet ids follow the specification. An id of the client is in use from its PUBLISH with QoS 2 until its PUBREL (MQTT-4.3.3). Each
other PUBLISH with it is a repeat, with any payload. An id of the broker is in use from PUBLISH until PUBACK or PUBCOMP.
"""
import collections
import dataclasses

from packets import PACKET_ID_NOT_FOUND, PROTOCOL_ERROR, Kind, Packet, ProtocolError

FOREVER = 0xFFFFFFFF  # a session that never expires
MOST_PACKET_IDS = 65535
FAILURE = 0x80  # reason codes from here on are failures


@dataclasses.dataclass
class Subscription:
    topic_filter: str
    options: int
    identifier: int | None = None

    qos = property(lambda self: self.options & 3)
    is_no_local = property(lambda self: bool(self.options & 4))
    keeps_retain_flag = property(lambda self: bool(self.options & 8))
    retain_handling = property(lambda self: self.options >> 4 & 3)


@dataclasses.dataclass
class Outgoing:
    message: Packet  # a PUBLISH
    is_released: bool = False  # PUBREC came: PUBREL is sent until PUBCOMP comes


class Session:
    def __init__(self, client_id, most_queued):
        self.client_id, self.most_queued = client_id, most_queued
        self.expiry = 0  # seconds after the end of the connection
        self.receive_maximum = MOST_PACKET_IDS
        self.subscriptions = {}  # by filter
        self.incoming = {}  # QoS 2 packet ids of the client that are in use: the first message under each
        self.outgoing = collections.OrderedDict()  # the broker's packet ids that are in use, in the order of the messages
        self.waiting = collections.deque()  # beyond the client's Receive Maximum, or while it is away
        self.last_packet_id = 0

    # From the client

    def on_publish_qos2(self, packet):
        """Returns None when it is new. A repeat returns the first message under its id, and is not published again."""
        first = self.incoming.get(packet.packet_id)
        if first is None:
            self.incoming[packet.packet_id] = packet
        return first

    def on_pubrel(self, packet_id):
        """Returns the reason of the PUBCOMP."""
        return 0 if self.incoming.pop(packet_id, None) else PACKET_ID_NOT_FOUND

    def on_acknowledgement(self, packet):
        """Handles an acknowledgement of the client. Returns the packet to answer with, or None, and whether the id was in use."""
        out = self.outgoing.get(packet.packet_id)
        if packet.kind == Kind.PUBACK:
            self.expect_qos(out, 1, packet)
            return None, self.outgoing.pop(packet.packet_id, None) is not None
        self.expect_qos(out, 2, packet)
        if packet.kind == Kind.PUBREC and packet.reason < FAILURE:
            if out:
                out.is_released = True
            return Packet(Kind.PUBREL, packet.packet_id, 0 if out else PACKET_ID_NOT_FOUND), out is not None
        if packet.kind == Kind.PUBCOMP and out and not out.is_released:
            raise ProtocolError(PROTOCOL_ERROR, f"PUBCOMP before PUBREC, packet id {packet.packet_id}")
        return None, self.outgoing.pop(packet.packet_id, None) is not None

    @staticmethod
    def expect_qos(out, qos, packet):
        if out and out.message.qos != qos:
            raise ProtocolError(PROTOCOL_ERROR, f"{packet.kind.name} for a message with QoS {out.message.qos}")

    # To the client

    def add(self, message):
        """Queues a message with QoS 1 or 2 for the client. Returns False when there is no room."""
        if len(self.waiting) >= self.most_queued:
            return False
        self.waiting.append(message)
        return True

    def next_message(self):
        """Returns a message that may be sent now, with a packet id that is not in use, or None."""
        if not self.waiting or len(self.outgoing) >= min(self.receive_maximum, MOST_PACKET_IDS):
            return None
        while True:
            self.last_packet_id = self.last_packet_id % MOST_PACKET_IDS + 1
            if self.last_packet_id not in self.outgoing:
                break
        message = dataclasses.replace(self.waiting.popleft(), packet_id=self.last_packet_id)
        self.outgoing[message.packet_id] = Outgoing(message)
        return message

    def unacknowledged(self):
        """Returns the packets to send again at the next connection, in their former order (section 4.4)."""
        return [Packet(Kind.PUBREL, packet_id) if out.is_released else dataclasses.replace(out.message, dup=True)
                for packet_id, out in self.outgoing.items()]


def matches(topic_filter, topic):
    """Section 4.7. A filter that begins with a wildcard matches no topic that begins with $."""
    filter_levels, levels = topic_filter.split("/"), topic.split("/")
    if topic.startswith("$") and filter_levels[0] in ("#", "+"):
        return False
    for place, level in enumerate(filter_levels):
        if level == "#":
            return True
        if place >= len(levels) or level not in ("+", levels[place]):
            return False
    return len(filter_levels) == len(levels)


def is_filter(topic_filter):
    levels = topic_filter.split("/")
    return bool(topic_filter) and all(
        level in ("+", "#") or "+" not in level and "#" not in level for level in levels) and "#" not in levels[:-1]
