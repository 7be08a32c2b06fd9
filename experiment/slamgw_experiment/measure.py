# SPDX-License-Identifier: Apache-2.0
"""Computes all numbers in `measured` of result.json, from events.csv alone."""
import collections
import math

import numpy

from slamgw_experiment.events import BROKER, GATEWAY, ROBOTS

SEQUENCE_NUMBERS, CLOCK_MS = 2 ** 16, 2 ** 32  # a probe's number and its sender's clock wrap
LATEST_MS = 30_000        # the last repeat of a probe is not later
ENOUGH_BEYOND = 5         # values beyond a percentile: with fewer it is meaningless
RESAMPLES, LEAST_RESAMPLES, MOST_DRAWN = 1000, 200, 20_000_000


def intervals_ms(events, message_type):
    """{robot: gaps between its arrivals at the gateway, in milliseconds}"""
    times = collections.defaultdict(list)
    for event in events:
        if event.is_arrival_of(message_type):
            times[event.robot].append(event.t_us)
    return {robot: numpy.diff(numpy.array(at)) / 1000 for robot, at in sorted(times.items())}


def robot_latencies_ms(events):
    """{robot: milliseconds from a message's first sending to its acknowledgement}, as the robots themselves saw it."""
    sent = {}
    latencies = collections.defaultdict(list)
    for event in events:
        if event.source != ROBOTS:
            continue
        key = (event.robot, event.number)
        if event.event == "sent":
            sent[key] = event.t_us
        elif event.event == "acknowledged" and key in sent:
            latencies[event.robot].append((event.t_us - sent.pop(key)) / 1000)
    return {robot: numpy.array(values) for robot, values in sorted(latencies.items())}


def late(sent, latencies_by_robot, period_ms):
    """The thesis's criterion (9.3): the part of the messages whose acknowledgement has not come before the next one is due."""
    in_time = sum(int(numpy.sum(values <= period_ms)) for values in latencies_by_robot.values())
    return share(sent - in_time, sent)


def gateway_latencies_ms(events, message_type):
    """{robot: milliseconds from a message's arrival to its acknowledgement by the gateway}; broker or disk are inside."""
    latencies = collections.defaultdict(list)
    for event in events:
        if event.source == GATEWAY and event.event == "acknowledged" and event.latency_us is not None:
            if event.direction != "down" and event.type in (message_type, ""):
                latencies[event.robot].append(event.latency_us / 1000)
    return {robot: numpy.array(values) for robot, values in sorted(latencies.items())}


def unwrapped(value, last, turn):
    """Returns the number that is `value` apart from whole turns and lies closest to `last`."""
    return value + round((last - value) / turn) * turn


def probes_of(events):
    """Returns [(event, (robot, restarts), number, sender_ms)] of the probes that arrived; numbers and clocks do not wrap there.

    A robot has restarted when its clock fell behind, which an old probe explains for LATEST_MS only, or leapt into the future.
    """
    found, last = [], {}
    for event in events:
        if not event.is_arrival_of("probe") or event.number is None or event.sender_ms is None:
            continue
        t_ms = event.t_us / 1000
        restarts, number, newest_ms, offset_ms = last.get(event.robot, (0, event.number, event.sender_ms, t_ms - event.sender_ms))
        number, sender_ms = unwrapped(event.number, number, SEQUENCE_NUMBERS), unwrapped(event.sender_ms, newest_ms, CLOCK_MS)
        later_ms = t_ms - sender_ms - offset_ms
        if sender_ms < newest_ms and later_ms > LATEST_MS or later_ms < -LATEST_MS:
            restarts, number, sender_ms = restarts + 1, event.number, event.sender_ms
            newest_ms, offset_ms = sender_ms, t_ms - sender_ms
        last[event.robot] = restarts, number, max(newest_ms, sender_ms), min(offset_ms, t_ms - sender_ms)
        found.append((event, (event.robot, restarts), number, sender_ms))
    return found


