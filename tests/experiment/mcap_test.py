# SPDX-License-Identifier: Apache-2.0
"""events.mcap is read back by an independent reader: npm's @mcap/core, in build/<preset>/mcap or where MCAP_CORE says.

Skipped where it is not installed: npm install --prefix build/dev/mcap @mcap/core@2
"""
import json
import os
import shutil
import subprocess
import sys
import tempfile
import unittest

from slamgw_experiment import mcap
from slamgw_experiment.events import GATEWAY, ROBOTS, Event

READER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "read_mcap.cjs")
CORE = os.environ.get("MCAP_CORE", "")


def some_events(count):
    for n in range(count):
        yield Event(t_us=n * 1000, source=GATEWAY, event="arrived", robot="robot1", mesh="ble", type="update", direction="up",
                    payload="0a00ecff64002c0107", bytes=9)
        yield Event(t_us=n * 1000 + 1, source=GATEWAY, event="arrived", robot="robot1", mesh="ble", type="probe", direction="up",
                    number=n, sender_ms=n * 200, payload="00", bytes=6)
        yield Event(t_us=n * 1000 + 2, source=GATEWAY, event="arrived", robot='odd "1', mesh="ble", type="adv", direction="up",
                    payload="ff")
        yield Event(t_us=n * 1000 + 3, source=ROBOTS, event="sent", robot="robot1", number=n)


class ReadBack(unittest.TestCase):
    def read(self, count):
        with tempfile.TemporaryDirectory() as directory:
            path = os.path.join(directory, "events.mcap")
            mcap.write(path, list(some_events(count)), 1_000_000_000_000_000)
            said = subprocess.run(["node", READER, path], capture_output=True, text=True, timeout=50, check=False,
                                  env={**os.environ, "NODE_PATH": CORE})
            self.assertEqual(said.returncode, 0, said.stderr)
            return json.loads(said.stdout)

    def test_all_messages_with_their_schemas_over_several_chunks(self):
        read = self.read(1000)
        self.assertEqual(read["statistics"], {"messages": 7000, "chunks": 7, "first": "1000000000000000000",
                                              "last": "1000000000999003000"})
        self.assertEqual({topic: (one["schema"], one["count"]) for topic, one in read["topics"].items()}, {
            "/events/gateway": ("slam_gateway.Event", 3000), "/events/robots": ("slam_gateway.Event", 1000),
            "/robot/robot1/update": ("slam_gateway.Update", 1000), "/robot/robot1/probe": ("slam_gateway.Probe", 1000),
            '/robot/odd "1/adv': ("slam_gateway.Bytes", 1000)})
        self.assertEqual(read["topics"]["/robot/robot1/update"]["last"], {"x": 10, "y": -20, "obstacles": [{"x": 100, "y": 300}]})
        self.assertEqual(read["topics"]["/robot/robot1/probe"]["last"], {"number": 999, "sender_ms": 199800})
        self.assertEqual(read["streamed"], 7000, "the reader of streams sees what the reader with an index sees")
        for name, schema in read["schemas"].items():
            self.assertEqual((schema["encoding"], schema["text"]["title"]), ("jsonschema", name))

    def test_every_message_has_what_its_schema_requires(self):
        read = self.read(5)
        for one in read["topics"].values():
            for name in read["schemas"][one["schema"]]["text"]["required"]:
                self.assertIn(name, one["last"])

    def test_an_empty_run(self):
        self.assertEqual(self.read(0)["statistics"]["messages"], 0)


if __name__ == "__main__":
    if not shutil.which("node") or not os.path.isdir(os.path.join(CORE, "@mcap", "core")):
        print("skipped: node or @mcap/core is not installed")
        sys.exit(77)
    unittest.main()
