# SPDX-License-Identifier: Apache-2.0
"""The network of gateways, brokers and robots: the loopback, or private network namespaces. There each gateway has its own namespace
with a link to the robots and one to the brokers, which can be cut. Used by run."""
import contextlib
import ctypes
import os
import socket
import subprocess

CLONE_NEWNET = 0x40000000
BROKERS, ROBOTS = "10.77.0", "10.78.0"


class Loopback:
    broker_host = "127.0.0.1"

    def gateway_host(self, _):
        return "127.0.0.1"

    def among_brokers(self):
        return contextlib.nullcontext()

    among_robots = among_brokers

    def broker_prefix(self):
        return ()

    def gateway_prefix(self, _):
        return ()

    def end(self):
        pass


def ip(*arguments):
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise OSError(f"ip {' '.join(arguments)}: {done.stderr.strip()}")


class Namespaces:
    """Network namespaces: one for each gateway, and two with a bridge, for brokers and robots. Needs root."""

    broker_host = f"{BROKERS}.1"

    def __init__(self, gateways):
        base = f"slamgw-{os.getpid()}"
        self.brokers, self.robots = f"{base}-brokers", f"{base}-robots"
        self.gateways = [f"{base}-gw{i}" for i in range(gateways)]
        self.made = []
        try:
            self.make_switch(self.brokers, f"{BROKERS}.1")
            self.make_switch(self.robots, f"{ROBOTS}.1")
            for i, name in enumerate(self.gateways):
                self.make_namespace(name)
                self.plug(name, "brokers", self.brokers, i, f"{BROKERS}.{10 + i}")
                self.plug(name, "robots", self.robots, i, f"{ROBOTS}.{10 + i}")
        except OSError:
            self.end()
            raise

    def make_namespace(self, name):
        ip("netns", "add", name)
        self.made.append(name)
        ip("-n", name, "link", "set", "lo", "up")

    def make_switch(self, name, address):
        self.make_namespace(name)
        ip("-n", name, "link", "add", "switch", "type", "bridge")
        ip("-n", name, "address", "add", f"{address}/24", "dev", "switch")
        ip("-n", name, "link", "set", "switch", "up")

    def plug(self, name, link, switch, i, address):
        ip("-n", name, "link", "add", link, "type", "veth", "peer", "name", f"port{i}", "netns", switch)
        ip("-n", switch, "link", "set", f"port{i}", "master", "switch", "up")
        ip("-n", name, "address", "add", f"{address}/24", "dev", link)
        ip("-n", name, "link", "set", link, "up")

    def gateway_host(self, i):
        return f"{ROBOTS}.{10 + i}"

    def broker_prefix(self):
        return ("ip", "netns", "exec", self.brokers)

    def gateway_prefix(self, i):
        return ("ip", "netns", "exec", self.gateways[i])

    def among_brokers(self):
        return inside(self.brokers)

    def among_robots(self):
        return inside(self.robots)

    def cut(self, gateway):
        """Cuts the gateway off the brokers at the switch: packets in both directions are lost."""
        ip("-n", self.brokers, "link", "set", f"port{gateway}", "nomaster")

    def join(self, gateway):
        ip("-n", self.brokers, "link", "set", f"port{gateway}", "master", "switch")

    def end(self):
        for name in self.made:
            with contextlib.suppress(OSError):
                ip("netns", "delete", name)
        self.made = []


@contextlib.contextmanager
def inside(namespace):
    """Enters the namespace. A socket stays in the namespace in which it was made."""
    with open("/proc/self/ns/net") as own, open(f"/run/netns/{namespace}") as other:
        enter(other)
        try:
            yield
        finally:
            enter(own)


def enter(namespace):
    if ctypes.CDLL(None, use_errno=True).setns(namespace.fileno(), CLONE_NEWNET) != 0:
        raise OSError(ctypes.get_errno(), "setns")


def make_socket(place, kind):
    with place():
        return socket.socket(socket.AF_INET, kind)
