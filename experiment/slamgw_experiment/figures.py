# SPDX-License-Identifier: Apache-2.0
"""Draws figure.svg and figure.png of a result folder. Matplotlib draws; the numbers come from measure.py."""
import collections
import os
import textwrap
import warnings

import matplotlib

matplotlib.use("Agg")
# pylint: disable=wrong-import-position
import matplotlib.pyplot as plt  # noqa: E402
import numpy  # noqa: E402

from slamgw_experiment import measure  # noqa: E402

MESH_NAMES = {"ble": "BLE Mesh", "thread": "Thread"}
COLOURS = {"ble": "#2166ac", "thread": "#1b7837"}
SECOND, THESIS, GREY = "#e08214", "#b2182b", "#666666"
STYLE = {
    "font.family": "DejaVu Sans", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "axes.grid.axis": "y", "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.axisbelow": True,
    "axes.titlesize": 9, "axes.titleweight": "bold", "axes.titlelocation": "left", "legend.frameon": False,
    "svg.hashsalt": "slam-gateway-experiment", "svg.fonttype": "path",
    "text.parse_math": False,  # a robot may have $ in its name
}
WIDTH_IN, PANEL_IN, CAPTION_CHARACTERS, LINE_IN = 6.6, 2.9, 112, 0.15
MOST_BINS = 500     # of a histogram; one value far off must not make millions
MOST_SERIES = 4     # robots that get a colour of their own
MOST_OF_A_NAME = 24


def draw(directory, result, events):
    """Writes both files of the folder, with the same picture."""
    if result.get("measured") is None:
        return
    drawers = {"intervals": [_intervals], "latency": [_latency], "hop": [_hop_all, _hop_first, _hop_repeats],
               "counts": [_counts], "ring": [_ring], "probe": [_counts, _probe_delay], "limits": [_latency]}
    panels = drawers[_kind(result)]
    has_data = result["measured"]["counts"]["arrived"] > 0
    text = caption(result)
    heights = [1.75 if panel is _ring else 1 for panel in panels]
    caption_in = LINE_IN * (len(text.splitlines()) + 1)
    with plt.rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name in a script that the font lacks
        figure = plt.figure(figsize=(WIDTH_IN, 0.55 + PANEL_IN * sum(heights) + caption_in))
        whole_in = figure.get_figheight()
        grid = figure.add_gridspec(len(panels), 1, left=0.1, right=0.97, top=1 - (0.62 if len(panels) > 1 or heights[0] > 1 else 0.45) / whole_in,
                                   bottom=(caption_in + 0.45) / whole_in, hspace=0.38, height_ratios=heights)
        figure.text(0.02, 1 - 0.1 / whole_in, title(result), fontsize=11, fontweight="bold", va="top")
        if result["simulated"]:
            mark_as_simulated(figure, whole_in)
        for row, panel in enumerate(panels):
            axes = figure.add_subplot(grid[row])
            panel(axes, result, events) if has_data else _nothing(axes)
        figure.text(0.02, 0.06 / whole_in, text, fontsize=7.8, va="bottom", linespacing=1.35)
        save(figure, directory, result["simulated"])


def save(figure, directory, is_simulated):
    """Saves the figure. Text becomes outlines in the SVG, so that it needs no font; a comment keeps the mark for programs."""
    path = os.path.join(directory, "figure.svg")
    figure.savefig(path, metadata={"Date": None})
    if is_simulated:
        with open(path, "a", encoding="utf-8") as file:
            file.write("<!-- SIMULATED -->\n")
    figure.savefig(os.path.join(directory, "figure.png"), dpi=150, metadata={"Software": None})
    plt.close(figure)


def _kind(result):
    from slamgw_experiment import catalogue
    experiment = catalogue.find(result["experiment"])
    return experiment.kind if experiment else "intervals"


def title(result):
    """Returns the title with the figure's number in the thesis."""
    number = result["thesis"]["where"].removeprefix("figure ")
    return f"{number[:1].upper()}{number[1:]}  {result['title']} · {MESH_NAMES.get(result['mesh'], result['mesh'])}"


def mark_as_simulated(figure, whole_in):
    figure.text(0.98, 1 - 0.12 / whole_in, "SIMULATED", ha="right", va="top", fontsize=8, fontweight="bold", color="white",
                bbox={"boxstyle": "round,pad=0.3", "facecolor": THESIS, "edgecolor": "none"})


def _nothing(axes):
    axes.text(0.5, 0.5, "no messages arrived", transform=axes.transAxes, ha="center", color=GREY, fontsize=12)
    axes.set_xticks([])
    axes.set_yticks([])


