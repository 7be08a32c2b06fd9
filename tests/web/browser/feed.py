#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""feed.py PORT ROBOTS: publishes five updates a second of each of ROBOTS robots over one plain MQTT 3.1.1 connection."""
import math
import random
import socket
import struct
import sys
import time

port, robots = int(sys.argv[1]), int(sys.argv[2])
broker = socket.create_connection(("127.0.0.1", port))
name = b"feed"
body = struct.pack("!H4sBBHH", 4, b"MQTT", 4, 2, 0, len(name)) + name
broker.sendall(bytes([0x10, len(body)]) + body)
broker.recv(4)


def update(number, turn):
    at = turn / 60 + number
    x, y = 40 * math.cos(at * 0.7), 40 * math.sin(at)
    pairs = [x, y]
    for beam in range(4):
        angle = at + beam * math.pi / 2 + random.random() / 9
        along = x * math.cos(angle) + y * math.sin(angle)
        reach = math.sqrt(along * along + 6400 - x * x - y * y) - along
        if reach <= 80:
            pairs += [x + reach * math.cos(angle), y + reach * math.sin(angle)]
    return struct.pack(f"<{len(pairs)}h", *map(round, pairs))


turn = 0
started = time.monotonic()
while True:
    for number in range(robots):
        topic = f"ntnu-slam/robot/robot{number + 1}/update".encode()
        packet = struct.pack("!H", len(topic)) + topic + update(number, turn)
        broker.sendall(bytes([0x30, len(packet)]) + packet)
        time.sleep(max(0, started + (turn + (number + 1) / robots) / 5 - time.monotonic()))
    turn += 1
