# SPDX-License-Identifier: Apache-2.0
"""The commands of a run. Any robot gets distinct ones with unique types. Some robots get streams of equal ones, `run 1`, twice a
second, and others five times a second. Judges each: exactly one outcome, and obeyed at most once. Used by run, acts and judge."""
import bisect
import json
from collections import Counter, defaultdict
from typing import NamedTuple

DISTINCT_S = 0.2  # between two distinct commands
EQUAL_S = (0.5, 0.2)  # between two equal commands to one robot
RUN, ON = "run", "1"
OUTCOME_S = 30  # promise 6 of docs/topics.md, once a gateway can have the command
SLACK_S = 3  # for a gateway to reconnect
MOST_WITHOUT = 0.01  # share of commands that bound 1 may leave without an outcome
LEAST_WITHOUT = 2
SAME_S = 0.1  # precision of a calculated time


class Command(NamedTuple):
    robot: str
    kind: str  # its type, and the payload of a distinct one
    at: float
    number: int


class Outcome(NamedTuple):
    at: float
    gateway: int
    payload: bytes
    is_late: bool = False  # it came late (streams), so `at` is calculated

    def what(self):
        return json.loads(self.payload)["outcome"]


def outcomes_of(messages, commands):
    """Returns by (robot, type) the Outcomes in the order of their times. `commands`: when each distinct command was published. The time of
    an outcome that came late is calculated from its `after_ms`."""
    reported = defaultdict(list)
    for at, topic, payload, is_late in messages:
        levels = topic.split("/")
        if levels[1] == "gateway" and levels[3] == "commands":
            key = levels[4], json.loads(payload)["type"]
            when = min(at, said_at(commands.get(key, at), payload)) if is_late else at
            reported[key].append(Outcome(when, int(levels[2].removeprefix("gw-")), payload, is_late))
    return {key: sorted(said) for key, said in reported.items()}


def said_at(commanded, payload):
    """Returns the earliest time at which an outcome was published. The gateway may have got the command late."""
    return commanded + json.loads(payload)["after_ms"] / 1000


def described(said):
    return "; ".join(f"{each.at:.3f} gw{each.gateway} {each.payload.decode()}" + (" (late)" if each.is_late else "") for each in said)


def unanswered(commands, said):
    """Returns the equal commands without an outcome. An outcome is for the newest command that was published when its gateway got it. If
    the command waited at the broker, it is for the oldest one after the last command with another outcome."""
    left, answered = list(commands), []
    outcomes = [json.loads(each.payload) | {"came": each.at - json.loads(each.payload)["after_ms"] / 1000} for each in said]
    for each in sorted(outcomes, key=lambda each: (each["why"].startswith("waited at the broker"), each["came"])):
        index = bisect.bisect(left, each["came"] + SAME_S, key=lambda command: command.at)
        if each["why"].startswith("waited at the broker"):
            since = max((at for at in answered if at <= each["came"]), default=0.0)
            index = min(index, bisect.bisect(left, since, key=lambda command: command.at) + 1)
        else:
            answered += [left[index - 1].at] if index else []
        if index:
            left.pop(index - 1)
    return left