# Texts for numbers with their 95 % intervals

def percent(share):
    """"8.4 % (6.9 to 10.3 %)" of a share of measure.py; empty where there is none."""
    if not share or share["share"] is None:
        return ""
    low, high = share["share_95_percent"]
    return f"{share['share']:.1%} ({100 * low:.1f} to {high:.1%})".replace("%", " %")


def with_interval(value, interval, unit="ms"):
    between = f" ({interval[0]:.1f} to {interval[1]:.1f})" if interval else ""
    return f"{value:.1f} {unit}{between}"


def _mean_and_tail(values):
    """Returns the mean and the highest percentile with enough values."""
    mean = f"mean {with_interval(float(values.mean()), measure.bootstrap(numpy.mean, values))}"
    for far in (99, 90):
        if measure.has_percentile(len(values), far):
            return f"{mean}, {far} % within {numpy.percentile(values, far):.1f} ms"
    return f"{mean}, all within {values.max():.1f} ms"


# Panels

def _histogram(axes, series, end, bins, colours, labels=None):
    """Draws values beyond `end` apart, behind the axis's end, and adds them to no bin."""
    for index, values in enumerate(series):
        axes.hist(values[values <= end], bins=bins, color=colours[index % len(colours)], alpha=0.75 if len(series) > 1 else 1,
                  label=labels[index] if labels else None)
    beyond = numpy.concatenate(list(series))
    beyond = beyond[beyond > end]
    width = end * 0.05
    axes.set_xlim(0, end + (4 * width if len(beyond) else width / 2))
    if not len(beyond):
        return
    axes.set_xticks([tick for tick in axes.get_xticks() if 0 <= tick <= end])
    axes.bar(end + 2 * width, len(beyond), width=width, color="white", edgecolor=THESIS, hatch="////", linewidth=0.8)
    axes.axvline(end + width / 2, color=GREY, linewidth=0.8, linestyle=":")
    axes.annotate(f"{len(beyond)} beyond,\nup to {beyond.max():.0f} ms", (end + 2 * width, len(beyond)), xytext=(0, 3),
                  textcoords="offset points", ha="center", fontsize=7.5, color=THESIS)


def _intervals(axes, result, events):
    period = result["conditions"]["period_ms"]
    gaps = measure.pooled(measure.intervals_ms(events, result["conditions"]["type"]))
    if not len(gaps):
        return _nothing(axes)
    thesis_ms = result["thesis"]["numbers"].get("interval_ms") or result["thesis"]["numbers"].get("spikes_near_ms")
    thesis_ms = thesis_ms if isinstance(thesis_ms, (int, float)) and result["conditions"]["time_compressed"] == 1 else 0
    wide = max(gaps.max(), thesis_ms) > 7.5 * period
    bin_ms = period / 4 if wide else period / 10
    end = max(5 * period, numpy.percentile(gaps, 99.9) + 2 * bin_ms, 1.05 * thesis_ms)
    bin_ms = max(bin_ms, end / MOST_BINS)
    # Bins are centred on multiples of their width, so that none ends at a multiple of the period.
    edges = numpy.arange(-bin_ms / 2, end + bin_ms, bin_ms)
    heights, _ = numpy.histogram(gaps[gaps <= end], bins=edges)
    _histogram(axes, [gaps], end, edges, [COLOURS.get(result["mesh"], GREY)])
    _count_logarithmically(axes)
    if not wide:
        axes.set_xticks(numpy.arange(0, end + period, period))
    if not wide and result["mesh"] == "ble":  # on Thread a gap is a delay
        _tell_shares(axes, result["measured"]["interval_shares"], period, heights, edges)
    if thesis_ms:
        _thesis_line(axes, thesis_ms, f"thesis: {thesis_ms} ms")
    axes.set_xlabel(f"time between two arrivals at the gateway / ms, in bins of {bin_ms:g} ms" + _compressed(result))
    axes.set_ylabel("messages")


def _tell_shares(axes, shares, period, heights, edges):
    """Places a label beside the tallest bin near each multiple of the period."""
    middles = (edges[:-1] + edges[1:]) / 2
    for shown, share in shares.items():
        if shown == "longer" or share["found"] == 0:
            continue
        near = numpy.flatnonzero(numpy.abs(middles - float(shown)) <= period / 2)
        if len(near):
            tallest = near[numpy.argmax(heights[near])]
            axes.annotate(percent(share).replace(" (", "\n("), (edges[tallest + 1], heights[tallest]), xytext=(3, 1),
                          textcoords="offset points", fontsize=6.8, linespacing=1.1)


