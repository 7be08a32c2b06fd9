# SPDX-License-Identifier: Apache-2.0
"""One BLE mesh on two boards or more. All boards hear the simulator's robots. The first gateway provisions them; the other gateways
join by export and import. Compares the robots' messages with those at the broker. Used by run."""
import datetime
import itertools
import json
import pathlib
import signal
import subprocess
import time
from collections import Counter, defaultdict

from program import Program

HOST = 0  # the gateway that provisions
FADE_S = 20  # in which a third board fades out and in once
TYPE = "ping"
# Within this time another gateway serves a robot and forwards its repeated message. A message that is lost on the air is forwarded with
# its next repeat, and the intervals of repeats grow.
SILENCE_S = 5
REPEAT_S = 1  # from a repeat until it is acknowledged
CHANGE_S = 1.0  # from a change of service until its presence is at the broker, on a busy machine
REPEAT_MS = 100  # a command that is not acknowledged for this time is sent again


class BleMesh:
    def __init__(self, options, directory):
        self.bin, self.directory, self.robots = pathlib.Path(options.bin), directory, options.ble
        self.gateways = range(options.boards)
        self.ttys = [directory / f"board{i}" for i in self.gateways]
        self.record, self.trace = directory / "ble.record", directory / "ble.trace"
        # The second board hears worse, so that robots return to the first one when it is back. A third one hears best while it is not
        # faded out.
        self.simulator = Program(directory, "ble", [
            self.bin / "slam-gateway-sim", "ble", "--tty", ",".join(map(str, self.ttys)), "--unprovisioned", "--robots",
            options.ble, "--acknowledged", "--numbered", "--payload", "probe", "--rate", 4, "--seed", options.seed,
            "--board-level-db", "0,-20,15", "--board-fade", f"0,0,{FADE_S}", "--board-loss", options.ble_loss, "--record", self.record, "--trace", self.trace])
        self.is_lossy = options.ble_loss > 0 or options.boards > 2
        self.names = {}  # by the simulator's name: the gateways' name

    def configuration(self, gateway):
        """Returns this gateway's section of the configuration; empty without a board."""
        if gateway not in self.gateways:
            return {}
        return {"ble_mesh": {"enabled": True, "device": str(self.port(gateway)), "flow_control": "none",
                             "address": f"0x{32 * gateway + 1:04x}", "gateway_group": "0xc010", "types": {"min_com": TYPE}}}

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

    def join(self, gateway):
        """Joins a gateway to the mesh as in docs/fleet.md: export, import, plug the board in."""
        file = self.directory / f"mesh{gateway}.export"
        for place, verb in ((HOST, "export"), (gateway, "import")):
            answer = self.ctl(place, "ble", verb, file)
            if answer.returncode != 0:
                raise OSError(f"ble {verb}: {answer.stderr}")
        self.plug_in(gateway)

    def is_up(self, gateway):
        answer = self.ctl(gateway, "status")
        return answer.returncode == 0 and json.loads(answer.stdout)["meshes"]["ble"]["state"] == "up"

    def unplug(self):
        """Unplugs the next board for 2 s."""
        self.simulator.send(signal.SIGUSR1)

    def read_record(self):
        """Returns by (robot, number): (payload, when), the time of the acknowledgement, and the times of repeats."""
        to_monotonic = time.monotonic() - time.time()
        sent, acknowledged, repeats = {}, {}, defaultdict(list)
        for line in self.record.read_text().splitlines():
            what, robot, number, *rest = line.split()
            key = self.names[robot], int(number)
            if what == "sent":
                sent[key] = (rest[0], float(rest[1]) + to_monotonic)
            elif what == "acknowledged":
                acknowledged[key] = float(rest[0]) + to_monotonic
        for line in self.trace.read_text().splitlines():
            event = json.loads(line)
            if event["event"] == "repeat":
                at = datetime.datetime.fromisoformat(event["at"].replace("Z", "+00:00")).timestamp()
                repeats[self.names[event["robot"]], event["number"]].append(at + to_monotonic)
        return sent, acknowledged, repeats

    def acknowledged(self, prefix):
        """Returns (topic, payload) of each acknowledged message."""
        sent, acknowledged, _ = self.read_record()
        return {(f"{prefix}/robot/{robot}/{TYPE}", bytes.fromhex(sent[robot, number][0])) for robot, number in acknowledged}

    def judge(self, fleet, messages, reported, bounds, findings):
        """Returns the numbers for the verdict. `messages`: those of the broker. `reported`: the outcomes."""
        sent, acknowledged, repeats = self.read_record()
        robots = set(self.names.values())
        changes = {robot: bounds.changes_of_ble([at for at, _ in shown[1:]], self.gateways)
                   for robot, shown in fleet.places_of_ble().items()}
        came, late = defaultdict(list), set()
        for at, topic, payload, is_late in messages:
            levels = topic.split("/")
            if levels[1] == "robot" and levels[3] == TYPE:
                came[levels[2], payload.hex()].append(at)
                late |= {(levels[2], payload.hex())} if is_late else set()
                if levels[2] not in robots and levels[2].startswith("ble-"):
                    findings.add("ble_unknown_robot", at, levels[2])
        for key, at in acknowledged.items():
            if not came[key[0], sent[key][0]]:
                findings.add("ble_lost", at, f"{key}, sent at {sent[key][1]:.3f}")
            self.judge_silence(key, sent[key][1], at, repeats[key], bounds, findings)
        self.judge_given_up(sent, acknowledged, repeats, bounds, findings)
        count = sum(len(each) for each in changes.values())
        commands = self.judge_commands(reported, changes, bounds, findings)
        self.judge_copies(sent, came, changes, bounds, findings)
        self.judge_order(sent, came, late, bounds, findings)
        silence = sorted(at - sent[key][1] for key, at in acknowledged.items())
        return {
            "ble_messages": len(acknowledged), "ble_changes": count, "ble_order_unknown": len(late), **commands,
            "ble_repeated": sum(1 for each in repeats.values() if each),
            "ble_silence_p99_s": round(silence[len(silence) * 99 // 100], 3) if silence else None,
            "ble_silence_max_s": round(silence[-1], 3) if silence else None,
        }

    def judge_silence(self, key, since, until, repeats, bounds, findings):
        """Reports a message that waited too long while a gateway with a board was connected to the broker. Others do not serve robots."""
        late = since + SILENCE_S
        later = [at for at in repeats if at >= late] if self.is_lossy else []
        if until <= (min(later) + REPEAT_S if later else late):
            return
        was_connected = any(not bounds.was_disturbed(gateway, since, until) for gateway in self.gateways)
        findings.add("ble_silence_too_long" if was_connected else "ble_waited_for_the_broker", until,
                     f"{key}: {until - since:.3f} s, since {since:.3f}")

    def judge_given_up(self, sent, acknowledged, repeats, bounds, findings):
        """Judges messages that a robot gave up, as silent until a later one was acknowledged, or until the end."""
        end = max([at for _, at in sent.values()] + list(acknowledged.values()), default=0.0)
        for robot, number in sent.keys() - acknowledged.keys():
            later = [at for (other, after), at in acknowledged.items() if other == robot and after > number]
            self.judge_silence((robot, number), sent[robot, number][1], min(later, default=end), repeats[robot, number],
                               bounds, findings)

    def judge_copies(self, sent, came, changes, bounds, findings):
        """Judges copies by bounds 8 and 3."""
        for (robot, number), (payload, at) in sent.items():
            copies = came[robot, payload]
            broken = sum(bounds.breaks(gateway, at, copies[0], copies[-1]) for gateway in self.gateways) if copies else 0
            for one, next_one in zip(copies, copies[1:]):
                since = self.went_up(at, one, bounds) - CHANGE_S
                change = next((each for each in changes[robot] if since <= each <= next_one + CHANGE_S), None)
                kind = "ble_doubled_beyond_bound"
                if change is not None:
                    changes[robot].remove(change)
                    kind = "ble_doubled"
                elif broken > 0:
                    broken -= 1
                    kind = "ble_doubled_when_broker_broke"
                findings.add(kind, next_one, f"{robot} {number} sent at {at:.3f} came at {[round(each, 3) for each in copies]}")

    def went_up(self, sent, came, bounds):
        """Returns the earliest time at which a gateway may have published a message. While a node is stopped, presence may overtake a
        message that was published before it."""
        return sent if any(bounds.was_disturbed(gateway, sent, came) for gateway in self.gateways) else came

    def judge_order(self, sent, came, late, bounds, findings):
        newest = {}
        firsts = sorted((came[robot, payload][0], robot, number, at)
                        for (robot, number), (payload, at) in sent.items() if came[robot, payload] and (robot, payload) not in late)
        for arrived, robot, number, at in firsts:
            if number < newest.get(robot, 0):
                is_bound = any(bounds.may_be_overtaken(*pair, at, arrived) for pair in itertools.permutations(self.gateways, 2))
                findings.add("ble_overtaken" if is_bound else "ble_out_of_order", arrived,
                             f"{robot} {number} sent at {at:.3f} behind {newest[robot]}")
            newest[robot] = max(number, newest.get(robot, 0))

    def judge_commands(self, reported, changes, bounds, findings):
        """Compares counts of commands. Commands are repeated when they are lost on the air or acknowledged late, and robots count repeats.
        A command with `timeout` from when its robot changed its gateway may have been obeyed (bound 7)."""
        received = json.loads(self.simulator.log.read_text().splitlines()[-1])["robots"]
        obeyed = {self.names[name]: robot["commands_received"] for name, robot in received.items()}
        results = {key: {each.what() for each in said} for key, said in reported.items() if key[0] in obeyed}
        delivered = Counter(robot for (robot, _), outcomes in results.items() if "delivered" in outcomes)
        told_of = Counter(robot for robot, _ in results)
        repeated = {robot for (robot, _), said in reported.items() if any(json.loads(each.payload)["after_ms"] >= REPEAT_MS for each in said)}
        for robot, count in obeyed.items():
            if count < delivered[robot] or (not self.is_lossy and robot not in repeated and count > told_of[robot]):
                findings.add("ble_commands_wrong", time.monotonic(),
                             f"{robot} got {count}; {delivered[robot]} delivered of {told_of[robot]}")
            excess = max(0, min(count, told_of[robot]) - delivered[robot])
            unclear = sum(1 for key, said in reported.items() if key[0] == robot and results[key] == {"timeout"} and
                          self.may_be_obeyed(changes[robot], said, bounds))
            if excess > unclear and not self.is_lossy and robot not in repeated:
                findings.add("ble_obeyed_though_refused", time.monotonic(),
                             f"{robot} got {count}, {delivered[robot]} delivered, {unclear} perhaps obeyed")
        return {"ble_commands": len(results), "ble_obeyed_despite_timeout":
                sum(max(0, count - delivered[robot]) for robot, count in obeyed.items())}

    def may_be_obeyed(self, changes, said, bounds):
        until = said[-1].at
        since = until - json.loads(said[-1].payload)["after_ms"] / 1000
        return (any(since - CHANGE_S <= change <= until + CHANGE_S for change in changes) or
                any(bounds.was_disturbed(gateway, since, until) for gateway in self.gateways))
