# SPDX-License-Identifier: Apache-2.0
"""Hears everything that the broker has acknowledged, also when the broker is killed in that moment. No general MQTT client.

Mosquitto writes a QoS 0 copy to a subscriber's socket before it acknowledges the message to its publisher, and the kernel
keeps what was written for the reader when the broker dies. This subscriber never writes after its SUBSCRIBE, so that the
connection ends without a reset, and reads to the end. While it is connected (World sees to it that the daemon connects after
it) nothing acknowledged by the broker can escape it; and the broker itself never repeats a message to it.
"""
import json
import socket
import threading
import time

CONNECT = b"\x10\x10\x00\x04MQTT\x04\x02\x00\x00\x00\x04soak"  # MQTT 3.1.1, clean session, no keep-alive
CONNACK, PUBLISH, SUBACK = 2, 3, 9


class Subscriber:
    def __init__(self, port, prefix):
        self.port, self.prefix = port, prefix
        self.messages = []  # (time, topic, payload), in the order in which the broker had them
        self.online_at = 0.0  # when the daemon last said that it is connected
        self.thread = None

    def connect(self):
        """Returns when the subscription stands."""
        self.has_subscribed = threading.Event()
        connection = socket.create_connection(("127.0.0.1", self.port))
        topic = f"{self.prefix}/#".encode()
        body = b"\x00\x01" + len(topic).to_bytes(2, "big") + topic + b"\x00"
        connection.sendall(CONNECT + bytes([0x82, len(body)]) + body)
        self.thread = threading.Thread(target=self.read, args=(connection,), daemon=True)
        self.thread.start()
        return self.has_subscribed.wait(30)

    def wait_for_end(self):
        """The broker is gone: reads what it had written."""
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
        """Takes the first packet from the buffer; False when it is not complete."""
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
        kind, is_retained, body = buffer[0] >> 4, buffer[0] & 1, bytes(buffer[begin:begin + size])
        del buffer[:begin + size]
        if kind == PUBLISH and not is_retained:
            topic_size = int.from_bytes(body[:2], "big")
            self.on_message(body[2:2 + topic_size].decode(), body[2 + topic_size:])
        elif kind == SUBACK:
            self.has_subscribed.set()
        return True

    def on_message(self, topic, payload):
        self.messages.append((time.time(), topic, payload))
        if topic.startswith(f"{self.prefix}/gateway/") and topic.endswith("/state"):
            if json.loads(payload)["state"] == "online":
                self.online_at = time.time()
