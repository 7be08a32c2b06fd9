# SPDX-License-Identifier: Apache-2.0
"""The nine bounds of a run. Each is a function, or two, that checks whether the bound covers this message or command, with its
reason. Pure: times in (one monotonic clock), answers out. Used by judge, commands and ble_mesh."""
import dataclasses

ROUND_TRIP_S = 0.3  # measured: 1 to 2 ms; a busy machine needs more
JOIN_S = 4  # a gateway has read the others' retained messages this long after SUBACK
SETTLE_S = 12  # two keep-alives of 6 s, within which a connection to a silent peer ends (daemon: sign of life 10 s)
HURRY_S = 1.0  # without faults, a broker's PUBACK and its copy to the observer are at most this far apart
SILENCE_S = 2  # a gateway must have been connected for this time before it publishes a will
FOREVER = float("inf")


@dataclasses.dataclass
class Absence:
    """A fault. `who`: number of a gateway, or of a node of the cluster."""

    what: str  # "gateway killed", "gateway stopped", "link cut", "node killed", "node stopped"
    who: int
    begin: float
    end: float = FOREVER


@dataclasses.dataclass
class Connection:
    """A gateway's connection to a broker, as in its log. `good_until`: when it broke, perhaps before the gateway noticed."""

    begin: float
    end: float
    good_until: float


