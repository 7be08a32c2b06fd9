# SPDX-License-Identifier: Apache-2.0
"""Computes the numbers of result.json from events.csv, without code of the program and without NumPy."""
import csv
import json
import math
import os
import statistics

# The least that a result.json has.
WHOLE = {"format": 1, "experiment": "ble-latency", "title": "t", "mesh": "ble", "complete": True, "simulated": False,
         "incidents": [{"t_us": 1, "what": "w"}], "differs": ["d"],
         "conditions": {"type": "update", "period_ms": 200, "time_compressed": 1, "settle_s": 0, "messages": 1000,
                        "robots": ["r"], "begun": "2026-11-28T04:00:00+00:00"},
         "thesis": {"where": "w", "result": "r", "unknown": "u", "chosen": "c", "numbers": {"n": 1, "m": [1, 2]}}}


def rows_of(directory):
    with open(os.path.join(directory, "events.csv"), newline="", encoding="utf-8") as file:
        text = file.read()
    rows = list(csv.DictReader(text[:text.rfind("\n") + 1].splitlines()))  # a truncated last line does not count
    return sorted(rows, key=lambda row: int(row["t_us"]))


def asked_for(rows, conditions):
    """Returns the rows without arrivals of a real robot beyond the requested number or time."""
    if conditions["type"] == "probe" or any(row["source"] == "robots" for row in rows):
        return rows
    arrived, kept = {}, []
    for row in rows:
        times = arrived.setdefault(row["robot"], [])
        if row in arrivals([row], conditions["type"]):
            times.append(int(row["t_us"]))
            if len(times) > conditions["messages"] or times[-1] - times[0] >= 1000 * conditions["messages"] * conditions["period_ms"]:
                continue
        kept.append(row)
    return kept


def percentile(values, part):
    """With linear interpolation between the nearest ranks."""
    ordered = sorted(values)
    place = (len(ordered) - 1) * part
    low = math.floor(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (place - low)


def arrivals(rows, wanted):
    return [row for row in rows if row["source"] == "gateway" and row["event"] == "arrived" and row["direction"] != "down"
            and row["type"] == wanted]


def name_of(row, wanted):
    """Returns robot and payload; of an update the whole coordinates."""
    payload = row["payload"]
    while wanted == "update" and len(payload) % 8 > 0:
        payload = payload[:-2]
    return row["robot"], payload


def gaps_ms(rows, wanted):
    gaps, last = [], {}
    for row in arrivals(rows, wanted):
        if row["robot"] in last:
            gaps.append((int(row["t_us"]) - last[row["robot"]]) / 1000)
        last[row["robot"]] = int(row["t_us"])
    return gaps


def acknowledged_ms(rows):
    sent, values = {}, []
    for row in (row for row in rows if row["source"] == "robots"):
        key = row["robot"], row["number"]
        if row["event"] == "sent":
            sent[key] = int(row["t_us"])
        if row["event"] == "acknowledged" and key in sent:
            values.append((int(row["t_us"]) - sent.pop(key)) / 1000)
    return values


def check(test, directory):
    """Compares result.json with the numbers from its events.csv, and returns the result."""
    with open(os.path.join(directory, "result.json"), encoding="utf-8") as file:
        result = json.load(file)
    rows = asked_for(rows_of(directory), result["conditions"])
    measured, wanted = result["measured"], result["conditions"]["type"]
    test.assertEqual(measured["counts"]["arrived"], len(arrivals(rows, wanted)))
    sent = sum(1 for row in rows if row["source"] == "robots" and row["event"] == "sent")
    if measured["loss"]["exact"] and sent:
        test.assertEqual(measured["loss"]["exact"]["sent"], sent)
        left = [name_of(row, wanted) for row in arrivals(rows, wanted)]
        missing = 0
        for row in rows:
            if row["source"] == "robots" and row["event"] == "sent":
                if name_of(row, wanted) in left:
                    left.remove(name_of(row, wanted))
                else:
                    missing += 1
        test.assertEqual(measured["loss"]["exact"]["lost"], missing)
    check_statistics(test, measured["interval_ms"], gaps_ms(rows, wanted))
    check_statistics(test, measured["acknowledged_after_ms"]["robot"], acknowledged_ms(rows))
    estimate = measured["loss"]["estimate"]
    if estimate:
        period = result["conditions"]["period_ms"]
        lost = sum(max(0, round(gap / period) - 1) for gap in gaps_ms(rows, wanted))
        test.assertEqual(estimate["lost"], lost)
        test.assertAlmostEqual(estimate["share"], lost / (lost + len(arrivals(rows, wanted))), 4)
    return result


def check_statistics(test, said, values):
    if not values:
        test.assertIsNone(said)
        return
    test.assertEqual(said["count"], len(values))
    for name, value in (("mean", statistics.fmean(values)), ("min", min(values)), ("max", max(values)),
                        ("p50", percentile(values, 0.5))):
        test.assertAlmostEqual(said[name], value, 2, name)
    for name, part in (("p90", 0.9), ("p99", 0.99)):
        if len(values) * (100 - round(100 * part)) < 500:
            test.assertIsNone(said[name], name)
        else:
            test.assertAlmostEqual(said[name], percentile(values, part), 2, name)
