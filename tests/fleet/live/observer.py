# SPDX-License-Identifier: Apache-2.0
"""A small MQTT 3.1.1 client that hears everything below the prefix and publishes commands. Used by observers."""
import socket
import time

from streams import Stream

ANSWER_S = 10
CONNACK, PUBLISH, PUBACK, SUBACK = 2, 3, 4, 9
DUP, QOS, RETAIN = 0x08, 0x06, 0x01
USER, PASSWORD, CLEAN_SESSION, SESSION_PRESENT = 0x80, 0x40, 0x02, 0x01


def text(value):
    return len(value.encode()).to_bytes(2, "big") + value.encode()


def frame(kind, body):
    size, length = bytearray(), len(body)
    while True:
        size.append(length % 128 | (0x80 if length > 127 else 0))
        length //= 128
        if not length:
            return bytes([kind]) + bytes(size) + body


class Observer:
    """On one node. It connects again when that breaks. A live one has missed what came meanwhile; for a kept one the broker keeps it."""

    def __init__(self, address, prefix, name, user, make_socket, retry_s, stream=None):
        self.address, self.prefix, self.name, self.user, self.make_socket = address, prefix, name, user, make_socket
        self.retry_s, self.stream = retry_s, stream or Stream(is_kept=False)
        self.qos = 1 if self.stream.is_kept else 0
        self.retained = {}
        self.presence = []  # (time, topic, payload, is_retained): what the node says; without a topic when it does not say
        self.socket, self.begun = None, 0.0
        self.confirmed, self.unconfirmed, self.msg_id = set(), {}, 0
        self.acknowledgements = bytearray()  # not yet written
        self.is_subscribed = False
        self.session_is_subscribed = False  # the one that the broker keeps

    def connect(self):
        self.socket, self.buffer, self.begun = self.make_socket(socket.SOCK_STREAM), bytearray(), time.monotonic()
        self.unconfirmed, self.is_subscribed, self.retained = {}, False, {}
        self.acknowledgements.clear()
        self.socket.settimeout(0.5)
        self.socket.connect(self.address)
        flags = (0 if self.stream.is_kept else CLEAN_SESSION) | (USER | PASSWORD if self.user else 0)
        login = text(self.user) + text("any") if self.user else b""
        self.socket.sendall(frame(0x10, text("MQTT") + bytes([4, flags, 0, 0]) + text(self.name) + login))
        self.socket.setblocking(False)

    def fileno(self):
        return self.socket.fileno()

    def end(self):
        if self.socket:
            self.socket.close()
        if self.is_subscribed:
            now = time.monotonic()
            self.presence.append((now, None, None, False))
            self.stream.end_connection(now)
        self.socket, self.is_subscribed = None, False

    def publish(self, topic, payload, key):
        """`key` is in `confirmed` as soon as the broker has it."""
        self.msg_id = self.msg_id % 65535 + 1
        self.unconfirmed[self.msg_id] = key
        self.write(frame(0x32, text(topic) + self.msg_id.to_bytes(2, "big") + payload.encode()))

    def write(self, octets):
        try:
            self.socket.settimeout(0.5)
            self.socket.sendall(octets)
            self.socket.setblocking(False)
        except OSError:
            self.end()

    def receive(self):
        """To be called again and again."""
        try:
            if not self.socket:
                if time.monotonic() - self.begun < self.retry_s:
                    return
                self.connect()
            while octets := self.socket.recv(1 << 16):
                self.buffer += octets
            self.end()
            return
        except BlockingIOError:
            pass
        except OSError:
            self.end()
            return
        while self.socket and self.take():
            pass
        if self.socket and self.acknowledgements:
            self.write(bytes(self.acknowledgements))
            self.acknowledgements.clear()
        if self.socket and not self.is_subscribed and time.monotonic() - self.begun > ANSWER_S:
            self.end()

    def take(self):
        length, shift, at = 0, 0, 1
        while True:
            if at >= len(self.buffer):
                return False
            length |= (self.buffer[at] & 127) << shift
            shift, at = shift + 7, at + 1
            if self.buffer[at - 1] < 128:
                break
        if len(self.buffer) < at + length:
            return False
        kind, body = self.buffer[0], bytes(self.buffer[at:at + length])
        del self.buffer[:at + length]
        self.on_packet(kind, body)
        return True

    def on_packet(self, kind, body):
        if kind >> 4 == CONNACK:
            self.on_connack(body[0] & SESSION_PRESENT, body[1])
        elif kind >> 4 == SUBACK:
            if body[2] != self.qos:
                return self.end()
            self.begin(has_session=False)
        elif kind >> 4 == PUBACK:
            self.confirmed.add(self.unconfirmed.pop(int.from_bytes(body[:2], "big"), None))
        elif kind >> 4 == PUBLISH:
            self.on_publish(kind, body)

    def on_connack(self, has_session, code):
        if code != 0:
            return self.end()
        if has_session and self.session_is_subscribed:
            return self.begin(has_session=True)
        self.session_is_subscribed = False
        self.write(frame(0x82, b"\x00\x01" + text(f"{self.prefix}/#") + bytes([self.qos])))

    def begin(self, has_session):
        self.is_subscribed, self.session_is_subscribed = True, self.stream.is_kept
        self.stream.begin_connection(time.monotonic(), has_session)

    def on_publish(self, kind, body):
        size = int.from_bytes(body[:2], "big")
        topic, payload = body[2:2 + size].decode(), body[2 + size:]
        if kind & QOS:
            self.acknowledgements += frame(0x40, payload[:2])
            payload = payload[2:]
        self.retained[topic] = payload
        if "/robots/" in topic:
            self.presence.append((time.monotonic(), topic, payload, bool(kind & RETAIN)))
        if not kind & RETAIN:
            self.stream.add(time.monotonic(), topic, payload, bool(kind & DUP))
