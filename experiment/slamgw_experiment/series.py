# SPDX-License-Identifier: Apache-2.0
"""Runs that belong together: one experiment repeated, or robots and rate swept until a mesh breaks.

A folder of them has series.json, and a result folder for each run. All numbers come from those.
"""
import collections
import json
import os
import textwrap

import numpy

from slamgw_experiment import figures, folder, measure, page
plt = figures.plt  # with its backend chosen

SERIES = "series.json"
REPEATED, LIMITS = "repeated", "limits"

# What is swept: robots at the usual period, then the rate of a few robots. Each stops at the first run that breaks.
ROBOTS = (1, 2, 4, 8, 16, 32, 64)
FASTER, FASTER_ROBOTS = (2, 4, 8, 16), 4
BROKEN = 0.25  # of the updates; chosen, for the thesis names no number
# A frame of 76 octets, back-off and acknowledgement take 4.5 ms of Thread's one channel; PUBLISH and PUBACK are two.
THREAD_CHANNEL_PER_S = 1000 / (2 * 4.5)

# Quantiles of Student's distribution at 97.5 %, by degrees of freedom from 1 on.
STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110,
           2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042)


def write(directory, kind):
    with open(os.path.join(directory, SERIES), "w", encoding="utf-8") as file:
        json.dump({"format": folder.FORMAT, "series": kind}, file)
        file.write("\n")


