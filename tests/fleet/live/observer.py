# SPDX-License-Identifier: Apache-2.0
"""A small MQTT 3.1.1 client that hears everything below the prefix and publishes commands. Used by run."""
import socket
import time


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
    def __init__(self, port, prefix, name="observer"):
        self.messages, self.retained, self.buffer, self.msg_id = [], {}, bytearray(), 0
        self.is_subscribed = False
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        self.socket.sendall(frame(0x10, text("MQTT") + b"\x04\x02\x00\x00" + text(name)))
        if self.socket.recv(4) != b"\x20\x02\x00\x00":
            raise OSError("the broker does not accept the observer yet")
        self.socket.sendall(frame(0x82, b"\x00\x01" + text(f"{prefix}/#") + b"\x00"))
        self.socket.setblocking(False)
        deadline = time.monotonic() + 10
        while not self.is_subscribed:
            if time.monotonic() > deadline:
                raise OSError("the broker does not answer the observer's subscription")
            self.receive()
            time.sleep(0.01)

    def publish(self, topic, payload):
        self.msg_id = self.msg_id % 65535 + 1
        self.socket.setblocking(True)
        self.socket.sendall(frame(0x32, text(topic) + self.msg_id.to_bytes(2, "big") + payload.encode()))
        self.socket.setblocking(False)

    def receive(self):
        try:
            while octets := self.socket.recv(1 << 16):
                self.buffer += octets
        except BlockingIOError:
            pass
        while self.take():
            pass

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
        self.is_subscribed = self.is_subscribed or kind >> 4 == 9
        if kind >> 4 == 3:
            size = int.from_bytes(body[:2], "big")
            topic, payload = body[2:2 + size].decode(), body[2 + size:]
            self.retained[topic] = payload
            if not kind & 1:
                self.messages.append((time.monotonic(), topic, payload))
        return True
