# SPDX-License-Identifier: Apache-2.0
"""The soak's two subscribers receive all messages from Mosquitto, the witness with QoS and retain flag as published. Run as a test
(ctest -R Soak.Subscribers)."""
import contextlib
import pathlib
import socket
import subprocess
import sys
import tempfile
import time
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from program import Program, free_port  # noqa: E402
from subscriber import Subscriber, Witness  # noqa: E402

PATIENCE_S = 30
LONG = "x" * 300  # its length takes two octets


def wait_for(condition):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            raise AssertionError("not in time")
        time.sleep(0.01)


class Subscribers(unittest.TestCase):
    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.port = free_port(socket.SOCK_STREAM)
        self.broker = Program(pathlib.Path(directory.name), "broker", ["mosquitto", "-p", self.port])
        self.broker.start()
        self.addCleanup(lambda: (self.broker.process.kill(), self.broker.process.wait()))
        wait_for(self.accepts_connections)

    def accepts_connections(self):
        with contextlib.suppress(ConnectionError), socket.create_connection(("127.0.0.1", self.port)):
            return True
        return False

    def publish(self, topic, text, *options):
        subprocess.run(["mosquitto_pub", "-p", str(self.port), "-t", topic, "-m", text, *options], timeout=PATIENCE_S, check=True)

    def test_the_witness_sees_qos_and_retain_flag_as_published(self):
        self.publish("slam/robot/r1/old", "from before", "-q", "1", "-r")
        subscriber, witness = Subscriber(self.port, "slam"), Witness(self.port, "slam")
        self.assertTrue(subscriber.connect() and witness.connect())
        for qos in "0", "1", "2":
            self.publish("slam/robot/r1/update", LONG + qos, "-q", qos)
            self.publish("slam/robot/r1/update", LONG + qos, "-q", qos, "-r", "-V", "5", "-D", "publish", "user-property", "mesh", "ble")
        wait_for(lambda: len(subscriber.messages) == len(witness.heard) == 6)
        self.assertEqual([(one.qos, one.retain) for one in witness.heard], [(qos, retain) for qos in range(3) for retain in (False, True)])
        self.assertEqual([(one.topic, one.payload) for one in witness.heard],
                         [("slam/robot/r1/update", f"{LONG}{qos}".encode()) for qos in "001122"])
        self.assertEqual([message[1:] for message in subscriber.messages], [(one.topic, one.payload) for one in witness.heard])
        self.broker.process.kill()
        self.assertTrue(subscriber.wait_for_end() and witness.wait_for_end())

    def test_the_witness_receives_more_than_mosquittos_window(self):
        """Mosquitto sends a bounded number of messages without acknowledgements."""
        witness = Witness(self.port, "slam")
        self.assertTrue(witness.connect())
        lines = "".join(f"{n}\n" for n in range(200))
        for qos in "1", "2":
            subprocess.run(["mosquitto_pub", "-p", str(self.port), "-t", "slam/robot/r1/update", "-l", "-q", qos], input=lines.encode(),
                           timeout=PATIENCE_S, check=True)
        wait_for(lambda: len(witness.heard) == 400)
        self.assertEqual([int(one.payload) for one in witness.heard], [*range(200), *range(200)])


if __name__ == "__main__":
    unittest.main()
