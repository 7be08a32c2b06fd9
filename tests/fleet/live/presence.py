# SPDX-License-Identifier: Apache-2.0
"""Finds how long the broker showed a robot at more than one gateway. Used by judge."""


def contradictions(views, name):
    """Yields (begin, seconds, gateways, earliest start) of each time that a robot was `online` at several gateways. `views`: (time, topic,
    payload, is_retained) of one observer in their order, without a topic where it was cut off. Retained messages at its return may be as
    old as the cut."""
    online, begin, cut = {}, None, 0.0
    for at, topic, payload, is_retained in views:
        if topic is not None and not topic.endswith(f"/robots/{name}"):
            continue
        before = dict(online)
        if topic is None:
            online.clear()
            cut = at
        elif b'"online"' in payload:
            online[topic.split("/")[2]] = at
        else:
            online.pop(topic.split("/")[2], None)
        if len(online) > 1 and begin is None:
            begin, earliest = at, cut if is_retained else at
        elif len(online) < 2 and begin is not None:
            yield begin, at - begin, sorted(before), earliest
            begin = None
    if begin is not None:
        yield begin, views[-1][0] - begin, sorted(online), earliest


def longest_contradiction(views_of_observers, name, is_bound):
    """Returns the longest contradiction beyond the bounds, as the observer with the shortest one saw it. Other nodes were late or down."""
    longest = [max((each for each in contradictions(views, name) if not is_bound(*each)), key=lambda each: each[1],
                   default=(0.0, 0.0, [], 0.0)) for views in views_of_observers]
    return min(longest, key=lambda each: each[1])


def showings(views_of_observers, names):
    """Returns by robot (time, gateway) of each time that a gateway began to show it, as the first observer saw it."""
    found = {name: {} for name in names}
    for views in views_of_observers:
        online = set()
        for at, topic, payload, is_retained in views:
            if topic is None:
                online.clear()
                continue
            gateway, name = topic.split("/")[2], topic.split("/")[-1]
            if name not in found or b'"online"' not in payload:
                online.discard((gateway, name))
                continue
            if (gateway, name) not in online and not is_retained:
                times = found[name].setdefault(gateway, [])
                if all(abs(at - each) > 1 for each in times):  # another observer has seen the same
                    times.append(at)
            online.add((gateway, name))
    return {name: sorted((at, int(gateway.removeprefix("gw-"))) for gateway, times in each.items() for at in times)
            for name, each in found.items()}
