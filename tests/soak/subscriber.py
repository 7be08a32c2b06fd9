# SPDX-License-Identifier: Apache-2.0
"""Receives everything that the broker has acknowledged, even if the broker is killed right then. Not a general MQTT client.

Mosquitto writes a QoS 0 copy to a subscriber's socket before it acknowledges the message to its publisher. The kernel keeps
written octets for the reader when the broker dies. This subscriber never writes after its SUBSCRIBE, so that the connection
ends without a reset, and it reads to the end. While it is connected (World has the daemon connect after it) it gets every
acknowledged message. The broker itself never repeats a message to it.

A subscriber with QoS 0 cannot see the publisher's QoS. So a second subscriber, the Witness, receives all messages with QoS 2 and
acknowledges them. It may lose messages when the broker dies.
"""
import contextlib
import json
import socket
import threading
import time

from forwarding import Heard

USER = "listener"  # user name of both, for the broker's access list
NAME = len(USER).to_bytes(2, "big") + USER.encode()
# MQTT 3.1.1, clean session, a user name, no keep-alive
CONNECT = b"\x10\x1a\x00\x04MQTT\x04\x82\x00\x00\x00\x04soak" + NAME
# MQTT 5, clean start, a user name, no keep-alive, Receive Maximum 65535, Maximum Packet Size left out: no bound
WITNESS_CONNECT = b"\x10\x21\x00\x04MQTT\x05\x82\x00\x00\x03\x21\xff\xff\x00\x07witness" + NAME
NO_RETAINED_AS_PUBLISHED_QOS_2 = 0x20 | 0x08 | 2  # options of a subscription, MQTT 5 section 3.8.3.1
CONNACK, PUBLISH, PUBREL, SUBACK = 2, 3, 6, 9
PUBACK, PUBREC, PUBCOMP = b"\x40\x02", b"\x50\x02", b"\x70\x02"  # with the packet id after it: success


class Listener:
    """Reads what the broker writes to one subscription to everything below the prefix."""
    connect_packet = CONNECT
    options = 0
    properties = b""  # of SUBSCRIBE

    def __init__(self, port, prefix):
        self.port, self.prefix = port, prefix
        self.thread = None

    def connect(self):
        """Connects and subscribes. Returns True once the broker has granted the subscription."""
        self.has_subscribed = threading.Event()
        self.connection = connection = socket.create_connection(("127.0.0.1", self.port))
        topic = f"{self.prefix}/#".encode()
        body = b"\x00\x01" + self.properties + len(topic).to_bytes(2, "big") + topic + bytes([self.options])
        connection.sendall(self.connect_packet + bytes([0x82, len(body)]) + body)
        self.thread = threading.Thread(target=self.read, args=(connection,), daemon=True)
        self.thread.start()
        return self.has_subscribed.wait(30)

    def wait_for_end(self):
        """Reads the rest of what the broker wrote before it died. Returns True at the end of the connection."""
        self.thread.join(30)
        return not self.thread.is_alive()

    def read(self, connection):
        buffer = bytearray()
        while True:
            try:
                octets = connection.recv(1 << 16)
            except ConnectionError:
                octets = b""
            if not octets:
                return connection.close()
            buffer += octets
            while self.take_packet(buffer):
                pass

    def take_packet(self, buffer):
        """Handles and removes the first packet of the buffer. Returns False if it is incomplete."""
        size, begin = 0, 1
        while True:
            if begin >= len(buffer):
                return False
            size |= (buffer[begin] & 0x7F) << 7 * (begin - 1)
            begin += 1
            if buffer[begin - 1] < 0x80:
                break
        if len(buffer) < begin + size:
            return False
        kind, flags, body = buffer[0] >> 4, buffer[0] & 15, bytes(buffer[begin:begin + size])
        del buffer[:begin + size]
        if kind == PUBLISH:
            topic_size = int.from_bytes(body[:2], "big")
            self.on_publish(flags, body[2:2 + topic_size].decode(), body[2 + topic_size:])
        elif kind == PUBREL:
            self.answer(PUBCOMP, body[:2])
        elif kind == SUBACK:
            self.has_subscribed.set()
        return True


class Subscriber(Listener):
    def __init__(self, port, prefix):
        super().__init__(port, prefix)
        self.messages = []  # (time, topic, payload), in the broker's order
        self.online_at = 0.0  # when the daemon last reported that it is connected

    def on_publish(self, flags, topic, payload):
        if flags & 1:  # retained from before the subscription
            return
        self.messages.append((time.time(), topic, payload))
        if topic.startswith(f"{self.prefix}/gateway/") and topic.endswith("/state"):
            if json.loads(payload)["state"] == "online":
                self.online_at = time.time()


class Witness(Listener):
    connect_packet = WITNESS_CONNECT
    options = NO_RETAINED_AS_PUBLISHED_QOS_2
    properties = b"\x00"

    def __init__(self, port, prefix):
        super().__init__(port, prefix)
        self.heard = []

    def on_publish(self, flags, topic, rest):
        qos = flags >> 1 & 3
        if qos > 0:
            self.answer(PUBACK if qos == 1 else PUBREC, rest[:2])
            rest = rest[2:]
        self.heard.append(Heard(time.time(), topic, payload_of(rest), qos, bool(flags & 1)))

    def answer(self, kind, packet_id):
        with contextlib.suppress(OSError):  # the broker died; `read` sees it
            self.connection.sendall(kind + packet_id)


def payload_of(rest):
    """Returns the octets after the properties, whose length comes first."""
    length, at = 0, 0
    while True:
        length |= (rest[at] & 0x7F) << 7 * at
        at += 1
        if rest[at - 1] < 0x80:
            return rest[at + length:]
