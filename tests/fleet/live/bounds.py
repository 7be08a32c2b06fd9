# SPDX-License-Identifier: Apache-2.0
"""What a run forgives, all of it: each function is one sentence of docs/fleet.md, "Bounds", and asks whether it holds for the one
message or command at hand. Pure: times in (one monotonic clock), answers out. Used by judge."""
import dataclasses

DEAD_S = 31  # "if all gateways that heard a command die within 31 s, nobody tells its outcome"
CUT_OFF_S = 28  # "a gateway that is cut off for more than 28 s leaves the outcome of what it took to another one"
SETTLE_S = 12  # two keep-alives of 6 s: a connection whose other end is silent has ended by then (daemon: sign of life 10 s)
ASKED_S = 3  # the others are asked for so long before a will is published
JOIN_S = 4  # a gateway takes part so long after its subscriptions stand
HURRY_S = 1.0  # a broker's PUBACK and its copy to the observer are no further apart when nothing is wrong
FOREVER = float("inf")


@dataclasses.dataclass
class Absence:
    """Something was taken away. `who`: number of a gateway, or of a node of the cluster."""

    what: str  # "gateway killed", "gateway stopped", "link cut", "node killed", "node stopped"
    who: int
    begin: float
    end: float = FOREVER


@dataclasses.dataclass(frozen=True)
class Lapse:
    """A gateway has lost its lease, at some time from `begin` to `end`, and it has forgotten what was under way."""

    gateway: int
    begin: float
    end: float


@dataclasses.dataclass
class Connection:
    """Of a gateway to a broker, as its log has it; `good_until`: what silenced it may have come before the gateway noticed."""

    begin: float
    end: float
    good_until: float


