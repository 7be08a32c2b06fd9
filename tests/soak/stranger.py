# SPDX-License-Identifier: Apache-2.0
"""MQTT-SN clients that nobody asked for. Used by acts."""
import contextlib
import socket

CONNECT, CLEAN_SESSION = 0x04, 0x04


def connect_packet(name):
    body = bytes([CONNECT, CLEAN_SESSION, 1]) + (60).to_bytes(2, "big") + name.encode()
    return bytes([len(body) + 1]) + body


class Stranger:
    def __init__(self, gateway_port):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", gateway_port))

    def send_crowd(self, count):
        for number in range(count):
            with contextlib.suppress(OSError):
                self.socket.send(connect_packet(f"stranger{number}"))
