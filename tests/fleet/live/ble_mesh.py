# SPDX-License-Identifier: Apache-2.0
"""One BLE mesh on two boards: the simulator's robots, which both boards hear, are provisioned by the first gateway; the second
one joins by export and import. Judges what the robots said against what came to the broker. Used by run."""
import json
import pathlib
import signal
import subprocess
from collections import Counter

from program import Program

HOST, GUEST = 0, 1  # gateways
TYPE = "ping"


class BleMesh:
    def __init__(self, options, directory):
        self.bin, self.directory, self.robots = pathlib.Path(options.bin), directory, options.ble
        self.ttys = [directory / f"board{i}" for i in (HOST, GUEST)]
        self.record, self.trace = directory / "ble.record", directory / "ble.trace"
        # The second board hears worse, so that robots go back to the first one when it is there again.
        self.simulator = Program(directory, "ble", [
            self.bin / "slam-gateway-sim", "ble", "--tty", ",".join(map(str, self.ttys)), "--unprovisioned", "--robots",
            options.ble, "--acknowledged", "--numbered", "--payload", "probe", "--rate", 4, "--seed", options.seed,
            "--board-level-db", "0,-20", "--board-loss", options.ble_loss, "--record", self.record, "--trace", self.trace])
        self.loss = options.ble_loss
        self.names = {}  # of the simulator: the gateways' names

    def configuration(self, gateway):
        """Of the gateway, for its file; nothing for one without a board."""
        if gateway > GUEST:
            return {}
        return {"ble_mesh": {"enabled": True, "device": str(self.port(gateway)), "flow_control": "none",
                             "address": f"0x{gateway + 1:04x}", "gateway_group": "0xc010", "types": {"min_com": TYPE}}}

    def port(self, gateway):
        return self.directory / f"port{gateway}"

    def ctl(self, gateway, *arguments):
        socket = self.directory / f"gw{gateway}" / "control.sock"
        return subprocess.run([self.bin / "slam-gatewayctl", "--socket", socket, "--json", *map(str, arguments)],
                              capture_output=True, text=True, timeout=30, check=False)

    def plug_in(self, gateway):
        self.port(gateway).symlink_to(self.ttys[gateway])

    def are_provisioned(self):
        answer = self.ctl(HOST, "ble", "nodes")
        nodes = json.loads(answer.stdout) if answer.returncode == 0 else []
        ready = [node for node in nodes if node["state"] == "configured"]
        self.names = {f"robot{int(node['uuid'][-4:], 16)}": node["robot"] for node in ready}
        return len(ready) == self.robots

    def join(self):
        """docs/fleet.md: export, import, plug the board in."""
        file = self.directory / "mesh.export"
        for gateway, verb in ((HOST, "export"), (GUEST, "import")):
            answer = self.ctl(gateway, "ble", verb, file)
            if answer.returncode != 0:
                raise OSError(f"ble {verb}: {answer.stderr}")
        self.plug_in(GUEST)

    def is_up(self, gateway):
        answer = self.ctl(gateway, "status")
        return answer.returncode == 0 and json.loads(answer.stdout)["meshes"]["ble"]["state"] == "up"

    def unplug(self):
        """One board after the other, for 2 s."""
        self.simulator.send(signal.SIGUSR2)

    def read_record(self):
        sent, acknowledged, repeats = {}, {}, Counter()
        for line in self.record.read_text().splitlines():
            what, robot, number, *rest = line.split()
            key = self.names[robot], int(number)
            if what == "sent":
                sent[key] = (rest[0], float(rest[1]))
            else:
                acknowledged[key] = float(rest[0])
        for line in self.trace.read_text().splitlines():
            event = json.loads(line)
            if event["event"] == "repeat":
                repeats[self.names[event["robot"]], event["number"]] += 1
        return sent, acknowledged, repeats

    def judge(self, messages, acts, outcomes):
        """`messages`: (time, topic, payload) of the broker. `acts`: how often a gateway or a board was taken away, after each of
        which every robot may change its owner."""
        sent, acknowledged, repeats = self.read_record()
        robots = set(self.names.values())
        arrived, claims = Counter(), Counter()
        for _, topic, payload in messages:
            levels = topic.split("/")
            if levels[1] == "robot" and levels[3] == TYPE:
                arrived[levels[2], payload.hex()] += 1
            elif levels[1] == "fleet" and b'"claim"' in payload:
                claims[json.loads(payload)["robot"]] += 1
        doubles = Counter()
        unrepeated = 0
        for (robot, number), (payload, _) in sent.items():
            extra = max(arrived[robot, payload] - 1, 0)
            doubles[robot] += extra
            unrepeated += 1 if extra > repeats[robot, number] else 0
        silence = sorted(at - sent[key][1] for key, at in acknowledged.items())
        received = json.loads(self.simulator.log.read_text().splitlines()[-1])["robots"]
        obeyed = {self.names[name]: robot["commands_received"] for name, robot in received.items()}
        commanded = Counter(robot for robot, _ in outcomes if robot in robots)
        delivered = Counter(robot for (robot, _), results in outcomes.items() if robot in robots and "delivered" in results)
        return {
            "ble_messages": len(acknowledged),
            "ble_lost": sum(1 for key in acknowledged if not arrived[key[0], sent[key][0]]),
            "ble_doubled": sum(doubles.values()),
            "ble_doubled_beyond": unrepeated + sum(max(0, doubles[robot] - claims[robot] - acts) for robot in robots),
            "ble_unknown": sum(1 for robot, _ in arrived if robot not in robots and robot.startswith("ble-")),
            "ble_claims": sum(claims[robot] for robot in robots),
            "ble_commands": sum(commanded.values()),
            # What is lost on the air is repeated, and the robot counts repeats too.
            "ble_commands_wrong": sum(1 for robot in robots if obeyed[robot] < delivered[robot] or
                                      (self.loss == 0 and obeyed[robot] > commanded[robot])),
            "ble_silence_p99_s": round(silence[len(silence) * 99 // 100], 3) if silence else None,
            "ble_silence_max_s": round(silence[-1], 3) if silence else None,
        }