def kind_of(directory):
    """REPEATED, LIMITS, or None for a folder of another kind."""
    try:
        with open(os.path.join(directory, SERIES), encoding="utf-8") as file:
            kind = json.load(file)["series"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise folder.BadFolder(f"{os.path.join(directory, SERIES)} cannot be read: {error}") from error
    return kind if kind in (REPEATED, LIMITS) else None


def results_in(directory):
    return [result for _, result in page.results_in(directory).values()]


def draw(directory):
    """figure.svg and figure.png of the folder; returns the numbers as a text."""
    results = results_in(directory)
    arrived = [result for result in results if result["measured"]["counts"]["arrived"]]
    if not arrived:
        raise folder.BadFolder(f"no message arrived in any run of {directory}")
    with plt.rc_context(figures.STYLE):
        figure, text = draw_repeated(arrived) if kind_of(directory) == REPEATED else draw_limits(results)
        figures.save(figure, directory, any(result["simulated"] for result in results))
    return text


def _whole(title, panels, caption, is_simulated):
    """(figure, axes): panels below each other, with title and caption like the figure of one run."""
    lines = [line for sentence in caption for line in textwrap.wrap(sentence, figures.CAPTION_CHARACTERS)]
    caption_in = figures.LINE_IN * (len(lines) + 1)
    figure = plt.figure(figsize=(figures.WIDTH_IN, 0.6 + 2.3 * panels + caption_in))
    whole_in = figure.get_figheight()
    grid = figure.add_gridspec(panels, 1, left=0.12, right=0.97, top=1 - 0.62 / whole_in, bottom=(caption_in + 0.45) / whole_in,
                               hspace=0.5)
    figure.text(0.02, 1 - 0.1 / whole_in, title, fontsize=11, fontweight="bold", va="top")
    if is_simulated:
        figures.mark_as_simulated(figure, whole_in)
    figure.text(0.02, 0.06 / whole_in, "\n".join(lines), fontsize=7.8, va="bottom", linespacing=1.35)
    return figure, [figure.add_subplot(grid[row]) for row in range(panels)]


# One experiment repeated

def _of_share(*path):
    def take(result):
        share = page.member(result, *path)
        if not share or share["share"] is None:
            return None
        return 100 * share["share"], [100 * end for end in share["share_95_percent"]]
    return take


def _of_mean(*path):
    def take(result):
        found = page.member(result, *path)
        return (found["mean"], found["mean_95_percent"]) if found else None
    return take


def _of_radius(result):
    radius = page.member(result, "ring", "radius_cm")
    return None if radius is None else (radius, None)


def _not_arrived(result):
    return _of_share("not_arrived")(result) or _of_share("loss", "exact")(result)


# Quantities to show: name, value of a run with its interval, the thesis's numbers, and their factor.
QUANTITIES = [
    ("made and not arrived / %", _not_arrived, None, 100),
    ("gaps of 2 or 3 periods / %", _of_share("two_or_three_periods"), "two_or_three_periods", 100),
    ("lost as estimated from gaps / %", _of_share("loss", "estimate"), "loss_estimate", 100),
    ("between arrivals, mean / ms", _of_mean("interval_ms"), "interval_ms", 1),
    ("acknowledged, mean / ms", _of_mean("acknowledged_after_ms", "robot"), None, 1),
    ("radius / cm", _of_radius, "radius_cm", 1),
]


def _quantities(results):
    """[(name, [(value, interval) of each run], the thesis's)] that fit the experiment."""
    thesis = results[0]["thesis"]["numbers"]
    chosen = []
    for name, take, key, factor in QUANTITIES:
        values = [take(result) for result in results]
        is_compared = key is None or key in thesis
        if is_compared and None not in values:
            told = numpy.atleast_1d(thesis[key]) * factor if key in thesis else []
            chosen.append((name, values, list(told)))
    return chosen


def over_runs(values):
    """Returns (mean, 95 % interval of the mean by Student's distribution; None for one run)."""
    mean = float(numpy.mean(values))
    if len(values) < 2:
        return mean, None
    half = STUDENT[min(len(values) - 1, len(STUDENT)) - 1] * float(numpy.std(values, ddof=1)) / len(values) ** 0.5
    return mean, [mean - half, mean + half]


def _name_of_run(result):
    return f"seed {result['conditions']['seed']}" if result["simulated"] else result["conditions"]["begun"][11:19]


def draw_repeated(results):
    first = results[0]
    quantities = _quantities(results)
    names = [_name_of_run(result) for result in results]
    caption = [f"Thesis, {first['thesis']['where']}: {first['thesis']['result']}.",
               f"{len(results)} runs of {first['conditions']['messages']} messages of each robot. Bars: the 95 % interval within a run. "
               "Line and band: mean of the runs and its 95 % interval (Student). Dashed, where there is one: the thesis's number."]
    caption += [f"NOT COMPLETE: {name}." for name, result in zip(names, results) if not result["complete"]]
    figure, axes = _whole(figures.title(first), len(quantities), caption, first["simulated"])
    heads = ["", "mean", "95 % interval", "least", "most", "thesis"]
    rows = []
    for panel, (name, runs, told) in zip(axes, quantities):
        values = [value for value, _ in runs]
        mean, interval = over_runs(values)
        _draw_runs(panel, first["mesh"], runs, mean, interval)
        for number in told:
            panel.axhline(number, color=figures.THESIS, linestyle="--", linewidth=1)
        panel.set_title(name)
        panel.set_xticks(range(len(names)), names, fontsize=8, rotation=0 if len(names) < 9 else 90)
        panel.set_ylim(bottom=0)
        rows.append([name, f"{mean:.1f}", f"{max(0, interval[0]):.1f} to {interval[1]:.1f}" if interval else "", f"{min(values):.1f}",
                     f"{max(values):.1f}", " to ".join(f"{number:g}" for number in told)])
    return figure, page.text_table(f"{page.name_of(first)}, {len(results)} runs", heads, rows)


def _draw_runs(panel, mesh, runs, mean, interval):
    for place, (value, within) in enumerate(runs):
        bar = [[max(0, value - within[0])], [max(0, within[1] - value)]] if within else None
        panel.errorbar(place, value, bar, fmt="o", color=figures.COLOURS.get(mesh, figures.GREY), capsize=3, markersize=4)
    panel.axhline(mean, color=figures.SECOND, linewidth=1.2)
    if interval:
        panel.axhspan(max(0, interval[0]), interval[1], color=figures.SECOND, alpha=0.18, linewidth=0)


# Robots and rate, swept until a mesh breaks

def load_of(result):
    """Returns updates a second of all robots."""
    return len(result["conditions"]["robots"]) * 1000 / result["conditions"]["period_ms"]


def is_broken(result):
    measured = result["measured"]
    shares = [measured.get("not_arrived"), measured.get("late")]
    return not measured["counts"]["arrived"] or any(share and share["share"] > BROKEN for share in shares)


def _sweep_of(result):
    """Returns the result's line in the figure: a mesh, simulated or real, with more robots or with faster ones."""
    is_faster = result["conditions"]["period_ms"] < result["thesis"].get("period_ms", 200) * 0.99
    return result["mesh"], result["simulated"], is_faster


PANELS = [
    ("updates that were made and did not arrive / %", _not_arrived),
    ("acknowledged after the next update was due, or never / %", _of_share("late")),
    ("acknowledged after, mean of those that were / ms", _of_mean("acknowledged_after_ms", "robot")),
]


def draw_limits(results):
    lines = collections.defaultdict(list)
    for result in sorted(results, key=load_of):
        lines[_sweep_of(result)].append(result)
    # The line of faster robots begins at the point of the other line with the same number of robots.
    for (mesh, is_simulated, is_faster), line in lines.items():
        if is_faster:
            robots = len(line[0]["conditions"]["robots"])
            line[:0] = [one for one in lines.get((mesh, is_simulated, False), []) if len(one["conditions"]["robots"]) == robots]
    figure, axes = _whole("Section 9.3  Robots and rate, until it breaks", len(PANELS), _limits_caption(results, lines),
                          any(result["simulated"] for result in results))
    for panel, (name, take) in zip(axes, PANELS):
        for sweep, line in lines.items():
            _draw_line(panel, sweep, [(load_of(result), *take(result)) for result in line if take(result)])
        panel.set_title(name)
        panel.set_xscale("log")
        panel.set_xlim(3, 1.3 * max(THREAD_CHANNEL_PER_S, *map(load_of, results)))
        ticks = [load for load in (5, 10, 20, 40, 80, 160, 320, 640) if load <= panel.get_xlim()[1]]
        panel.set_xticks(ticks, map(str, ticks))
        panel.xaxis.set_minor_locator(plt.NullLocator())
        panel.axvline(THREAD_CHANNEL_PER_S, color=figures.COLOURS["thread"], linestyle=":", linewidth=1)
        panel.set_ylim(bottom=0)
    for panel in axes[:2]:
        panel.axhline(100 * BROKEN, color=figures.GREY, linestyle="--", linewidth=0.9)
    axes[0].fill_between([4.7, 5.3], 8, 10, color=figures.THESIS, linewidth=0, label="thesis 8.3: BLE Mesh, 8-10 % of the gaps")
    axes[0].errorbar(5, 0, [[0], [100 * measure.wilson(0, 1000)[1]]], fmt="s", color=figures.THESIS, markersize=4, capsize=3,
                     label="thesis 8.13: Thread, 0 of 1000")
    axes[0].set_ylim(0, axes[0].get_ylim()[1] * 1.55)
    axes[0].legend(fontsize=7.5, loc="upper left", ncol=2)
    axes[-1].set_xlabel("updates a second that all robots together make")
    return figure, _limits_table(lines)


def _draw_line(panel, sweep, points):
    mesh, is_simulated, is_faster = sweep
    if not points:
        return
    loads, values = [point[0] for point in points], [point[1] for point in points]
    bars = [[max(0, value - within[0]) if within else 0 for _, value, within in points],
            [max(0, within[1] - value) if within else 0 for _, value, within in points]]
    label = f"{figures.MESH_NAMES[mesh]}, {'simulated' if is_simulated else 'real robots'}, {'faster' if is_faster else 'more'} robots"
    panel.errorbar(loads, values, bars, color=figures.COLOURS[mesh], marker=("o" if is_simulated else "D"), markersize=4, capsize=2.5,
                   linewidth=1.2, linestyle="--" if is_faster else "-", markerfacecolor="white" if is_faster else None, label=label)


def _limits_caption(results, lines):
    caption = [f"Thesis, 9.3: {results[0]['thesis']['result']}.",
               f"Solid: more robots with an update each {results[0]['thesis'].get('period_ms', 200):g} ms. Open: {FASTER_ROBOTS} robots, faster. "
               f"Bars: 95 % intervals. Grey: broken ({100 * BROKEN:.0f} % of the updates; chosen, for the thesis names no number)."]
    for sweep, line in lines.items():
        broken = next((result for result in line if is_broken(result)), None)
        name = f"{figures.MESH_NAMES[sweep[0]]}, {'faster' if sweep[2] else 'more'} robots{'' if sweep[1] else ' (real)'}"
        caption.append(f"{name}: " + (f"broken at {_setting(broken)}." if broken else f"not broken up to {_setting(line[-1])}."))
    if any(result["simulated"] for result in results):
        caption.append("The simulated robots do not disturb each other on the air; what queues are the packets of each node. A real channel "
                       f"breaks earlier. At high loads this computer's own speed counts. Dotted: where Thread's channel would be full, {THREAD_CHANNEL_PER_S:.0f} a second by computation.")
    caption += [f"NOT COMPLETE: {_setting(result)}." for result in results if not result["complete"]]
    return caption


def _setting(result):
    conditions = result["conditions"]
    return f"{load_of(result):g} updates a second ({len(conditions['robots'])} robots, each {conditions['period_ms']:g} ms)"


def _limits_table(lines):
    heads = ["", "robots", "period / ms", "a second", "not arrived", "late or never", "acknowledged, mean"]
    rows = []
    for (mesh, is_simulated, is_faster), line in lines.items():
        for result in line:
            acknowledged = page.member(result, "acknowledged_after_ms", "robot")
            rows.append([f"{figures.MESH_NAMES[mesh]}{'' if is_simulated else ', real'}{', faster' if is_faster else ''}",
                         str(len(result["conditions"]["robots"])), f"{result['conditions']['period_ms']:g}", f"{load_of(result):g}",
                         figures.percent(page.member(result, "not_arrived") or page.member(result, "loss", "exact")),
                         figures.percent(page.member(result, "late")),
                         figures.with_interval(acknowledged["mean"], acknowledged["mean_95_percent"]) if acknowledged else ""])
    return page.text_table("Robots and rate, until it breaks", heads, rows)


def compare_limits(directories, out):
    """Draws series of simulated and of real robots on one axis, in a new folder `out`. Returns the table."""
    results = [result for directory in directories for result in results_in(directory)]
    folder.make(out)
    with plt.rc_context(figures.STYLE):
        figure, text = draw_limits(results)
        figures.save(figure, out, any(result["simulated"] for result in results))
    return text


def settings_of_limits(asked_period_ms, messages, mesh):
    """Returns two sweeps [[(name of the folder, robots, period in ms, messages)]], all runs of equal length."""
    def setting(robots, period_ms):
        return f"{mesh}-{robots}-robots-{period_ms:g}-ms", robots, period_ms, max(1, round(messages * asked_period_ms / period_ms))
    return [[setting(robots, asked_period_ms) for robots in ROBOTS],
            [setting(FASTER_ROBOTS, asked_period_ms / factor) for factor in FASTER]]
