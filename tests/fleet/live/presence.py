# SPDX-License-Identifier: Apache-2.0
"""For how long the broker named more than one gateway for a robot. Used by judge."""


def contradictions(views, name):
    """`views`: (time, topic, payload) of one observer in the order that they came, without a topic where it was cut off.
    (begin, seconds, gateways) of each time that a robot was `online` at several gateways."""
    online, begin = {}, None
    for at, topic, payload in views:
        if topic is not None and not topic.endswith(f"/robots/{name}"):
            continue
        before = dict(online)
        if topic is None:
            online.clear()
        elif b'"online"' in payload:
            online[topic.split("/")[2]] = at
        else:
            online.pop(topic.split("/")[2], None)
        if len(online) > 1 and begin is None:
            begin = at
        elif len(online) < 2 and begin is not None:
            yield begin, at - begin, sorted(before)
            begin = None
    if begin is not None:
        yield begin, views[-1][0] - begin, sorted(online)


def longest_contradiction(views_of_observers, name, is_bound):
    """As the observer saw it that saw the least of it: others' nodes were late, or away. Without those that are within a bound."""
    longest = [max((each for each in contradictions(views, name) if not is_bound(*each)), key=lambda each: each[1],
                   default=(0.0, 0.0, [])) for views in views_of_observers]
    return min(longest, key=lambda each: each[1])
