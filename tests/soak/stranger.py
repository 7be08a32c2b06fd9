# SPDX-License-Identifier: Apache-2.0
"""MQTT-SN clients that nobody asked for. Used by acts."""
import contextlib
import socket

CONNECT, CONNACK, REGISTER, REGACK, PUBLISH, PUBACK = 0x04, 0x05, 0x0A, 0x0B, 0x0C, 0x0D
CLEAN_SESSION, QOS_1 = 0x04, 0x20


def packet(kind, body):
    length = len(body) + 2
    return bytes([length, kind]) + body if length < 256 else b"\x01" + (length + 2).to_bytes(2, "big") + bytes([kind]) + body


def connect_packet(name):
    return packet(CONNECT, bytes([CLEAN_SESSION, 1]) + (60).to_bytes(2, "big") + name.encode())


class Stranger:
    def __init__(self, gateway_port):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", gateway_port))
        self.socket.settimeout(1)

    def ask(self, request, kind):
        """Sends until answered; the body of the answer."""
        for _ in range(30):
            with contextlib.suppress(OSError):
                self.socket.send(request)
                answer = self.socket.recv(2048)
                if answer[1] == kind:
                    return answer[2:]
        return None

    def publish(self, name, topic, payload):
        """One message of QoS 1. True when it was acknowledged."""
        self.ask(connect_packet(name), CONNACK)
        answer = self.ask(packet(REGISTER, b"\0\0\0\1" + topic.encode()), REGACK)
        if answer is None or answer[4] != 0:
            return False
        answer = self.ask(packet(PUBLISH, bytes([QOS_1]) + answer[:2] + b"\0\2" + payload), PUBACK)
        return answer is not None and answer[4] == 0

    def send_crowd(self, count):
        for number in range(count):
            with contextlib.suppress(OSError):
                self.socket.send(connect_packet(f"stranger{number}"))