class Bounds:
    def __init__(self, absences, connections, subscribed_s, lapses=(), settle_s=SETTLE_S):
        """`connections`: for each gateway, (begin, end) of each. `subscribed_s`: what the engine needs to answer SUBSCRIBE."""
        self.absences, self.subscribed_s, self.lapses, self.settle_s = absences, subscribed_s, lapses, settle_s
        self.connections = [[self.connection(gateway, *times) for times in each] for gateway, each in enumerate(connections)]

    def connection(self, gateway, begin, end):
        """A gateway that was killed has not logged the end; it notices a stopped node or a cut link later."""
        end = min([end] + [kill for kill in self.kills(gateway) if begin < kill < end])
        causes = [absence.begin for absence in self.absences
                  if self.concerns(absence, gateway) and absence.begin <= end <= absence.end + self.settle_s]
        return Connection(begin, end, min([end, *causes]))

    def kills(self, gateway):
        return [absence.begin for absence in self.absences if absence.what == "gateway killed" and absence.who == gateway]

    @staticmethod
    def concerns(absence, gateway):
        """A cluster waits for each of its nodes."""
        return absence.what.startswith("node") or absence.who == gateway

    def was_disturbed(self, gateway, begin, end):
        """Whether the gateway's way to the broker was not whole, at some time from `begin` to `end`."""
        if any(self.concerns(absence, gateway) and absence.begin <= end and begin <= absence.end + SETTLE_S
               for absence in self.absences):
            return True
        return not any(each.begin <= begin and end <= each.good_until for each in self.connections[gateway])

    def breaks(self, gateway, sent, first, last):
        """Connections that broke while a message was on its way over them: begun, and not known to have come."""
        return sum(1 for each in self.connections[gateway]
                   if sent <= each.end and each.good_until - HURRY_S <= first and each.good_until <= last)

    def copies(self, tries, first, last):
        """A robot's message is doubled only if the robot itself repeated it, at another gateway or because its gateway died before it
        acknowledged, or if it was on its way to a broker when that connection broke. (one for each gateway and life that got it, also
        when the robot comes back to it from another one, and one for each break) `tries`: (when, gateway, the robot's moves before).
        `first`, `last`: when the first and the last copy came."""
        lives, broken = set(), {}
        for at, gateway, moves in tries:
            lives.add((gateway, sum(1 for kill in self.kills(gateway) if kill < at), moves))
            broken[gateway] = min(at, broken.get(gateway, FOREVER))
        return len(lives), sum(self.breaks(gateway, sent, first, last) for gateway, sent in broken.items())

    def may_be_overtaken(self, gateway, other, sent, arrived):
        """A gateway that is cut off from the broker acknowledges to its disk; when the robot goes on to another gateway meanwhile, its
        later messages arrive first."""
        return gateway != other and self.was_disturbed(gateway, sent, arrived)

    def may_come_again(self, gateway, said, first, last):
        """An outcome that was on its way to a node when the connection broke may come twice, word for word. (once more for each connection
        that broke) `said`: when the gateway said it. The second connection may deliver it before the first one does: a broker
        reads what lies in a socket that the gateway has given up."""
        return self.breaks(gateway, min(said, first), first, last)

    def may_be_obeyed_all_the_same(self, gateway, obeyed, told, moves):
        """Commands that are on the air when a robot changes its gateway, or when its gateway has lost its lease, end as `refused`; one that
        was on the air may have been obeyed. `moves`: when the robot went to another gateway."""
        return (any(obeyed <= move <= told for move in moves) or self.was_disturbed(gateway, obeyed, told) or
                self.has_lost_its_lease(gateway, obeyed, told))

    def may_be_told_twice(self, gateway, at, told):
        """When a gateway dies, or is cut off for more than 28 s, within 31 s of a command, and all others are cut off from the broker in that
        time too, one of them may tell `timeout` and the gateway itself another outcome. `at`: of the command. `told`: when the gateway
        told the outcome, which no other one heard."""
        ends = self.kills(gateway) + [each.good_until for each, after in zip(self.connections[gateway], [*self.connections[gateway][1:], None])
                                      if after is None or after.begin - each.good_until > CUT_OFF_S]
        others = [other for other in range(len(self.connections)) if other != gateway]
        return any(at <= end <= at + DEAD_S for end in ends) and not any(self.hears(other, told) for other in others)

    def may_have_a_will(self, gateway, at):
        """A robot that goes to a gateway which is cut off from the broker is silent to all others: its will is published."""
        return not any(each.begin + self.subscribed_s <= at and at - ASKED_S <= each.good_until for each in self.connections[gateway])

    def may_announce_anew(self, gateways, begin, seconds, earliest):
        """A gateway that was cut off, or was killed, announces its robots of before when it is back, and withdraws those that others serve
        by now when it takes part again, or when it, or the broker, is back once more. `earliest`: it may have done so before it was
        seen, at `begin`."""
        longest = self.subscribed_s + JOIN_S
        returns = [each.begin for gateway in gateways for each in self.connections[gateway][1:]] + self.returns(gateways)
        returns += [absence.end for absence in self.absences if absence.what.startswith("node")]  # for which gateways waited
        return (seconds - self.away_s(gateways, begin, begin + seconds) <= longest and
                any(at <= begin and earliest <= at + longest for at in returns))

    def away_s(self, gateways, begin, end):
        """How long one of the gateways was away from `begin` to `end`, or a node, or had no connection that lasts until its subscriptions
        stand."""
        times = [(absence.begin, absence.end) for absence in self.absences
                 if any(self.concerns(absence, gateway) for gateway in gateways)]
        for gateway in gateways:
            lasting = [each for each in self.connections[gateway] if each.end - each.begin > self.subscribed_s]
            times += zip([0.0, *(each.good_until for each in lasting)], [*(each.begin for each in lasting), FOREVER])
        away, known_until = 0.0, begin
        for since, until in sorted(times):
            away += max(0.0, min(until, end) - max(since, known_until))
            known_until = max(known_until, min(until, end))
        return away

    def returns(self, gateways):
        """When gateways went on that had been stopped or cut off, and so had lost their lease."""
        return [absence.end for absence in self.absences
                if absence.what in ("gateway stopped", "link cut") and absence.who in gateways]

    def has_lost_its_lease(self, gateway, begin, end):
        return any(each.gateway == gateway and each.begin <= end and begin <= each.end for each in self.lapses)

    def hears(self, gateway, at):
        return any(each.begin + self.subscribed_s <= at and at + HURRY_S <= each.good_until for each in self.connections[gateway])

    def may_be_unheard(self, at):
        """A command that the broker takes while no gateway has a connection that lasts is lost, and has no outcome."""
        return not any(self.hears(gateway, at) for gateway in range(len(self.connections)))

    def may_be_orphaned(self, at):
        """If all gateways that heard a command die within 31 s, nobody tells its outcome."""
        return all(any(at <= kill <= at + DEAD_S for kill in self.kills(gateway))
                   for gateway in range(len(self.connections)) if self.hears(gateway, at))
