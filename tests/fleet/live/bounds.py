# SPDX-License-Identifier: Apache-2.0
"""What a run forgives, all of it: nine bounds, each a function (or two) that asks whether it holds for the one message or command at
hand, with its reason. Pure: times in (one monotonic clock), answers out. Used by judge, commands and ble_mesh."""
import dataclasses

ROUND_TRIP_S = 0.3  # 1 to 2 ms were measured; a busy machine needs more
JOIN_S = 4  # a gateway has read what others have retained so long after its subscriptions stand
SETTLE_S = 12  # two keep-alives of 6 s: a connection whose other end is silent has ended by then (daemon: sign of life 10 s)
HURRY_S = 1.0  # a broker's PUBACK and its copy to the observer are no further apart when nothing is wrong
SILENCE_S = 2  # before a will is published the gateway must have had a way to the broker for so long
FOREVER = float("inf")


@dataclasses.dataclass
class Absence:
    """Something was taken away. `who`: number of a gateway, or of a node of the cluster."""

    what: str  # "gateway killed", "gateway stopped", "link cut", "node killed", "node stopped"
    who: int
    begin: float
    end: float = FOREVER


@dataclasses.dataclass
class Connection:
    """Of a gateway to a broker, as its log has it; `good_until`: what silenced it may have come before the gateway noticed."""

    begin: float
    end: float
    good_until: float


