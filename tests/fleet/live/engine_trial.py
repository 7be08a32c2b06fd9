# SPDX-License-Identifier: Apache-2.0
"""Checks what robots' sessions need from an engine. A client id that connects at another node takes over its session with
subscriptions and waiting messages. The former connection is closed. Used by run --engine-only."""
import functools
import shutil
import time

from client import Client
from network import make_socket

START_S, ANSWER_S, MOVES = 120, 15, 5
TOPIC = "p/server/r1/run"


def try_engine(engine, network):
    begin = time.monotonic()
    try:
        engine.start()
        started = time.monotonic() - begin
        failure = move_session(engine, functools.partial(make_socket, network.among_brokers))
    finally:
        engine.stop()
    print(f"{type(engine).__name__}: {len(engine.nodes)} nodes, started after {started:.1f} s, "
          f"{f'{MOVES} moves, {time.monotonic() - begin - started:.1f} s' if not failure else failure}")
    left = [each.name for each in engine.programs() if each.is_running()]
    shutil.rmtree(engine.directory)
    return 1 if failure or left else 0


def wait(clients, condition, most_s=ANSWER_S):
    deadline = time.monotonic() + most_s
    while not (found := condition()) and time.monotonic() < deadline:
        for client in clients:
            if client.socket:
                client.receive()
        time.sleep(0.002)
    return found


def move_session(engine, make):
    """Returns a description of the failure, or None."""
    nodes = range(len(engine.nodes))

    def connected(name, node, is_clean, most_s=ANSWER_S):
        deadline = time.monotonic() + most_s
        while time.monotonic() < deadline:
            client = Client((engine.host, engine.ports[node]), name, engine.user, make, is_clean)
            client.connect()
            if wait([client], lambda: client.is_connected or not client.socket, 5) and client.is_connected:
                return client
            client.end()
            time.sleep(0.2)
        return None

    if not wait([], lambda: all(engine.is_well(node) for node in nodes), START_S):
        return "its nodes are not ready"
    senders = [connected(f"sender{node}", node, True, START_S) for node in nodes]
    holder = connected("p-robot-r1", 0, False)
    if None in senders or not holder:
        return "clients cannot connect"
    holder.subscribe("p/server/r1/+", 1)
    if not wait([holder], lambda: holder.granted == [1]):
        return f"SUBSCRIBE was answered with {holder.granted}"
    for move in range(1, MOVES + 1):
        time.sleep(engine.move_pause_s)
        former, node = holder, move % len(nodes)
        holder = connected("p-robot-r1", node, False)
        if not holder or not holder.has_session:
            return f"move {move}: " + ("the session is not present" if holder else "the connection was refused")
        if not wait([former], lambda: not former.socket):
            return f"move {move}: the former connection is not closed"
        for number, sender in enumerate(senders):
            sender.publish(TOPIC, f"{move} {number}".encode())
        expected = {(TOPIC, f"{move} {number}".encode()) for number in range(len(senders))}
        if not wait([holder, *senders], lambda: expected <= set(holder.heard)):
            return f"move {move}: received only {holder.heard}"
    return None
