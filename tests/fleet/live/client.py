# SPDX-License-Identifier: Apache-2.0
"""A small MQTT 3.1.1 client that never blocks for long: call receive() regularly. Observers and hostile clients are such clients.
Used by observer, acts and run."""
import socket
import time

ANSWER_S = 10
CONNACK, PUBLISH, PUBACK, PUBREC, PUBCOMP, SUBACK = 2, 3, 4, 5, 7, 9
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


class Client:
    def __init__(self, address, name, user, make_socket, is_clean=True, user_of=None):
        """`user`: (name -> user name), or None if the broker needs no user names. `user_of`: the name, if it differs from the client's."""
        self.address, self.name, self.make_socket, self.is_clean = address, name, make_socket, is_clean
        self.user = user(user_of or name) if user else None
        self.socket, self.begun = None, 0.0
        self.is_connected = self.has_session = False
        self.confirmed, self.unconfirmed, self.msg_id = set(), {}, 0
        self.answers = bytearray()  # not yet written
        self.granted = []  # the broker's answers to SUBSCRIBE
        self.heard = []  # (topic, payload)

    def connect(self):
        self.socket, self.buffer, self.begun = self.make_socket(socket.SOCK_STREAM), bytearray(), time.monotonic()
        self.unconfirmed, self.is_connected, self.granted = {}, False, []
        self.answers.clear()
        self.socket.settimeout(0.5)
        try:
            self.socket.connect(self.address)
        except OSError:
            return self.end()
        flags = (CLEAN_SESSION if self.is_clean else 0) | (USER | PASSWORD if self.user else 0)
        login = text(self.user) + text("any") if self.user else b""
        self.write(frame(0x10, text("MQTT") + bytes([4, flags, 0, 0]) + text(self.name) + login))
        return None

    def fileno(self):
        return self.socket.fileno()

    def end(self):
        if self.socket:
            self.socket.close()
        self.socket, self.is_connected = None, False

    def next_id(self):
        self.msg_id = self.msg_id % 65535 + 1
        return self.msg_id

    def subscribe(self, topic_filter, qos):
        self.write(frame(0x82, self.next_id().to_bytes(2, "big") + text(topic_filter) + bytes([qos])))

    def publish(self, topic, payload, qos=1, retain=False, key=None):
        """Publishes a message. `key` is in `confirmed` once the broker has acknowledged it."""
        number = b""
        if qos:
            self.unconfirmed[self.next_id()] = key
            number = self.msg_id.to_bytes(2, "big")
        self.write(frame(0x30 | qos << 1 | retain, text(topic) + number + payload))

    def write(self, octets):
        try:
            self.socket.settimeout(0.5)
            self.socket.sendall(octets)
            self.socket.setblocking(False)
        except (OSError, AttributeError):
            self.end()

    def receive(self):
        try:
            while self.socket and (octets := self.socket.recv(1 << 16)):
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
        if self.socket and self.answers:
            self.write(bytes(self.answers))
            self.answers.clear()

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
        if kind >> 4 == CONNACK and body[1] == 0:
            self.is_connected, self.has_session = True, bool(body[0] & SESSION_PRESENT)
            self.on_connected()
        elif kind >> 4 == CONNACK:
            self.end()
        elif kind >> 4 == SUBACK:
            self.granted += body[2:]
            self.on_granted(body[2])
        elif kind >> 4 in (PUBACK, PUBREC):
            self.confirmed.add(self.unconfirmed.pop(int.from_bytes(body[:2], "big"), None))
            self.answers += frame(0x62, body[:2]) if kind >> 4 == PUBREC else b""
        elif kind >> 4 == PUBLISH:
            size = int.from_bytes(body[:2], "big")
            topic, payload = body[2:2 + size].decode(), body[2 + size:]
            if kind & QOS:
                self.answers += frame(0x40, payload[:2])
                payload = payload[2:]
            self.on_message(topic, payload, bool(kind & RETAIN), bool(kind & DUP))

    def on_connected(self):
        pass

    def on_granted(self, qos):
        pass

    def on_message(self, topic, payload, is_retained, is_dup):
        self.heard.append((topic, payload))
