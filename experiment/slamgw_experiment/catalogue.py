# SPDX-License-Identifier: Apache-2.0
"""The experiments: what each measured in the thesis, its setting as the default, and how the simulator plays it.

What the thesis does not say is named under `unknown`, and what is chosen in its place under `chosen`.
"""
import dataclasses

BLE, THREAD = "ble", "thread"

# BLE: Nordic's bearer sends a packet each 20 ms at most; a relay takes 1-3 ms (thesis 7.1); 5 % lost (thesis 9.2).
BLE_RADIO = ("--bearer-interval-ms", "20", "--hop-delay-ms", "2")
# Thread: 4.5 ms a hop for a frame of 76 octets with back-off and acknowledgement.
THREAD_RADIO = ("--hop-delay-ms", "4.5")


@dataclasses.dataclass(frozen=True)
class Experiment:
    name: str
    figures: str            # numbers of the thesis's figures, or of a section without a figure
    title: str
    meshes: tuple           # the meshes on which it can run; the thesis used the first
    kind: str               # how it is drawn: figures.py
    thesis: str             # the result in the thesis, for the caption
    thesis_numbers: dict
    unknown: str
    chosen: str
    simulated: str = ""     # the settings of the simulated robots and their radio
    messages: int = 1000
    period_ms: float = 200
    robots: int = 1
    payload: str = "positions"
    simulator: tuple = ()   # options of slam-gateway-sim besides those of the radio and the payload
    daemon: dict = dataclasses.field(default_factory=dict)  # keys of gateway.json, with --sim

    def where(self):
        """Returns the place in the thesis: a figure or a section."""
        return f"figure {self.figures}" if self.figures.startswith("8.") else f"section {self.figures}"

    def is_in_ring(self):
        return self.kind == "ring"

    def message_type(self):
        return "probe" if self.payload == "probe" else "update"


EXPERIMENTS = [
    Experiment(
        "ble-reliable", "8.1", "Acknowledged, original payload", (BLE,), "intervals",
        "most messages 2583 ms apart on average; about 200 ms were expected", {"interval_ms": 2583, "expected_ms": 200},
        "payload, count, relays; kind of plot", "a line at the thesis's mean",
        simulated="the payload of the robots before the thesis, 13 octets; 5 % lost each way",
        payload="full", daemon={"payload": {"update": "raw"}},
        simulator=("--acknowledged", "--segment-timing", "--on-busy", "cancel", "--hop-loss", "0.05", *BLE_RADIO)),
    Experiment(
        "ble-positions", "8.2", "Acknowledged, up to four obstacles", (BLE,), "intervals",
        "better than the original payload, with unpredictable spikes near 2600 ms", {"spikes_near_ms": 2600},
        "share of the spikes, what the robot saw, count", "a line at the thesis's spikes",
        simulated="a room where most updates have 0 to 2 obstacles; no stray octet, so that one obstacle fits one segment as he saw it; "
        "5 % lost each way",
        simulator=("--acknowledged", "--segment-timing", "--on-busy", "cancel", "--no-stray", "--world", "room",
                   "--hop-loss", "0.05", *BLE_RADIO)),
    Experiment(
        "ble-one-obstacle", "8.3", "Acknowledged, at most one obstacle", (BLE,), "intervals",
        "mostly 200 ms, some at 400 and 600 ms; 8-10 % lost as read off those bins", {"two_or_three_periods": [0.08, 0.10]},
        "count, bins", "shares by the nearest multiple of the period",
        simulated="one SET outstanding, cancelled by the next update; 5 % lost each way",
        simulator=("--acknowledged", "--segment-timing", "--on-busy", "cancel", "--no-stray", "--max-obstacles", "1",
                   "--hop-loss", "0.05", *BLE_RADIO)),
    Experiment(
        "ble-latency", "8.4", "SET to STATUS, one robot", (BLE,), "latency",
        "no number survives; the bound is the next update, 200 ms", {"bound_ms": 200},
        "all numbers, payload, period, count, clock", "the robot's clock where it is simulated, else the gateway's part",
        simulated="one obstacle each 200 ms as in 8.7; 5 % lost each way",
        simulator=("--acknowledged", "--segment-timing", "--on-busy", "cancel", "--no-stray", "--max-obstacles", "1",
                   "--hop-loss", "0.05", *BLE_RADIO)),
    Experiment(
        "ble-unreliable", "8.5", "Unacknowledged messages", (BLE,), "intervals",
        "some at 400 and 600 ms; about 5 % lost as read off those bins", {"two_or_three_periods": 0.05},
        "period (200 ms is implied), payload, count", "shares by the nearest multiple of the period",
        simulated="one obstacle; 5 % lost",
        simulator=("--segment-timing", "--on-busy", "cancel", "--no-stray", "--max-obstacles", "1", "--hop-loss", "0.05",
                   *BLE_RADIO)),
    Experiment(
        "ble-hop", "8.6", "Unacknowledged messages over one relay", (BLE,), "intervals",
        "72 received, 42 of 114 lost (36.8 %; he says about 30 %)", {"received": 72, "lost": 42, "loss_estimate": 42 / 114},
        "payload, distances, which leg lost", "shares by the nearest multiple of the period",
        simulated="one obstacle; 33.5 % lost on the robot's hop and 5 % on the relay's",
        messages=114,
        simulator=("--segment-timing", "--on-busy", "cancel", "--no-stray", "--max-obstacles", "1", "--hops", "2", "--hop-loss",
                   "0.335,0.05", *BLE_RADIO)),
    Experiment(
        "ble-two-robots", "8.7", "SET to STATUS, two robots", (BLE,), "latency",
        "an indication of 10 ms more on average than with one robot", {"more_than_one_robot_ms": 10},
        "all absolute numbers; what a bar is", "a colour for each robot",
        simulated="they begin 7 ms apart; 5 % lost each way",
        robots=2,
        simulator=("--acknowledged", "--segment-timing", "--on-busy", "cancel", "--no-stray", "--max-obstacles", "1",
                   "--hop-loss", "0.05", *BLE_RADIO)),
    Experiment(
        "thread-publish", "8.8", "PUBLISH at QoS 1", (THREAD,), "intervals",
        "no unexpected values", {}, "the variable (gaps are likely), period, payload, count",
        "gaps between arrivals", simulated="5 % of the frames lost",
        simulator=("--hop-loss", "0.05", *THREAD_RADIO)),
    Experiment(
        "thread-puback", "8.9", "PUBLISH to PUBACK", (THREAD,), "latency",
        "no unexpected values; at most 34 ms of it were the way to the broker", {"broker_ping_ms": 34},
        "all numbers, period, payload, count", "the robot's clock where it is simulated, and the gateway's part by itself",
        simulated="the broker is on this host; 5 % of the frames lost",
        simulator=("--hop-loss", "0.05", *THREAD_RADIO)),
    Experiment(
        "thread-hop", "8.10-8.12", "PUBLISH to PUBACK over one relay", (THREAD,), "hop",
        "clusters at 8 s and 16 s, only two messages at 16 s; no complete loss counted; many frames sent again",
        {"clusters_ms": [8000, 16000], "messages_at_16_s": 2}, "count, all values of 8.12",
        "a logarithmic axis",
        simulated="35 % of the frames lost on each of two hops, repeated up to three times by IEEE 802.15.4",
        simulator=("--hops", "2", "--hop-loss", "0.35", *THREAD_RADIO)),
    Experiment(
        "thread-1000", "8.13", "Sent against received", (THREAD,), "counts",
        "1000 sent, 1000 received, none twice", {"sent": 1000, "received": 1000, "doubled": 0},
        "hops, period, the subscriber's QoS, how sent was counted", "probes each 200 ms; a subscriber at the broker with QoS 1",
        simulated="5 % of the frames lost", payload="probe", simulator=("--hop-loss", "0.05", *THREAD_RADIO)),
    Experiment(
        "ring", "8.14", "Obstacles in the test ring", (THREAD, BLE), "ring",
        "the wall of a ring of 160 cm is visible; hard to keep accurate and consistent far out", {"radius_cm": 80},
        "where the robot stood or drove, all numbers", "a circle by least squares",
        simulated="the thesis's robot drives around",
        simulator=("--robot", "thesis")),
    Experiment(
        "probe", "9.2", "Exact loss and delay", (BLE, THREAD), "probe",
        "exact loss was wished for and hard to count", {}, "how it would be counted", "probes with sequence number and the sender's milliseconds",
        simulated="acknowledged on neither mesh; 5 % of the frames lost, which Thread's link repeats", payload="probe"),
    Experiment(
        "limits", "9.3", "Robots and rate, until it breaks", (BLE, THREAD), "limits",
        "two robots cost about 10 ms more; he wished for more of them, until the delay is too long or messages are missing",
        {"more_than_one_robot_ms": 10}, "all numbers", "acknowledged messages of one obstacle",
        simulated="5 % of the frames lost; robots do not disturb each other on the air", messages=100),
]