def _count_whole(axes):
    """Formats an axis of whole messages."""
    axes.yaxis.set_major_locator(matplotlib.ticker.MaxNLocator(integer=True, min_n_ticks=1))
    axes.set_ylabel("messages")


def _shown(name):
    """Returns a robot's name for a legend, which omits labels that begin with an underscore."""
    short = name if len(name) <= MOST_OF_A_NAME else name[:MOST_OF_A_NAME - 1] + "…"
    return f" {short}" if short.startswith("_") else short


def _count_logarithmically(axes):
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    axes.set_ylim(0.6, max(20, axes.get_ylim()[1] * 2.2))


def _thesis_line(axes, x, text):
    axes.axvline(x, color=THESIS, linestyle="--", linewidth=1.1)
    axes.annotate(text, (x, 1), xycoords=("data", "axes fraction"), xytext=(-4, -2), textcoords="offset points", ha="right",
                  va="top", color=THESIS, fontsize=8)


def _latencies(result, events):
    """Returns ({quantity: values in ms}, place of measurement)."""
    robots = measure.robot_latencies_ms(events)
    if robots:
        return robots, "robot"
    return measure.gateway_latencies_ms(events, result["conditions"]["type"]), "gateway"


def _latency(axes, result, events):
    values, where = _latencies(result, events)
    if not values:
        return _nothing(axes)
    series = {_shown(robot): ones for robot, ones in values.items() if len(ones)}
    if len(series) > MOST_SERIES:
        series = {f"{len(series)} robots": measure.pooled(values)}
    what = "PUBLISH to PUBACK" if result["mesh"] == "thread" else "SET to STATUS"
    if len(values) == 1:
        series = {f"{what}, seen by the {where}": next(iter(series.values()))}
    gateway = measure.gateway_latencies_ms(events, result["conditions"]["type"])
    if where == "robot" and len(values) == 1 and gateway:
        series["of that in the gateway, with the broker"] = measure.pooled(gateway)
    whole = numpy.concatenate(list(series.values()))
    end = float(numpy.percentile(whole, 99.5)) * 1.15 + 1
    bin_ms = 1 if end < 150 else 5 if end < 750 else 50 if end < 50 * MOST_BINS else float(f"{end / MOST_BINS:.1g}")
    bins = numpy.arange(0, end + 2 * bin_ms, bin_ms)
    colours = [COLOURS.get(result["mesh"], GREY), SECOND, "#7b3294", "#636363"]
    _histogram(axes, list(series.values()), end, bins, colours, [f"{name}: {_mean_and_tail(ones)}" for name, ones in series.items()])
    for index, ones in enumerate(series.values()):
        axes.axvline(float(ones.mean()), ymax=0.82, color=colours[index % 4], linewidth=1.2, linestyle=(0, (4, 2)))
    axes.set_ylim(0, axes.get_ylim()[1] * (1.12 + 0.08 * len(series)))
    axes.legend(loc="upper right", fontsize=7.5)
    axes.set_xlabel(f"{what} / ms, in bins of {bin_ms:g} ms" + _compressed(result))
    _count_whole(axes)


def _hop_values(result, events):
    """Returns (values in ms, their meaning). Only probes show when a real robot first sent a message."""
    robots = measure.robot_latencies_ms(events)
    if robots:
        return measure.pooled(robots), "PUBLISH to PUBACK, seen by the robot"
    delays = measure.probe_delays_ms(events)
    if delays:
        return measure.pooled(delays), "arrival later than that of the fastest probe"
    return measure.pooled(measure.gateway_latencies_ms(events, result["conditions"]["type"])), "PUBLISH to PUBACK in the gateway"


def _hop_all(axes, result, events):
    values, what = _hop_values(result, events)
    if not len(values):
        return _nothing(axes)
    retry = 8000 / result["conditions"]["time_compressed"]
    end = max(2.4 * retry, values.max() + retry / 20)
    axes.hist(values, bins=numpy.arange(0, end, max(retry / 40, end / MOST_BINS)), color=COLOURS["thread"])
    _count_logarithmically(axes)
    axes.set_xlim(0, None)
    for times in (1, 2):
        axes.axvline(times * retry, color=THESIS, linestyle="--", linewidth=1)
        late = int(numpy.sum((values >= (times - 0.1) * retry) & (values < (times + 0.9) * retry)))
        axes.annotate(f"thesis: {8 * times} s\nhere: {late} of {len(values)}", (times * retry, 1), xycoords=("data", "axes fraction"),
                      xytext=(4, -2), textcoords="offset points", va="top", color=THESIS, fontsize=8)
    axes.set_title("8.10  all messages")
    axes.set_xlabel(f"{what} / ms" + _compressed(result))
    axes.set_ylabel("messages")