class Bounds:
    def __init__(self, absences, connections, subscribed_s, settle_s=SETTLE_S, change_s=1.0, loses_all=False, hears_all=True):
        """`connections`: for each gateway, (begin, end) of each. `subscribed_s`: the engine's time to answer SUBSCRIBE. `change_s`: the
        time from a robot's CONNECT until the session is at the new gateway. `loses_all`: a broker that dies loses all sessions.
        `hears_all`: a gateway gets commands to which its robot has not subscribed."""
        self.absences, self.subscribed_s, self.settle_s = absences, subscribed_s, settle_s
        self.change_s, self.loses_all, self.hears_all = change_s, loses_all, hears_all
        self.connections = [[self.connection(gateway, *times) for times in each] for gateway, each in enumerate(connections)]

    # 1. A command that arrives within one round trip before its robot's session moves, or breaks, may have no outcome. Client libraries
    # acknowledge a command when it arrives. Only the broker's next answer shows that the gateway still had the session then. Without
    # that answer another gateway may have the command, so the gateway neither sends it nor reports an outcome.

    def may_have_no_outcome(self, at, places, breaks=()):
        """`at`: of the command. `places`: (since when, gateway) of its robot. The command arrived at once, or it waited for an
        absent gateway. Then it arrived at a later move of the session that another move followed too soon. `breaks`: when the broker
        broke the session."""
        changes = sorted(self.changes(places) + [(when, when) for when in breaks])
        if any(begin - ROUND_TRIP_S <= at <= end for begin, end in changes):
            return True
        is_away = self.was_disturbed(gateway_at(places, at), at, at + ROUND_TRIP_S)
        came = [change for change in changes if change[0] > at and is_away]
        return any(begin < other <= end + ROUND_TRIP_S for begin, end in came for other, _ in changes)

    def changes(self, places):
        """Returns (from, to) of each time in which the session moved or broke. It moved when the robot went to a gateway. It broke
        when its gateway, or a node, failed or came back."""
        found = [(since, since + self.change_s) for since, _ in places]
        for absence in self.absences:
            if absence.what.startswith("node") or any(at_it and since <= absence.end and absence.begin <= until + HURRY_S
                                                      for since, until, at_it in stays(places, absence.who)):
                found += [(absence.begin, absence.begin), (absence.end, absence.end + self.change_s)]
        return sorted(found)

    # 2. Commands that a broker has lost have no outcome: a broker without a disk loses all sessions and their messages when it dies.

    def may_be_lost_by_broker(self, at):
        return self.loses_all and any(absence.what == "node killed" and absence.begin - HURRY_S <= at <= absence.end + self.settle_s
                                      for absence in self.absences)

    # 3. A message that was under way to a broker when the connection broke may arrive twice, once more for each break. It is unknown
    # whether the first copy arrived. The same holds when a robot repeats a message at another or restarted gateway.

    def copies(self, tries, first, last):
        """Returns (the number of gateway processes that got the message, a return of the robot counts again; the number of breaks).
        `tries`: (when, gateway, the robot's moves before). `first`, `last`: when the first and the last copy came."""
        lives, broken = set(), {}
        for at, gateway, moves in tries:
            lives.add((gateway, sum(1 for kill in self.kills(gateway) if kill < at), moves))
            broken[gateway] = min(at, broken.get(gateway, FOREVER))
        return len(lives), sum(self.breaks(gateway, sent, first, last) for gateway, sent in broken.items())

    def may_come_again(self, gateway, said, first, last):
        """Returns how often an equal outcome may come again. `said`: when the gateway published it. The second connection may deliver it
        before the first one does: a broker still reads the socket that the gateway has closed."""
        return self.breaks(gateway, min(said, first), first, last)

    # 4. A message may be overtaken at a roam. A gateway that is cut off keeps it on disk and acknowledges it, and the robot moves on.

    def may_be_overtaken(self, gateway, other, sent, arrived):
        return gateway != other and self.was_disturbed(gateway, sent, arrived)

    # 5. The will of a robot at a gateway that is cut off may be published, because all other gateways see it as silent.

    def may_have_a_will(self, gateway, at):
        return not any(each.begin + self.subscribed_s <= at and at - SILENCE_S <= each.good_until for each in self.connections[gateway])

    # 6. A gateway that comes back shows its former robots until it has read the others' presence. The broker keeps its old retained
    # presence, and it may publish that again before it reads.

    def may_show_former_robots(self, gateways, begin, seconds, earliest):
        """`earliest`: when the contradiction may have begun; it was observed at `begin`."""
        longest = self.subscribed_s + JOIN_S
        returns = [each.begin for gateway in gateways for each in self.connections[gateway][1:]] + self.returns(gateways)
        returns += [absence.end for absence in self.absences if absence.what.startswith("node")]  # gateways waited for the node
        return (seconds - self.away_s(gateways, begin, begin + seconds) <= longest and
                any(at <= begin and earliest <= at + longest for at in returns))

    # 7. A command on the air when its robot moves, or when its gateway fails, ends as `timeout` and may have been obeyed. Its
    # acknowledgement reaches no gateway. A `refused` command is never obeyed.

    def may_be_obeyed_despite_timeout(self, gateway, obeyed, reported, moves):
        """`moves`: when the robot went to another gateway."""
        return any(obeyed <= move <= reported for move in moves) or self.was_disturbed(gateway, obeyed, reported)

    # 8. Each time that another gateway serves a BLE robot, one message of each of its models may be published twice. It is the one
    # under way to the broker, or the one whose STATUS the robot has missed. BLE robots cannot address a message to one gateway.

    def changes_of_ble(self, shown, gateways):
        """`shown`: when a gateway began to show a robot of another gateway. A gateway that was stopped does so before it reads."""
        return sorted(list(shown) + self.returns(gateways))

    # 9. On MQTT 3.1.1 a command to which the robot has not subscribed has no outcome. In a clean session a robot has no subscription
    # until its SUBACK. Commands of its former session are refused before the broker deletes that session.

    def may_lack_a_subscription(self, at, bare):
        """`bare`: (from, to) of each time in which the robot had no subscription."""
        return not self.hears_all and any(since <= at <= until for since, until in bare)

    # --- Events ---

    def connection(self, gateway, begin, end):
        """Returns a connection with its real end: a killed gateway logs none, and notices a stopped node or a cut link later."""
        end = min([end] + [kill for kill in self.kills(gateway) if begin < kill < end])
        causes = [absence.begin for absence in self.absences
                  if self.concerns(absence, gateway) and absence.begin <= end <= absence.end + self.settle_s]
        return Connection(begin, end, min([end, *causes]))

    def kills(self, gateway):
        return [absence.begin for absence in self.absences if absence.what == "gateway killed" and absence.who == gateway]

    @staticmethod
    def concerns(absence, gateway):
        """Returns True if the fault concerns the gateway. A fault of a node concerns all, because a cluster waits for each node."""
        return absence.what.startswith("node") or absence.who == gateway

    def was_disturbed(self, gateway, begin, end):
        """Returns True if the gateway's connection to the broker was disturbed at some time from `begin` to `end`."""
        if any(self.concerns(absence, gateway) and absence.begin <= end and begin <= absence.end + SETTLE_S
               for absence in self.absences):
            return True
        return not any(each.begin <= begin and end <= each.good_until for each in self.connections[gateway])

    def breaks(self, gateway, sent, first, last):
        """Returns the number of connections that broke while a message was under way on them: sent, and perhaps not received."""
        return sum(1 for each in self.connections[gateway]
                   if sent <= each.end and each.good_until - HURRY_S <= first and each.good_until <= last)

    def away_s(self, gateways, begin, end):
        """Returns how long, from `begin` to `end`, one of the gateways was away. A gateway is away while it or a node is down, and
        while it has no connection that lasts until its SUBACK."""
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

    def fault_s(self, begin, end):
        """Returns for how long a fault lasted from `begin` to `end`."""
        return sum(max(0.0, min(absence.end, end) - max(absence.begin, begin)) for absence in self.absences)

    def returns(self, gateways):
        """Returns when stopped or cut-off gateways continued."""
        return [absence.end for absence in self.absences
                if absence.what in ("gateway stopped", "link cut") and absence.who in gateways]


def gateway_at(places, when):
    return [gateway for since, gateway in places if since <= when or since == places[0][0]][-1]


def stays(places, gateway):
    """Returns (since, until, whether it was that gateway) of each stay of a robot."""
    return [(since, until, at == gateway) for (since, at), (until, _) in zip(places, [*places[1:], (FOREVER, None)])]