class Bounds:
    def __init__(self, absences, connections, subscribed_s, settle_s=SETTLE_S, change_s=1.0, loses_all=False, hears_all=True):
        """`connections`: for each gateway, (begin, end) of each. `subscribed_s`: what the engine needs to answer SUBSCRIBE. `change_s`: what
        it needs from a robot's CONNECT until its session is at its new gateway. `loses_all`: a broker that dies forgets everything. `hears_all`: a
        gateway hears commands to which its robot has not subscribed."""
        self.absences, self.subscribed_s, self.settle_s = absences, subscribed_s, settle_s
        self.change_s, self.loses_all, self.hears_all = change_s, loses_all, hears_all
        self.connections = [[self.connection(gateway, *times) for times in each] for gateway, each in enumerate(connections)]

    # 1. A command that comes within one round trip before its robot's session changes hands, or breaks, may have no outcome. Client
    # libraries acknowledge a command when it arrives; only the next answer of the broker shows that the session was still held then.
    # Without that answer it is not known whether another gateway has the command, so nothing is done and nothing is said.

    def may_have_no_outcome(self, at, places, breaks=()):
        """`at`: of the command. `places`: (since when, gateway) of its robot. It has come at once; or, when it waited for a gateway that was
        away, at a later change of hands, and then another change followed too soon. `breaks`: when the broker broke the robot's session."""
        changes = sorted(self.changes(places) + [(when, when) for when in breaks])
        if any(begin - ROUND_TRIP_S <= at <= end for begin, end in changes):
            return True
        is_away = self.was_disturbed(gateway_at(places, at), at, at + ROUND_TRIP_S)
        came = [change for change in changes if change[0] > at and is_away]
        return any(begin < other <= end + ROUND_TRIP_S for begin, end in came for other, _ in changes)

    def changes(self, places):
        """(from, to) of each time in which the session changed hands or broke: when the robot went to a gateway, and when one at which it
        was, or a node, was taken away or came back."""
        found = [(since, since + self.change_s) for since, _ in places]
        for absence in self.absences:
            if absence.what.startswith("node") or any(at_it and since <= absence.end and absence.begin <= until + HURRY_S
                                                      for since, until, at_it in stays(places, absence.who)):
                found += [(absence.begin, absence.begin), (absence.end, absence.end + self.change_s)]
        return sorted(found)

    # 2. What a broker has forgotten has no outcome: one without a disk that dies forgets all sessions, and what waited in them.

    def may_be_forgotten(self, at):
        return self.loses_all and any(absence.what == "node killed" and absence.begin - HURRY_S <= at <= absence.end + self.settle_s
                                      for absence in self.absences)

    # 3. What was on its way to a broker when that connection broke may come twice, once more for each break: nobody knows whether the
    # first copy came. A robot does the same when it says a message again at another gateway, or to one that died before it acknowledged.

    def copies(self, tries, first, last):
        """(one for each gateway and life that got the message, also when the robot comes back to it from another one, and one for each
        break) `tries`: (when, gateway, the robot's moves before). `first`, `last`: when the first and the last copy came."""
        lives, broken = set(), {}
        for at, gateway, moves in tries:
            lives.add((gateway, sum(1 for kill in self.kills(gateway) if kill < at), moves))
            broken[gateway] = min(at, broken.get(gateway, FOREVER))
        return len(lives), sum(self.breaks(gateway, sent, first, last) for gateway, sent in broken.items())

    def may_come_again(self, gateway, said, first, last):
        """An outcome, word for word. `said`: when the gateway said it. The second connection may deliver it before the first one does: a
        broker reads what lies in a socket that the gateway has given up."""
        return self.breaks(gateway, min(said, first), first, last)

    # 4. A message may be overtaken at a roam: a gateway that is cut off from the broker acknowledges to its disk, and the robot goes on.

    def may_be_overtaken(self, gateway, other, sent, arrived):
        return gateway != other and self.was_disturbed(gateway, sent, arrived)

    # 5. A robot that goes to a gateway which is cut off from the broker has a will: to all others it is silent.

    def may_have_a_will(self, gateway, at):
        return not any(each.begin + self.subscribed_s <= at and at - SILENCE_S <= each.good_until for each in self.connections[gateway])

    # 6. A gateway that comes back shows its robots of before until it has heard of the others. What it retained is the newest that the
    # broker has from it, and it may even say so again before it reads.

    def may_announce_anew(self, gateways, begin, seconds, earliest):
        """`earliest`: it may have done so before it was seen, at `begin`."""
        longest = self.subscribed_s + JOIN_S
        returns = [each.begin for gateway in gateways for each in self.connections[gateway][1:]] + self.returns(gateways)
        returns += [absence.end for absence in self.absences if absence.what.startswith("node")]  # for which gateways waited
        return (seconds - self.away_s(gateways, begin, begin + seconds) <= longest and
                any(at <= begin and earliest <= at + longest for at in returns))

    # 7. A command on the air when its robot goes to another gateway, or when its gateway is away, ends as `timeout`, and may have been
    # obeyed: its acknowledgement reaches nobody. A `refused` one is never obeyed.

    def may_be_obeyed_all_the_same(self, gateway, obeyed, told, moves):
        """`moves`: when the robot went to another gateway."""
        return any(obeyed <= move <= told for move in moves) or self.was_disturbed(gateway, obeyed, told)

    # 8. Each time that another gateway serves a BLE robot, one message of each of its models may go up twice: the one that was under way
    # to the broker, or whose STATUS the robot has missed. Robots on BLE cannot say which gateway a message is for.

    def changes_of_ble(self, shown, gateways):
        """`shown`: when a gateway began to show the robot that another one had shown. A gateway that stood still does so before it
        reads."""
        return sorted(list(shown) + self.returns(gateways))

    # 9. On MQTT 3.1.1 a command to which the robot has not subscribed has no outcome. A robot that begins a clean session has subscribed
    # to nothing until its SUBACK. What waited in its former session is refused before the broker forgets that.

    def may_be_unheard(self, at, bare):
        """`bare`: (from, to) of each time in which the robot had no subscription."""
        return not self.hears_all and any(since <= at <= until for since, until in bare)

    # --- What happened ---

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

    def taken_away_s(self, begin, end):
        """For how long something was taken away from `begin` to `end`."""
        return sum(max(0.0, min(absence.end, end) - max(absence.begin, begin)) for absence in self.absences)

    def returns(self, gateways):
        """When gateways went on that had been stopped or cut off."""
        return [absence.end for absence in self.absences
                if absence.what in ("gateway stopped", "link cut") and absence.who in gateways]


def gateway_at(places, when):
    return [gateway for since, gateway in places if since <= when or since == places[0][0]][-1]


def stays(places, gateway):
    """(since, until, whether it was that gateway) of each stay of a robot."""
    return [(since, until, at == gateway) for (since, at), (until, _) in zip(places, [*places[1:], (FOREVER, None)])]