def _hop_first(axes, result, events):
    values, what = _hop_values(result, events)
    retry = 8000 / result["conditions"]["time_compressed"]
    first = values[values < 0.9 * retry] if len(values) else values
    if not len(first):
        return _nothing(axes)
    end = numpy.percentile(first, 99.5) * 1.1 + 1
    _histogram(axes, [first], end, numpy.linspace(0, end, 61), [COLOURS["thread"]])
    axes.axvline(first.mean(), color=SECOND, linewidth=1.2, label=_mean_and_tail(first))
    axes.set_ylim(0, axes.get_ylim()[1] * 1.18)
    axes.legend(loc="upper right", fontsize=8)
    axes.set_title("8.11  without those that the client repeated")
    axes.set_xlabel(f"{what} / ms" + _compressed(result))
    _count_whole(axes)


def _hop_repeats(axes, result, events):
    client, link = measure.repeats_by_message(events)
    if not client:
        axes.set_title("8.12  repeats for each message")
        return _nothing(axes)
    totals = collections.Counter(min(9, link.get(key, 0) + client[key]) for key in client)
    by_client = collections.Counter(min(9, link.get(key, 0) + client[key]) for key in client if client[key])
    numbers = numpy.arange(0, 10)
    of_link = "between two hops only (802.15.4)" if link else "none (those between two hops are not seen here)"
    axes.bar(numbers, [totals[n] for n in numbers], color=COLOURS["thread"], label=of_link)
    axes.bar(numbers, [by_client[n] for n in numbers], color=SECOND, label="also by the client (MQTT-SN)")
    axes.set_xticks(numbers, [*map(str, numbers[:-1]), "9 or more"])
    axes.legend(loc="upper right", fontsize=8)
    axes.set_title("8.12  repeats for each message")
    axes.set_xlabel("repeats on its way to the gateway")
    _count_whole(axes)


def _counts(axes, result, events):
    counts, loss = result["measured"]["counts"], result["measured"]["loss"]["exact"]
    at_broker = counts.get("received_at_broker", counts["published"] or counts["arrived"])
    doubled = counts.get("doubled_at_broker", counts.get("probes_doubled", 0))
    sent = loss["sent"] if loss else None
    bars = [("sent", sent), ("arrived at\nthe gateway", counts["arrived"]), ("received at\nthe broker", at_broker),
            ("lost", loss["lost"] if loss else None), ("received\ntwice", doubled)]
    bars = [(name, value) for name, value in bars if value is not None]
    colours = {"lost": THESIS, "received\ntwice": SECOND}
    drawn = axes.bar([name for name, _ in bars], [value for _, value in bars], width=0.6,
                     color=[colours.get(name, COLOURS.get(result["mesh"], GREY)) for name, _ in bars])
    axes.bar_label(drawn, fontsize=9, padding=2)
    axes.set_ylim(0, max(1, max(value for _, value in bars)) * 1.12)
    _count_whole(axes)


def _probe_delay(axes, result, events):
    delays = measure.pooled(measure.probe_delays_ms(events))
    if not len(delays):
        return _nothing(axes)
    end = float(numpy.percentile(delays, 99.5)) * 1.1 + 1
    _histogram(axes, [delays], end, numpy.linspace(0, end, 61), [COLOURS.get(result["mesh"], GREY)])
    axes.set_xlabel("later than the fastest probe / ms" + _compressed(result))
    _count_whole(axes)


def _ring(axes, result, events):
    positions, obstacles = measure.points(events)
    if not len(obstacles):
        return _nothing(axes)
    axes.scatter(obstacles[:, 0], obstacles[:, 1], s=7, color=COLOURS.get(result["mesh"], GREY), alpha=0.45, linewidths=0,
                 label=f"{len(obstacles)} obstacles", zorder=3)
    axes.plot(positions[:, 0], positions[:, 1], color=SECOND, linewidth=0.9, label="the robot's way", zorder=2)
    circle = result["measured"].get("ring")
    if circle:
        axes.add_patch(plt.Circle((circle["x_cm"], circle["y_cm"]), circle["radius_cm"], fill=False, color="black",
                                  linewidth=1.2, zorder=4))
        axes.plot([], [], color="black", linewidth=1.2,
                  label=f"fitted: radius {circle['radius_cm']:.1f} cm, {circle['rms_error_cm']:.1f} cm rms off")
    axes.add_patch(plt.Circle((0, 0), 80, fill=False, color=THESIS, linestyle="--", linewidth=1, zorder=4))
    axes.plot([], [], color=THESIS, linestyle="--", linewidth=1, label="thesis: radius 80 cm")
    axes.set_aspect("equal", adjustable="box")
    axes.grid(True, axis="both")
    axes.legend(loc="upper center", ncol=2, fontsize=8)
    axes.set_xlabel("x / cm")
    axes.set_ylabel("y / cm")
    reach = max(100, 1.1 * float(numpy.abs(obstacles).max()))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, 1.3 * reach)


