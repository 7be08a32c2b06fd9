# SPDX-License-Identifier: Apache-2.0
"""What a broker remembers of a client: its subscriptions, its open handshakes in both directions, and what waits for it. Pure.

Packet ids are kept by the book. An id of the client is in use from its PUBLISH with QoS 2 until its PUBREL (MQTT-4.3.3): meanwhile
each PUBLISH with it is a repeat, whatever is in it. An id of the broker is in use from PUBLISH until PUBACK or PUBCOMP.
"""
import collections
import dataclasses

from packets import PACKET_ID_NOT_FOUND, PROTOCOL_ERROR, Kind, Packet, ProtocolError

FOREVER = 0xFFFFFFFF  # a session expiry that never comes
MOST_PACKET_IDS = 65535
FAILURE = 0x80  # reasons from here on


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
    is_released: bool = False  # PUBREC came: now PUBREL is sent until PUBCOMP comes


class Session:
    def __init__(self, client_id, most_queued):
        self.client_id, self.most_queued = client_id, most_queued
        self.expiry = 0  # seconds after the end of the connection
        self.receive_maximum = MOST_PACKET_IDS
        self.subscriptions = {}  # by filter
        self.incoming = {}  # QoS 2 packet ids of the client that are in use: what came first under them
        self.outgoing = collections.OrderedDict()  # packet ids of ours that are in use, in the order of the messages
        self.waiting = collections.deque()  # beyond the client's Receive Maximum, or while it is away
        self.last_packet_id = 0

    # From the client

    def on_publish_qos2(self, packet):
        """None when it is new. Else what came first under its id: this is a repeat, which is not published again."""
        first = self.incoming.get(packet.packet_id)
        if first is None:
            self.incoming[packet.packet_id] = packet
        return first

    def on_pubrel(self, packet_id):
        """The reason of the PUBCOMP."""
        return 0 if self.incoming.pop(packet_id, None) else PACKET_ID_NOT_FOUND

    def on_acknowledgement(self, packet):
        """Of a message to the client. The packet to answer it with, or None. False as the second value: the id was not in use."""
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
        """A message with QoS 1 or 2 for the client. False: there is no room."""
        if len(self.waiting) >= self.most_queued:
            return False
        self.waiting.append(message)
        return True

    def next_message(self):
        """One that may be sent now, with a packet id that is not in use; None when there is none."""
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
        """What is sent again at the begin of the next connection, in the order of before (section 4.4)."""
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
