# SPDX-License-Identifier: Apache-2.0
"""A broker with MQTT 3.1.1 only: a proxy before the real broker that refuses each CONNECT of MQTT 5. Used by World;
as a program (proxy.py BROKER-PORT) it prints its own port and serves until it is ended."""
import contextlib
import selectors
import socket
import sys
import threading

REFUSED = bytes([0x20, 3, 0, 0x84, 0])  # CONNACK of MQTT 5: unsupported protocol version
LEVEL_AT = 7  # after the length field, whose size varies: the name "MQTT" and its length are before it


class Mqtt311Proxy:
    def __init__(self, broker_port):
        self.broker_port = broker_port
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            client, _ = self.listener.accept()
            threading.Thread(target=self.serve, args=(client,), daemon=True).start()

    def serve(self, client):
        with client, contextlib.suppress(OSError):
            connect = client.recv(4096)
            while len(connect) < 16 and (more := client.recv(4096)):
                connect += more
            if len(connect) < 16:  # the client only tested the port
                return None
            body_at = next(at for at in range(1, 5) if connect[at] < 0x80) + 1
            if connect[body_at + LEVEL_AT - 1] == 5:
                return client.sendall(REFUSED)
            with socket.create_connection(("127.0.0.1", self.broker_port)) as broker:
                broker.sendall(connect)
                pump(client, broker)
        return None


def pump(client, broker):
    """Passes octets on in both directions until one side closes its connection."""
    other = {client: broker, broker: client}
    with selectors.DefaultSelector() as readable:
        for one in other:
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            readable.register(one, selectors.EVENT_READ)
        while True:
            for key, _ in readable.select():
                octets = key.fileobj.recv(1 << 16)
                if not octets:
                    return
                other[key.fileobj].sendall(octets)


if __name__ == "__main__":
    print(Mqtt311Proxy(int(sys.argv[1])).port, flush=True)
    threading.Event().wait()
