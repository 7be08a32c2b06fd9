# SPDX-License-Identifier: Apache-2.0
"""Two results, or both meshes, on one self-contained HTML page; and the numbers of two results as a text table."""
import base64
import html
import os

from slamgw_experiment import catalogue, figures, folder

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

# The rows of every comparison: name, and where it stands in `measured`.
ROWS = [
    ("made by the robot", ("counts", "measured"), "{:.0f}"),
    ("sent", ("loss", "exact", "sent"), "{:.0f}"),
    ("arrived", ("counts", "arrived"), "{:.0f}"),
    ("lost, exactly", ("loss", "exact", "share"), "{:.2%}"),
    ("lost, estimated from gaps", ("loss", "estimate", "share"), "{:.2%}"),
    ("interval, median / ms", ("interval_ms", "p50"), "{:.1f}"),
    ("interval, 99 % / ms", ("interval_ms", "p99"), "{:.1f}"),
    ("acknowledged, mean / ms", ("acknowledged_after_ms", "robot", "mean"), "{:.1f}"),
    ("acknowledged, 99 % / ms", ("acknowledged_after_ms", "robot", "p99"), "{:.1f}"),
    ("in the gateway, mean / ms", ("acknowledged_after_ms", "gateway", "mean"), "{:.1f}"),
    ("probe later than fastest, 99 % / ms", ("probe_delay_ms", "p99"), "{:.1f}"),
    ("radius of the ring / cm", ("ring", "radius_cm"), "{:.1f}"),
]


def read(directory):
    """The result with `measured` counted anew from its events."""
    return folder.measure_again(directory)[0]


def value_of(result, path):
    value = (result or {}).get("measured") or {}
    for step in path:
        value = value.get(step) if isinstance(value, dict) else None
    return value if isinstance(value, (int, float)) else None


def rows_of(results):
    """[(name, [texts])] with what at least one of the results has."""
    rows = []
    for name, path, form in ROWS:
        values = [value_of(result, path) for result in results]
        if any(value is not None for value in values):
            rows.append((name, ["" if value is None else form.format(value) for value in values]))
    return rows


def name_of(result):
    return f"{result['experiment']} on {figures.MESH_NAMES.get(result['mesh'], result['mesh'])}"


def table(results):
    """For a terminal."""
    rows = rows_of(results)
    heads = [name_of(result) for result in results]
    first = max([len(name) for name, _ in rows] + [0])
    widths = [max([len(head)] + [len(texts[i]) for _, texts in rows]) for i, head in enumerate(heads)]
    lines = [" " * first + "".join(f"  {head:>{width}}" for head, width in zip(heads, widths))]
    lines += [f"{name:{first}}" + "".join(f"  {text:>{width}}" for text, width in zip(texts, widths)) for name, texts in rows]
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
    """The thesis's conclusion, remade: BLE beside Thread, with all results of a folder."""
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
            "numbers follow from the events.csv of each folder.")
    _write(out, _page("Two meshes, one set of experiments", note, sections, any(one["simulated"] for _, one in found.values())))


def _conclusion(found):
    """One table over everything, and what two robots cost."""
    results = [result for _, result in found.values()]
    extra = ""
    one, two = (found.get(name) for name in ("ble-latency", "ble-two-robots"))
    means = [value_of(side[1], ("acknowledged_after_ms", "robot", "mean")) if side else None for side in (one, two)]
    if None not in means:
        extra = (f"<p>With two robots on BLE Mesh a STATUS took {means[1] - means[0]:+.1f} ms on average against one robot; "
                 "the thesis saw an indication of +10 ms.</p>")
    heads = ["experiment", "made by the robot", "sent", "arrived", "lost, exactly", "lost, estimated", "acknowledged, mean / ms", "99 % / ms"]
    paths = [("counts", "measured"), ("loss", "exact", "sent"), ("counts", "arrived"), ("loss", "exact", "share"), ("loss", "estimate", "share"),
             ("acknowledged_after_ms", "robot", "mean"), ("acknowledged_after_ms", "robot", "p99")]
    forms = ["{:.0f}", "{:.0f}", "{:.0f}", "{:.2%}", "{:.2%}", "{:.1f}", "{:.1f}"]
    lines = []
    for result in results:
        values = [value_of(result, path) for path in paths]
        texts = [name_of(result)] + ["" if value is None else form.format(value) for value, form in zip(values, forms)]
        lines.append("<tr>" + "".join(f"<td>{html.escape(text)}</td>" for text in texts) + "</tr>")
    head = "".join(f"<th>{html.escape(text)}</th>" for text in heads)
    return f"<h2>All in one table</h2><table><tr>{head}</tr>{''.join(lines)}</table>{extra}"