def _compressed(result):
    factor = result["conditions"]["time_compressed"]
    return f" (time compressed {factor:g} times)" if factor != 1 else ""


# Caption

def caption(result):
    """Returns the thesis's result beside the measured one, and facts for reading the figure."""
    sentences = [f"Thesis, {result['thesis']['where']}: {result['thesis']['result']}.",
                 f"Here: {_here(result)}. In brackets: 95 % intervals, which take messages as independent of each other."]
    if result["simulated"]:
        how = result["conditions"].get("simulated_as", "")
        sentences.append(f"Simulated robots and radio, seed {result['conditions'].get('seed')}{f': {how}' if how else ''}.")
    if result["differs"]:
        sentences.append(f"Differs from the thesis's setting: {'; '.join(result['differs'])}.")
    sentences.append(f"Not told by the thesis: {result['thesis']['unknown']}. Chosen here: {result['thesis']['chosen']}.")
    if not result["complete"]:
        why = result.get("ended_early") or ("see below" if result["incidents"] else "the run was cut off")
        sentences.append(f"NOT COMPLETE: {why}.")
    for incident in [one for one in result["incidents"] if one["what"] != result.get("ended_early")][:2]:
        sentences.append(f"At {incident['t_us'] / 1e6:.0f} s: {incident['what']}.")
    return "\n".join(line for sentence in sentences for line in textwrap.wrap(sentence, CAPTION_CHARACTERS))


def _here(result):
    """Returns the measured result in the wording of the thesis."""
    measured = result["measured"]
    counts, loss = measured["counts"], measured["loss"]
    parts = [f"{counts['arrived']} arrived"]
    if loss["exact"]:
        parts.append(_lost(result))
    if loss["estimate"] and _kind(result) == "intervals" and measured["interval_ms"]:
        parts.append(_intervals_here(result))
    robot, gateway = measured["acknowledged_after_ms"]["robot"], measured["acknowledged_after_ms"]["gateway"]
    if (robot or gateway) and _kind(result) in ("latency", "hop", "limits"):
        one, where = (robot, "") if robot else (gateway, " in the gateway")
        parts.append(f"acknowledged after {with_interval(one['mean'], one['mean_95_percent'])}{where} on average, "
                     f"median {with_interval(one['p50'], one['p50_95_percent'])}{_compressed(result)}")
    if counts.get("doubled_at_broker") is not None:
        parts.append(f"{counts['received_at_broker']} received at the broker, {counts['doubled_at_broker']} of them twice")
    if measured.get("ring") and _kind(result) == "ring":
        parts.append(f"a circle of radius {measured['ring']['radius_cm']:.1f} cm")
    return "; ".join(parts)


def _lost(result):
    """Returns the loss on the way, always with the messages that did not leave the robot."""
    exact, never_left = result["measured"]["loss"]["exact"], result["measured"].get("never_left")
    text = f"{exact['lost']} of {exact['sent']} sent were lost, {percent(exact)}"
    if exact["doubled"]:
        text += f"; {exact['doubled']} arrivals were doubles"
    if never_left and never_left["found"]:
        text = f"{never_left['found']} of {never_left['of']} never left the robot, {percent(never_left)}; {text}"
    return text


def _intervals_here(result):
    """Returns the result in the thesis's quantity: the mean, the bins at 400 and 600 ms, or the loss by gaps."""
    measured, thesis, period = result["measured"], result["thesis"]["numbers"], result["conditions"]["period_ms"]
    gaps = measured["interval_ms"]
    if gaps["p50"] > 7 * period:
        return (f"{with_interval(gaps['mean'], gaps['mean_95_percent'])} apart on average, "
                f"{with_interval(gaps['p50'], gaps['p50_95_percent'])} at the median")
    estimate = f"{percent(measured['loss']['estimate'])} lost as estimated from gaps"
    if "two_or_three_periods" not in thesis:
        return estimate
    return f"{percent(measured['two_or_three_periods'])} at {2 * period:g} and {3 * period:g} ms, as the thesis read it; {estimate}"