def restarts_of_robots(events):
    """Returns an incident for each restart that the probes show."""
    begins = {life: event.t_us for event, life, _, _ in reversed(probes_of(events))}
    return [{"t_us": t_us, "what": f"{robot} restarted: the numbers of its probes began again, so what got lost just then is not counted"}
            for (robot, restarts), t_us in sorted(begins.items(), key=lambda item: item[1]) if restarts > 0]


def probe_delays_ms(events):
    """{robot: how much later than its fastest probe since its start each probe came}: needs no common clock."""
    offsets = collections.defaultdict(list)
    for event, life, _, sender_ms in probes_of(events):
        offsets[life].append(event.t_us / 1000 - sender_ms)
    delays = collections.defaultdict(list)
    for (robot, _), values in sorted(offsets.items()):
        delays[robot].extend(numpy.array(values) - min(values))
    return {robot: numpy.array(values) for robot, values in delays.items()}


def repeats_by_message(events):
    """({message: repeats by the client}, {message: repeats between two hops}), for each message that was sent.

    Without the robots' own record: the repeats that the gateway saw, for each message that arrived.
    """
    client, link = {}, {}
    if not any(event.source == ROBOTS for event in events):
        return _repeats_at_gateway(events), {}
    for event in events:
        key = (event.robot, event.number)
        if event.source != ROBOTS:
            continue
        if event.event == "sent":
            client.setdefault(key, 0)
            link.setdefault(key, 0)
        elif event.event == "repeat":
            client[key] = client.get(key, 0) + 1
        elif event.event == "link_repeat":
            link[key] = link.get(key, 0) + 1
    return client, link


def _repeats_at_gateway(events):
    """Counts repeats by message id. A robot uses each id again after 65535 messages."""
    repeats = {}
    for event in events:
        key = (event.robot, event.message_id)
        if event.source != GATEWAY or not event.message_id or event.direction == "down":
            continue
        if event.event == "arrived":
            repeats.setdefault(key, 0)
        elif event.event == "repeat":
            repeats[key] = repeats.get(key, 0) + 1
    return repeats


def statistics(values):
    """Count, mean and median with their 95 % intervals, percentiles where there are enough values; None for no values."""
    values = numpy.asarray(values, dtype=float)
    if values.size == 0:
        return None
    numbers = {"mean": values.mean(), "min": values.min(), "p50": numpy.median(values), "max": values.max()}
    found = {"count": int(values.size)} | {name: round(float(value), 3) for name, value in numbers.items()}
    for name, percent in (("p90", 90), ("p99", 99)):
        found[name] = round(float(numpy.percentile(values, percent)), 3) if has_percentile(values.size, percent) else None
    found["mean_95_percent"] = bootstrap(numpy.mean, values)
    found["p50_95_percent"] = bootstrap(numpy.median, values)
    return found


def has_percentile(count, percent):
    return count * (100 - percent) >= 100 * ENOUGH_BEYOND


