# SPDX-License-Identifier: Apache-2.0
"""Two results, or both meshes, on one self-contained HTML page; and the numbers of two results as a text table."""
import base64
import html
import os

from slamgw_experiment import catalogue, figures, folder, measure

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1300px; padding: 0 1rem; color: #222; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid #ccc; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 1.2rem; align-items: start; }
figure { margin: 0; } img { width: 100%; } figcaption, .none, p.note { color: #666; font-size: .85rem; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; width: 100%; font-size: .85rem; }
th, td { border-bottom: 1px solid #ddd; padding: .25rem .6rem; text-align: right; } th:first-child, td:first-child { text-align: left; }
.simulated { background: #b2182b; color: white; border-radius: 4px; padding: .15rem .5rem; font-size: .8rem; font-weight: bold; }
@media (max-width: 800px) { .pair { grid-template-columns: 1fr; } }
@media print { .pair { break-inside: avoid; } }
"""

def member(result, *path):
    value = result["measured"] or {}
    for step in path:
        value = value.get(step) if isinstance(value, dict) else None
    return value


def _number(*path, form="{:.0f}"):
    def text(result):
        value = member(result, *path)
        return "" if value is None else form.format(value)
    return text


def _share(*path):
    return lambda result: figures.percent(member(result, *path))


def _time(name, *path):
    """Returns a function that shows a statistic: `mean` and `p50` with their interval, no percentile of too few values."""
    def text(result):
        found = member(result, *path)
        if found is None:
            return ""
        if found[name] is None:
            return f"too few: {found['count']}"
        return figures.with_interval(found[name], found.get(f"{name}_95_percent"))
    return text


def _part(found, of, path, what):
    """"5 of 60 made: 8.3 % (...)": never a share without what it is of."""
    def text(result):
        share = member(result, *path)
        return f"{share[found]} of {share[of]} {what}: {figures.percent(share)}" if share else ""
    return text


# The rows of every comparison: name, whether it is a time, and its text.
ROWS = [
    ("made by the robot", False, _number("counts", "measured")),
    ("sent", False, _number("loss", "exact", "sent")),
    ("arrived", False, _number("counts", "arrived")),
    ("never left the robot", False, _part("found", "of", ("never_left",), "made")),
    ("lost on the way, exactly", False, _part("lost", "sent", ("loss", "exact"), "sent")),
    ("made and not arrived", False, _share("not_arrived")),
    ("lost, estimated from gaps", False, _share("loss", "estimate")),
    ("interval, median", True, _time("p50", "interval_ms")),
    ("interval, 99 % within", True, _time("p99", "interval_ms")),
    ("acknowledged, mean", True, _time("mean", "acknowledged_after_ms", "robot")),
    ("acknowledged, 99 % within", True, _time("p99", "acknowledged_after_ms", "robot")),
    ("in the gateway, mean", True, _time("mean", "acknowledged_after_ms", "gateway")),
    ("probe later than fastest, 99 % within", True, _time("p99", "probe_delay_ms")),
    ("radius of the ring / cm", False, _number("ring", "radius_cm", form="{:.1f}")),
]


def read(directory):
    """Returns the result with `measured` counted again from its events."""
    return folder.measure_again(directory)[0]


def compression(result):
    return result["conditions"]["time_compressed"]


def rows_of(results):
    """Returns [(name, [texts])] of rows that at least one result has. Never mixes compressed and real times."""
    has_one_clock = len({compression(result) for result in results}) == 1
    rows = []
    for name, is_time, text_of in ROWS:
        texts = [text_of(result) for result in results]
        if any(texts) and (has_one_clock or not is_time):
            rows.append((name, texts))
    if not has_one_clock:
        rows.append(("times", [f"not compared: {_clock(result)}" for result in results]))
    return rows


def _clock(result):
    return "real time" if compression(result) == 1 else f"compressed {compression(result):g} times"


def name_of(result):
    return f"{result['experiment']} on {figures.MESH_NAMES.get(result['mesh'], result['mesh'])}"


def table(results):
    """Returns the table for a terminal."""
    return text_table("", ["", *map(name_of, results)], [[name, *texts] for name, texts in rows_of(results)])


def text_table(title, heads, rows):
    widths = [max(len(row[i]) for row in [heads, *rows]) for i in range(len(heads))]
    lines = [title] if title else []
    for row in [heads, *rows]:
        lines.append(f"{row[0]:{widths[0]}}" + "".join(f"  {text:>{width}}" for text, width in zip(row[1:], widths[1:])))
    return "\n".join(lines)


def _html_table(results, heads):
    def cells(texts, tag):
        return "".join(f"<{tag}>{html.escape(text)}</{tag}>" for text in texts)
    body = "".join(f"<tr>{cells([name, *texts], 'td')}</tr>" for name, texts in rows_of(results))
    return f"<table><tr>{cells(['', *heads], 'th')}</tr>{body}</table>"


def _figure(directory, result):
    if result is None:
        return '<p class="none">The other folder has no such result.</p>'
    path = os.path.join(directory, "figure.svg")
    try:
        with open(path, "rb") as file:
            picture = base64.b64encode(file.read()).decode()
    except OSError:
        return f'<p class="none">{html.escape(path)} is missing: slam-gateway-experiment plot {html.escape(directory)}</p>'
    alt = html.escape(f"{name_of(result)}: thesis, {result['thesis']['where']}: {result['thesis']['result']}")
    return f'<figure><img alt="{alt}" src="data:image/svg+xml;base64,{picture}"></figure>'


def _page(title, note, sections, is_simulated):
    mark = ' <span class="simulated">SIMULATED</span>' if is_simulated else ""
    return (f'<!DOCTYPE html>\n<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
            f"<title>{html.escape(title)}</title><style>{STYLE}</style>\n<h1>{html.escape(title)}{mark}</h1>"
            f'<p class="note">{html.escape(note)}</p>\n' + "\n".join(sections) + "\n</html>\n")


def _write(path, text):
    try:
        with open(path, "w", encoding="utf-8", errors="replace") as file:
            file.write(text)
    except OSError as error:
        raise folder.BadFolder(f"{path} cannot be written: {error.strerror}") from error


def results_in(directory):
    """{name: (directory, result)} of a folder of results; a result folder itself is its only one."""
    if os.path.exists(os.path.join(directory, folder.RESULT)):
        result = read(directory)
        return {result["experiment"]: (directory, result)}
    found = {}
    names = sorted(os.listdir(directory)) if os.path.isdir(directory) else []
    for name in names:
        inner = os.path.join(directory, name)
        if os.path.exists(os.path.join(inner, folder.RESULT)):
            found[name] = inner, read(inner)
    if not found:
        raise folder.BadFolder(f"{directory} has no {folder.RESULT} and no folder that has one")
    return found


def compare(directories, out):
    """Writes the page; returns the text tables."""
    left, right = (results_in(directory) for directory in directories)
    labels = [os.path.basename(os.path.abspath(directory)) for directory in directories]
    labels = labels if labels[0] != labels[1] else directories
    if len(left) == 1 and len(right) == 1:
        pairs = [(next(iter(left)), next(iter(left.values())), next(iter(right.values())))]
    else:
        pairs = [(name, left.get(name), right.get(name)) for name in sorted(left.keys() | right.keys())]
    texts, sections, is_simulated = [], [], False
    for name, *sides in pairs:
        results = [side[1] for side in sides if side]
        heads = [f"{name_of(side[1])} ({label})" for side, label in zip(sides, labels) if side]
        is_simulated = is_simulated or any(result["simulated"] for result in results)
        texts.append(table(results))
        inner = "".join(f"<div>{_figure(*side)}</div>" if side else f"<div>{_figure('', None)}</div>" for side in sides)
        sections.append(f'<h2>{html.escape(name)}</h2><div class="pair">{inner}</div>{_html_table(results, heads)}')
    _write(out, _page(f"{labels[0]} and {labels[1]}", "Numbers are counted anew from both folders' events.csv.", sections,
                      is_simulated))
    return "\n\n".join(texts)


def write_both(out, directory):
    """Repeats the thesis's conclusion: BLE beside Thread, with all results of a folder."""
    found = results_in(directory)
    sections, placed = [], set()
    for question, *names in catalogue.PAIRS:
        sides = [found.get(name) if name else None for name in names]
        if not any(sides):
            continue
        placed.update(name for name in names if name in found)
        results = [side[1] for side in sides if side]
        inner = "".join(f"<div>{_figure(*side)}</div>" if side else "<div></div>" for side in sides)
        heading = f"<h2>{html.escape(question)}</h2>" if question else ""
        sections.append(f'{heading}<div class="pair">{inner}</div>{_html_table(results, [name_of(one) for one in results])}')
    for name in sorted(found.keys() - placed):
        sections.append(f'<h2>{html.escape(name)}</h2><div class="pair"><div>{_figure(*found[name])}</div></div>')
    sections.insert(0, _conclusion(found))
    note = ("Left BLE Mesh, right Thread. Each figure has the thesis's result and what was measured here in its caption; "
            "numbers follow from the events.csv of each folder. In brackets: 95 % intervals, which take messages as independent.")
    _write(out, _page("Two meshes, one set of experiments", note, sections, any(one["simulated"] for _, one in found.values())))


def _conclusion(found):
    """Returns a table of all results for each clock, and the cost of two robots."""
    results = [result for _, result in found.values()]
    wanted = ["arrived", "never left the robot", "lost on the way, exactly", "made and not arrived", "lost, estimated from gaps",
              "acknowledged, mean", "acknowledged, 99 % within"]
    columns = [next(row for row in ROWS if row[0] == name) for name in wanted]
    head = "".join(f"<th>{html.escape(text)}</th>" for text in ["experiment", *wanted])
    tables = ""
    for clock in sorted({compression(result) for result in results}):
        lines = []
        for result in (one for one in results if compression(one) == clock):
            texts = [name_of(result)] + [text_of(result) for _, _, text_of in columns]
            lines.append("<tr>" + "".join(f"<td>{html.escape(text)}</td>" for text in texts) + "</tr>")
        heading = "In real time" if clock == 1 else f"Time compressed {clock:g} times: these times are none of a real mesh"
        tables += f"<h2>{heading}</h2><table><tr>{head}</tr>{''.join(lines)}</table>"
    return tables + _cost_of_a_second_robot(found)


def _cost_of_a_second_robot(found):
    means = []
    for name in ("ble-two-robots", "ble-latency"):
        if name not in found:
            return ""
        means.append(measure.pooled(measure.robot_latencies_ms(folder.read_events(found[name][0]))))
    if not all(len(values) for values in means):
        return ""
    more, interval = measure.difference_of_means(*means)
    between = f" ({interval[0]:+.1f} to {interval[1]:+.1f})" if interval else ""
    return (f"<p>With two robots on BLE Mesh a STATUS took {more:+.1f} ms{between} on average against one robot; "
            "the thesis saw an indication of +10 ms.</p>")
