# SPDX-License-Identifier: Apache-2.0
"""Hostile MQTT-SN clients. Used by acts, and by ./dev siege."""
import contextlib
import socket

CONNECT, REGISTER, PUBLISH, SUBSCRIBE = 0x04, 0x0A, 0x0C, 0x12
CLEAN_SESSION, QOS_1 = 0x04, 0x20
# Mosquitto closes the connection of a client that sends these.
POISON = ("a\u0085", "a\u0001", "a\ufdd0", "a\ufffe", "a\U0001ffff", "/".join("a" * 202))


def packet(kind, body):
    length = len(body) + 2
    return (bytes([length]) if length < 256 else b"\x01" + (length + 2).to_bytes(2, "big")) + bytes([kind]) + body


def connect_packet(name):
    return packet(CONNECT, bytes([CLEAN_SESSION, 1]) + (60).to_bytes(2, "big") + name.encode())


class Stranger:
    def __init__(self, gateway_port):
        self.port = gateway_port
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", gateway_port))

    def send_crowd(self, count):
        for number in range(count):
            self.send(connect_packet(f"stranger{number}"))

    def send_poison(self, prefix):
        """Sends each POISON as a client id, as a topic of its own and of no robot, and as a filter. Then sends a message with each
        topic id."""
        self.send_crowd(1)
        for number, text in enumerate(POISON, 1):
            msg_id = number.to_bytes(2, "big")
            own = f"{prefix}/robot/stranger0/{text}"
            for topic in (own, text):
                self.send(packet(REGISTER, b"\0\0" + msg_id + topic.encode()))
                self.send(packet(SUBSCRIBE, bytes([QOS_1]) + msg_id + topic.encode()))
            self.send(packet(PUBLISH, bytes([QOS_1]) + msg_id + msg_id + b"poison"))
            Stranger(self.port).send(connect_packet(text))

    def send(self, octets):
        with contextlib.suppress(OSError):
            self.socket.send(octets)