def bootstrap(statistic, *samples):
    """Returns the 95 % interval of statistic(*samples) by resampling with replacement; None for fewer than two values.

    It takes messages as independent of each other. The same samples give the same interval.
    """
    if min(len(sample) for sample in samples) < 2:
        return None
    generator = numpy.random.default_rng(1)
    times = int(min(RESAMPLES, max(LEAST_RESAMPLES, MOST_DRAWN // sum(len(sample) for sample in samples))))
    drawn = [statistic(*(sample[generator.integers(0, len(sample), len(sample))] for sample in samples)) for _ in range(times)]
    return [round(float(end), 3) for end in numpy.percentile(drawn, [2.5, 97.5])]


def difference_of_means(one, other):
    """Returns (mean of `one` minus mean of `other`, its 95 % interval)."""
    return float(one.mean() - other.mean()), bootstrap(lambda a, b: a.mean() - b.mean(), one, other)


def pooled(by_robot):
    return numpy.concatenate(list(by_robot.values())) if by_robot else numpy.array([])


def estimated_loss(gaps_by_robot, period_ms):
    """The thesis's way (9.2): a gap of two periods is one lost message. Misses losses at both ends, and takes delays for losses."""
    lost = sum(int(max(0, round(gap / period_ms) - 1)) for gaps in gaps_by_robot.values() for gap in gaps)
    received = sum(len(gaps) + 1 for gaps in gaps_by_robot.values())
    return _loss(lost + received, lost, "an estimate, from gaps between arrivals (thesis 9.2)") if received else None


def probe_counts(events):
    """{(robot, restarts): (sequence numbers that arrived, without doubles; arrivals more than once)}"""
    numbers = collections.defaultdict(list)
    for _, life, number, _ in probes_of(events):
        numbers[life].append(number)
    return {life: (sorted(set(ones)), len(ones) - len(set(ones))) for life, ones in sorted(numbers.items())}


def counted(events, message_type, messages, period_ms, end_us):
    """Drops messages that real robots sent after `end_us`, while the run only waited for late repeats. `events` are in order of time."""
    if any(event.source == ROBOTS for event in events):
        return events
    events = _with_probes_in_time(events, end_us)
    return events if message_type == "probe" else _with_first_of_each_robot(events, message_type, messages, period_ms * 1000)


def _with_first_of_each_robot(events, message_type, messages, period_us):
    """Returns each robot's first messages: the requested number, within as many periods from the first, so lost ones are included.

    What happened to a message after its arrival names its id, or at the broker its payload; either may come again.
    """
    begin_us, arrived, is_counted = {}, collections.Counter(), {}
    chosen = []
    for event in events:
        if event.is_arrival_of(message_type):
            begin_us.setdefault(event.robot, event.t_us)
            arrived[event.robot] += 1
        is_in_time = event.t_us < begin_us.get(event.robot, -math.inf) + messages * period_us and arrived[event.robot] <= messages
        if event.is_arrival_of(message_type):
            is_counted[GATEWAY, event.robot, event.message_id] = is_counted[BROKER, event.robot, event.payload] = is_in_time
        elif event.type in (message_type, "") and event.direction != "down":
            name = event.payload if event.source == BROKER else event.message_id
            is_in_time = is_counted.get((event.source, event.robot, name), is_in_time)
        else:
            is_in_time = True
        if is_in_time:
            chosen.append(event)
    return chosen


def _with_probes_in_time(events, end_us):
    """Drops events of probes made before the run began, or too late for their last repeat to come before it ended.

    When a probe was made follows from its sender's clock and the fastest probe of the same robot since its start. What the gateway
    did with it names the message id only, which a robot uses again; the broker names the payload.
    """
    arrived = probes_of(events)
    if not arrived:
        return events
    offsets = {}
    for event, life, _, sender_ms in arrived:
        offsets[life] = min(offsets.get(life, math.inf), event.t_us - sender_ms * 1000)
    in_time = {id(event): 0 <= sender_ms * 1000 + offsets[life] <= end_us for event, life, _, sender_ms in arrived}
    is_counted = {}  # (source, robot, message id or payload): whether the last such message is
    chosen = []
    for event in events:
        if id(event) in in_time:
            is_in_time = in_time[id(event)]
            is_counted[GATEWAY, event.robot, event.message_id] = is_counted[BROKER, event.robot, event.payload] = is_in_time
        else:
            name = event.payload if event.source == BROKER else event.message_id
            is_in_time = event.type != "probe" or is_counted.get((event.source, event.robot, name), False)
        if is_in_time:
            chosen.append(event)
    return chosen


def has_unsent_arrivals(events, message_type):
    """Returns whether the simulated robots' record lacks lines, because more messages arrived. Copies count once."""
    arrived = {(event.robot, event.message_id, event.payload) for event in events if event.is_arrival_of(message_type)}
    return len(arrived) > sum(1 for event in events if event.source == ROBOTS and event.event == "sent")


def exact_loss(events, message_type):
    """Computes the loss by the record of simulated robots, else by the sequence numbers of probes; None without either.

    A message that arrives twice does not stand in for a lost one, unless the robot sent the same payload twice.
    """
    sent = collections.Counter(_name(event, message_type) for event in events if event.source == ROBOTS and event.event == "sent")
    if sent:
        arrived = collections.Counter(_name(event, message_type) for event in events if event.is_arrival_of(message_type))
        doubled = sum(max(0, arrived[name] - times) for name, times in sent.items())
        return _loss(sent.total(), (sent - arrived).total(), "exact, from the simulated robots' own record") | {"doubled": doubled}
    probes = probe_counts(events)
    if not probes:
        return None
    expected = sum(numbers[-1] - numbers[0] + 1 for numbers, _ in probes.values())
    found = sum(len(numbers) for numbers, _ in probes.values())
    return (_loss(expected, expected - found, "exact between the first and the last probe, from sequence numbers")
            | {"doubled": sum(doubled for _, doubled in probes.values())})


def _name(event, message_type):
    """Returns robot and payload, of an update without the stray octet that the gateway drops."""
    is_update = message_type == "update"
    return event.robot, event.payload[: len(event.payload) // 8 * 8] if is_update else event.payload


def _loss(sent, lost, how):
    found = share(lost, sent)
    return {"sent": sent, "lost": lost, "share": found["share"], "share_95_percent": found["share_95_percent"], "how": how}


def share(found, of):
    low, high = wilson(found, of)
    return {"found": int(found), "of": int(of), "share": round(found / of, 5) if of else None,
            "share_95_percent": [round(low, 5), round(high, 5)]}


def wilson(found, of, z=1.959964):
    """Returns the 95 % interval of a share."""
    if of == 0:
        return 0.0, 1.0
    share = found / of
    centre = (share + z * z / (2 * of)) / (1 + z * z / of)
    half = z * ((share * (1 - share) / of + z * z / (4 * of * of)) ** 0.5) / (1 + z * z / of)
    return max(0.0, centre - half), min(1.0, centre + half)


def shares_of_periods(gaps, period_ms, most=5):
    """Returns the share of gaps that round to 1, 2, ... periods."""
    if len(gaps) == 0:
        return {}
    rounded = _periods(gaps, period_ms)
    shares = {f"{n * period_ms:g}": share(numpy.sum(rounded == n), len(gaps)) for n in range(1, most + 1)}
    shares["longer"] = share(numpy.sum(rounded > most), len(gaps))
    return shares


def _periods(gaps, period_ms):
    return numpy.maximum(1, numpy.rint(numpy.asarray(gaps) / period_ms)).astype(int)


def two_or_three_periods(gaps, period_ms):
    """Returns the share of gaps that the thesis took as loss in its histograms: the bins at 400 and 600 ms."""
    rounded = _periods(gaps, period_ms)
    return share(numpy.sum((rounded == 2) | (rounded == 3)), len(gaps))


def counts(events, message_type):
    """Counts each kind of event; `received` at the broker comes from a subscriber, else from the daemon's trace."""
    by_kind = collections.Counter((event.source, event.event) for event in events
                                  if event.direction != "down" and event.type in (message_type, ""))
    heard = [(event.robot, event.payload) for event in events
             if event.source == BROKER and event.type == message_type]
    probes = probe_counts(events)
    result = {
        "arrived": by_kind[GATEWAY, "arrived"],
        "repeats_seen": by_kind[GATEWAY, "repeat"],
        "published": by_kind[GATEWAY, "published"],
        "stored": by_kind[GATEWAY, "stored"],
    }
    if any(source == ROBOTS for source, _ in by_kind):
        for name, kind in (("measured", None), ("sent", "sent"), ("acknowledged", "acknowledged"), ("refused", "refused"),
                           ("cancelled", "cancelled"), ("given_up", "given_up"), ("client_repeats", "repeat"),
                           ("link_repeats", "link_repeat")):
            result[name] = by_kind[ROBOTS, kind] if kind else by_kind[ROBOTS, "sent"] + by_kind[ROBOTS, "refused"]
    if any(event.source == BROKER for event in events):
        result["received_at_broker"] = len(heard)
        if message_type == "probe":
            result["doubled_at_broker"] = len(heard) - len(set(heard))
    if probes:
        result["probes_doubled"] = sum(doubled for _, doubled in probes.values())
    return result


def points(events):
    """Returns (positions, obstacles) of all updates, each an array of x, y in centimetres."""
    positions, obstacles = [], []
    for event in events:
        if not event.is_arrival_of("update"):
            continue
        octets = bytes.fromhex(event.payload)
        octets = octets[: len(octets) // 4 * 4]
        pairs = numpy.frombuffer(octets, dtype="<i2").reshape(-1, 2)
        positions.extend(pairs[:1].tolist())
        obstacles.extend(pairs[1:].tolist())
    return numpy.array(positions, dtype=float).reshape(-1, 2), numpy.array(obstacles, dtype=float).reshape(-1, 2)


def fitted_circle(places):
    """The circle with the least squares of x^2 + y^2 (Kasa), and how far the points lie from it; None for fewer than three."""
    if len(places) < 3:
        return None
    x, y = places[:, 0], places[:, 1]
    solution, _, rank, _ = numpy.linalg.lstsq(numpy.column_stack([2 * x, 2 * y, numpy.ones_like(x)]), x * x + y * y,
                                              rcond=None)
    if rank < 3:
        return None
    radius = float(numpy.sqrt(solution[2] + solution[0] ** 2 + solution[1] ** 2))
    errors = numpy.hypot(x - solution[0], y - solution[1]) - radius
    return {"x_cm": round(float(solution[0]), 2), "y_cm": round(float(solution[1]), 2), "radius_cm": round(radius, 2),
            "rms_error_cm": round(float(numpy.sqrt(numpy.mean(errors ** 2))), 2), "points": int(len(places))}


def measured(events, message_type, period_ms, in_ring=False):
    """Returns `measured` of result.json, from counted() events.

    `in_ring`: the robot drives in a ring, so a circle through its obstacles means something.
    """
    gaps = intervals_ms(events, message_type)
    all_gaps = pooled(gaps)
    # On Thread a gap is a delay: clients repeat what got lost.
    is_ble = any(event.mesh == "ble" for event in events if event.is_arrival_of(message_type))
    estimate = estimated_loss(gaps, period_ms) if is_ble else None
    robots = robot_latencies_ms(events)
    gateway = gateway_latencies_ms(events, message_type)
    delays = probe_delays_ms(events)
    client, link = repeats_by_message(events)
    positions, obstacles = points(events) if in_ring else ((), ())
    sizes = collections.Counter(event.bytes for event in events if event.is_arrival_of(message_type))
    result = {
        "counts": counts(events, message_type),
        "loss": {"exact": exact_loss(events, message_type), "estimate": estimate},
        "interval_ms": statistics(all_gaps),
        "interval_shares": shares_of_periods(all_gaps, period_ms),
        "two_or_three_periods": two_or_three_periods(all_gaps, period_ms),
        "acknowledged_after_ms": {"robot": statistics(pooled(robots)), "gateway": statistics(pooled(gateway))},
        "acknowledged_after_ms_by_robot": {robot: statistics(values) for robot, values in robots.items()},
        "payload_octets": {str(size): count for size, count in sorted(sizes.items(), key=lambda item: item[0] or 0)},
    }
    if delays:
        result["probe_delay_ms"] = statistics(pooled(delays))
    made, exact = result["counts"].get("measured"), result["loss"]["exact"]
    if made:
        result["never_left"] = share(result["counts"]["refused"], made)
        result["not_arrived"] = share(made - (exact["sent"] - exact["lost"] if exact else 0), made)
        result["late"] = late(result["counts"]["sent"], robots, period_ms)
    if client:
        result["messages_repeated_by_client"] = {
            str(n): count for n, count in sorted(collections.Counter(client.values()).items())}
    if link:
        result["messages_repeated_on_link"] = {
            str(n): count for n, count in sorted(collections.Counter(link.values()).items())}
    if in_ring and message_type == "update" and len(obstacles):
        result["ring"] = fitted_circle(obstacles)
        result["positions"] = int(len(positions))
    return result
