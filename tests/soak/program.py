# SPDX-License-Identifier: Apache-2.0
"""A program that the soak runs, breaks and starts again, and a port for it. Used by World."""
import contextlib
import random
import socket
import subprocess

PATIENCE_S = 120  # only a failure takes this long


class Failure(Exception):
    pass


class Program:
    """A program that the kernel ends with this process."""

    def __init__(self, directory, name, arguments):
        self.log = directory / f"{name}.log"
        self.name, self.arguments = name, ["setpriv", "--pdeathsig", "KILL", *map(str, arguments)]
        self.process = None

    def start(self):
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(self.arguments, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def is_running(self):
        return self.process is not None and self.process.poll() is None

    def send(self, signal_number):
        self.process.send_signal(signal_number)

    def end(self, signal_number):
        """Ends the program. Returns its exit status; negative: the signal that killed it."""
        if not self.is_running():
            raise Failure(f"{self.name} has ended by itself: {self.tail()}")
        self.send(signal_number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.process.wait(PATIENCE_S)
        raise Failure(f"{self.name} does not end")

    def tail(self):
        return f"status {self.process.poll()}, last lines:\n" + "\n".join(self.log.read_text().splitlines()[-8:])


drawn_ports = set()


def free_port(kind):
    """Returns a port below the range of ephemeral ports, so that it stays free while its program is down. Returns no port twice."""
    while True:
        port = random.SystemRandom().randrange(20000, 30000)
        if port in drawn_ports:
            continue
        with socket.socket(socket.AF_INET, kind) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            drawn_ports.add(port)
            return port