# Settings that `--sim` adds if an experiment runs on either mesh.
EITHER_MESH = {
    ("ring", BLE): ("--no-stray", *BLE_RADIO),
    ("ring", THREAD): THREAD_RADIO,
    ("limits", BLE): ("--acknowledged", "--segment-timing", "--on-busy", "cancel", "--no-stray", "--max-obstacles", "1",
                      "--hop-loss", "0.05", *BLE_RADIO),
    ("limits", THREAD): ("--max-obstacles", "1", "--hop-loss", "0.05", *THREAD_RADIO),
    ("probe", BLE): ("--hop-loss", "0.05", *BLE_RADIO),
    ("probe", THREAD): ("--qos", "0", "--hop-loss", "0.05", *THREAD_RADIO),
}

# Pairs of experiments with the same question, for one page with both meshes.
PAIRS = [
    ("How regularly do messages arrive?", "ble-one-obstacle", "thread-publish"),
    ("How long until the robot is acknowledged?", "ble-latency", "thread-puback"),
    ("What does a relay cost?", "ble-hop", "thread-hop"),
    ("How much is lost, exactly?", "probe-ble", "probe-thread"),
    ("Does all arrive, and once?", "ble-unreliable", "thread-1000"),
    ("Is the map right?", "ring-ble", "ring-thread"),
    ("Longer messages, and more robots", "ble-reliable", None),
    (None, "ble-positions", None),
    (None, "ble-two-robots", None),
]


def find(name):
    return next((one for one in EXPERIMENTS if one.name == name), None)


def simulator_options(experiment, mesh, more=()):
    """Returns the options of the simulator: the experiment's own, then `more`, which replace the own ones of the same name."""
    replaced = {word.partition("=")[0] for word in more}
    kept, is_kept = [], True
    for word in (*experiment.simulator, *EITHER_MESH.get((experiment.name, mesh), ())):
        is_kept = word not in replaced if word.startswith("--") else is_kept
        kept += [word] if is_kept else []
    return [*kept, *more]