class Commands:
    def __init__(self, prefix, observers, random, most_equal=0):
        self.prefix, self.observers, self.random, self.most_equal = prefix, observers, random, most_equal
        self.distinct, self.equal = {}, defaultdict(list)  # by (robot, type); by robot
        self.count, self.next_distinct, self.next_equal = 0, 0.0, {}

    def step(self, now, robots, names):
        """Sends the commands that are due. `robots` get equal commands, `names` get distinct ones."""
        if now >= self.next_distinct:
            self.next_distinct = now + DISTINCT_S
            self.send(now, self.random.choice(names))
        for i, robot in enumerate(robots[:self.most_equal]):
            if now >= self.next_equal.get(robot.name, 0.0):
                self.next_equal[robot.name] = now + EQUAL_S[i % len(EQUAL_S)]
                self.publish(Command(robot.name, RUN, now, self.count), ON, robot.qos)

    def send(self, now, name, qos=1):
        """Sends and returns a distinct command; None if no node takes it."""
        command = Command(name, f"c{self.count}", now, self.count)
        return command if self.publish(command, command.kind, qos) else None

    def publish(self, command, payload, qos):
        topic = f"{self.prefix}/server/{command.robot}/{command.kind}"
        if not self.observers.publish(topic, payload.encode(), qos, command.number, self.random):
            return False
        self.count += 1
        if command.kind == RUN:
            self.equal[command.robot].append(command)
        else:
            self.distinct[command.robot, command.kind] = command
        return True

    def times(self):
        return {key: command.at for key, command in self.distinct.items()}

    def have_all_outcomes(self):
        reported = self.observers.outcomes()
        return (all(key in reported for key in self.distinct) and
                all(reported[robot, RUN] >= len(each) for robot, each in self.equal.items()))

    # --- Judgement ---

    def judge(self, robots, places_of_ble, reported, bounds, findings, again_s, breaks=None):
        """Returns the numbers for the verdict. `robots`: of the Thread mesh, by name; BLE robots do not report which command they obey. A
        command that no broker has confirmed may be lost, but not be obeyed twice or have two outcomes. `breaks`: by robot, when the
        broker broke its session."""
        self.places_of_ble = places_of_ble
        self.bounds, self.findings, self.again_s, self.breaks = bounds, findings, again_s, breaks or {}
        self.confirmed = self.observers.confirmed()
        self.results, self.whys, self.waits = Counter(), Counter(), []
        for key, command in self.distinct.items():
            self.judge_distinct(command, robots.get(key[0]), reported.get(key, []))
        for name, commands in self.equal.items():
            self.judge_equal(commands, robots[name], reported.get((name, RUN), []))
        self.judge_forgiven()
        self.waits.sort()
        obeyed = sum(len(robot.commands) for robot in robots.values())
        return {"published": self.count, "unconfirmed": sum(1 for number in range(self.count) if number not in self.confirmed),
                "outcomes": dict(self.results), "obeyed_by_thread_robots": obeyed,
                "undelivered": sum(count for what, count in self.results.items() if what not in ("delivered", "sent")),
                "undelivered_why": dict(self.whys.most_common(8)),
                "without_outcome": sum(self.findings.counts[kind] for kind in ("outcomes_missing", "lost_at_a_move", "lost_by_broker",
                                                                               "without_subscription")),
                "delivered_p50_s": self.waits[len(self.waits) // 2] if self.waits else None,
                "delivered_p99_s": self.waits[len(self.waits) * 99 // 100] if self.waits else None}

    def judge_distinct(self, command, robot, all_said):
        at, name = command.at, f"{command.robot} {command.kind} of {command.at:.3f}"
        obeyed = [each for each in robot.commands if each[2] == command.kind] if robot else []
        said = self.without_repetitions(at, all_said)
        results = [each.what() for each in said]
        self.count_outcomes(said)
        if len(obeyed) > 1:
            self.findings.add("obeyed_twice", at, f"{name}: {obeyed}; {described(said)}")
        if len(said) > 1:
            self.findings.add("outcomes_doubled", said[-1].at, f"{name}: {described(said)}")
        if not said and command.number in self.confirmed:
            self.add_missing(command, robot, f"obeyed {obeyed}")
        if said and not said[0].is_late and said[0].at > at + OUTCOME_S + SLACK_S + self.again_s + self.bounds.fault_s(at, said[0].at):
            self.findings.add("outcomes_late", said[0].at, f"{name}: {described(said)}")
        if "sent" in results:
            self.findings.add("sent_at_qos_0", said[0].at, f"{name}: {described(said)}")
        if "delivered" in results:
            self.waits.append(round(said[0].at - at, 3))
            if robot and not obeyed:
                self.findings.add("delivered_but_not_obeyed", at, f"{name}: {described(said)}")
        elif obeyed and results and "sent" not in results:
            self.findings.add(self.kind_of_obeyed(robot, obeyed, said), at, f"{name}: {obeyed}; {described(said)}")
        if robot and any("not subscribed" in json.loads(each.payload)["why"] for each in said) and not robot.is_clean:
            self.findings.add("subscription_lost", at, f"{name}: {described(said)}")

    def judge_equal(self, commands, robot, all_said):
        """Judges equal commands by their counts, because they cannot be distinguished."""
        said = self.without_repetitions(None, all_said)
        results = Counter(each.what() for each in all_said)
        self.count_outcomes(all_said)
        confirmed = [each for each in commands if each.number in self.confirmed]
        at, name = commands[-1].at, f"{robot.name}: {len(commands)} equal commands, {len(confirmed)} confirmed"
        obeyed = robot.obeyed(ON)
        if len(said) > len(commands):
            self.findings.add("outcomes_doubled", at, f"{name}, {len(said)} outcomes")
        for each in unanswered(confirmed, all_said)[:max(0, len(confirmed) - len(all_said))]:
            self.add_missing(each, robot, f"{name}, {len(all_said)} outcomes")
        if obeyed > len(commands):
            self.findings.add("obeyed_twice", at, f"{name}, {obeyed} obeyed, outcomes: {dict(results)}")
        if obeyed < sum(1 for each in said if each.what() == "delivered"):
            self.findings.add("delivered_but_not_obeyed", at, f"{name}, {obeyed} obeyed, outcomes: {dict(results)}")
        if obeyed > len(commands) - results["refused"]:
            self.findings.add("obeyed_though_refused", at, f"{name}, {obeyed} obeyed, outcomes: {dict(results)}")

    def count_outcomes(self, said):
        for each in said:
            self.results[each.what()] += 1
            if each.what() not in ("delivered", "sent"):
                self.whys["".join(letter for letter in json.loads(each.payload)["why"] if not letter.isdigit())[:70]] += 1

    def excuse(self, command, robot):
        """Returns the bound that allows a command without an outcome; None if there is none."""
        places = robot.places if robot else self.places_of_ble[command.robot]
        if self.bounds.may_be_lost_by_broker(command.at):
            return "lost_by_broker"
        if robot and self.bounds.may_lack_a_subscription(command.at, robot.bare):
            return "without_subscription"
        return "lost_at_a_move" if self.bounds.may_have_no_outcome(command.at, places, self.breaks.get(command.robot, ())) else None

    def add_missing(self, command, robot, what):
        places = f", places {[place for place in robot.places if place[0] > command.at - 10][:4]}" if robot else ""
        self.findings.add(self.excuse(command, robot) or "outcomes_missing", command.at, f"{command.robot} {command.kind}: {what}{places}")

    def judge_forgiven(self):
        """Bounds the number of commands that bound 1 covers, because a round trip is short."""
        if (lost := self.findings.counts["lost_at_a_move"]) > max(LEAST_WITHOUT, MOST_WITHOUT * self.count):
            self.findings.add("too_many_lost_at_moves", 0.0, f"{lost} of {self.count}")

    def kind_of_obeyed(self, robot, obeyed, said):
        moves = [since for since, _ in robot.places]
        is_bound = "refused" not in [each.what() for each in said] and all(
            self.bounds.may_be_obeyed_despite_timeout(gateway, when, said[-1].at, moves) for when, gateway, _ in obeyed)
        return "obeyed_despite_timeout" if is_bound else "obeyed_though_refused"

    def without_repetitions(self, commanded, said):
        """Returns the outcomes without equal copies from the same gateway, up to the number of its broken connections. `commanded`: None if
        it is unknown which command each outcome is for."""
        kept, copies = [], Counter()
        for each in said:
            before = next((other for other in kept if (other.gateway, other.payload) == (each.gateway, each.payload)), None)
            since = before and (before.at if commanded is None else said_at(commanded, each.payload))
            if before and copies[before] < self.bounds.may_come_again(each.gateway, since, before.at, each.at):
                copies[before] += 1
                self.findings.add("outcomes_repeated_when_broker_broke" if commanded is not None else "equal_outcomes_across_a_break",
                                  each.at, described([before, each]))
            else:
                kept.append(each)
        return kept
