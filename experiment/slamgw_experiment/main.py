# SPDX-License-Identifier: Apache-2.0
"""The command line of slam-gateway-experiment."""
import argparse
import dataclasses
import datetime
import os
import shlex
import signal
import sys

from slamgw_experiment import catalogue, figures, folder, page, series
from slamgw_experiment.programs import Missing, Programs
from slamgw_experiment.run import SETTLE_S, Run
from slamgw_experiment.sites import DEFAULT_PREFIX, DEFAULT_SOCKET, RunningDaemon, SimulatedSite

WRONG_ARGUMENTS = 2
OF_SIMULATOR = {"seed": 1, "compress": 1, "sim_args": []}  # options that are for --sim only, and their defaults
COMPARED = "compare.html"
MOST_SIMULATED = 1000  # robots; slam-gateway-sim accepts fewer on a BLE mesh


@dataclasses.dataclass
class Asked:
    """The arguments that one run needs."""
    messages: int
    period_ms: float
    message_type: str
    seed: int
    wait_s: float
    compress: float
    format: str
    version: str
    sim_args: str = ""
    settle_s: float = 0.0  # real robots: how long their last messages may still come


class Stop:
    """Ctrl-C, SIGTERM and a closed terminal end a run with its folder; the second signal ends it where it is."""

    def __init__(self):
        self.asked = False
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._on_signal)

    def _on_signal(self, *_):
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True

    def __call__(self):
        return self.asked


def positive(kind):
    def read(text):
        value = kind(text)
        if not 0 < value < 1e9:
            raise argparse.ArgumentTypeError(f"{text} is not above 0 and below 1e9")
        return value
    read.__name__ = kind.__name__
    return read


def seed(text):
    value = int(text)
    if not 0 <= value < 2 ** 64:
        raise argparse.ArgumentTypeError(f"{text} is not 0 to 18446744073709551615")
    return value


def robot_ids(text):
    ids = list(dict.fromkeys(one.strip() for one in text.split(",") if one.strip()))
    if not ids:
        raise argparse.ArgumentTypeError("no robot is named; slam-gatewayctl robots lists them")
    return ids


def host_and_port(text):
    host, colon, port = text.rpartition(":")
    host = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    if not (host and colon and port.isdecimal() and 0 < int(port) < 65536):
        raise argparse.ArgumentTypeError(f"{text} is not HOST:PORT, as in 127.0.0.1:1883 or [::1]:1883")
    return host, port


def options(text):
    try:
        return shlex.split(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} cannot be split into options: {error}") from error


def parser(version):
    whole = argparse.ArgumentParser(prog="slam-gateway-experiment",
                                    description="Measures a mesh as the thesis did, draws its figures, compares runs.")
    whole.add_argument("--version", action="version", version=f"slam-gateway-experiment {version}")
    verbs = whole.add_subparsers(dest="verb", required=True, metavar="list|run|plot|compare")
    verbs.add_parser("list", help="the experiments, and what each showed in the thesis")
    run = verbs.add_parser("run", help="measure; leaves a folder with events.csv, result.json, figure.svg and figure.png")
    run.add_argument("name", metavar="NAME", help="an experiment, or all")
    run.add_argument("--robots", type=robot_ids, metavar="ID,...",
                     help="real robots that the running daemon hears; with --sim how many (default: as in the thesis)")
    run.add_argument("--sim", action="store_true", help="simulated robots, with a broker and a daemon of their own")
    run.add_argument("--seed", type=seed, help="of the simulator (default: 1)")
    run.add_argument("--repeat", type=positive(int), default=1, metavar="N", help="N runs, with --sim from seed to seed, and their spread")
    run.add_argument("--messages", type=positive(int), help="of each robot (default: as in the thesis, else 1000)")
    run.add_argument("--period-ms", type=positive(float), help="between two messages of a robot (default: 200)")
    run.add_argument("--out", metavar="DIR", help="a new folder (default: NAME and the time)")
    run.add_argument("--format", choices=["csv", "mcap"], default="csv", help="mcap: events.mcap besides events.csv")
    run.add_argument("--mesh", choices=["ble", "thread", "both"], help="for all, ring, probe and limits")
    run.add_argument("--probe", action="store_true", help="probes in place of updates: exact loss")
    run.add_argument("--type", dest="message_type", metavar="TYPE", help="the message type to measure (default: update, or probe)")
    run.add_argument("--wait-s", type=positive(float), default=60, help="for the first message (default: 60)")
    run.add_argument("--compress", type=positive(float),
                     help="Thread with --sim: period and repeats so many times shorter (default: 1)")
    run.add_argument("--sim-args", type=options, metavar="TEXT", help="with --sim: more options for slam-gateway-sim")
    run.add_argument("--socket", default=DEFAULT_SOCKET, metavar="PATH", help=f"of the daemon (default: {DEFAULT_SOCKET})")
    run.add_argument("--broker", type=host_and_port, metavar="HOST:PORT",
                     help="with --robots: also count what a subscriber at this broker gets")
    run.add_argument("--topic-prefix", default=DEFAULT_PREFIX, metavar="TOPIC",
                     help=f"with --broker: topics.prefix of the daemon (default: {DEFAULT_PREFIX})")
    plot = verbs.add_parser("plot", help="count and draw again from events.csv")
    plot.add_argument("directory", metavar="DIR")
    compare = verbs.add_parser("compare", help="two results, or two folders of results, on one page")
    compare.add_argument("directories", metavar="DIR", nargs=2)
    compare.add_argument("--out", metavar="FILE", default=COMPARED, help=f"the page (default: {COMPARED}); of limits a folder")
    return whole


def with_joined_options(arguments):
    """Joins `--sim-args --mirrored` to one argument, because argparse takes an argument that begins with - as its own option."""
    words = list(arguments)
    if "--sim-args" in words[:-1]:
        at = words.index("--sim-args")
        words[at:at + 2] = ["=".join(words[at:at + 2])]
    return words


def main(version, bin_directory=None, arguments=None):
    try:
        asked = parser(version).parse_args(with_joined_options(sys.argv[1:] if arguments is None else arguments))
        status = perform(asked, version, bin_directory)
        sys.stdout.flush()
        return status
    except (folder.BadFolder, Missing) as error:
        complaint = str(error)
    except BrokenPipeError:  # the reader of standard output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        complaint = f"{error.filename or 'a file'}: {error.strerror or error}"
    except KeyboardInterrupt:
        complaint = "interrupted"
    print(f"slam-gateway-experiment: {complaint}", file=sys.stderr)
    return 1


def perform(asked, version, bin_directory):
    if asked.verb == "list":
        return list_experiments()
    if asked.verb == "plot":
        return plot_series(asked.directory) if series.kind_of(asked.directory) else plot(asked.directory)
    if asked.verb == "compare" and [series.kind_of(one) for one in asked.directories] == [series.LIMITS] * 2:
        out = "compare" if asked.out == COMPARED else asked.out
        print(series.compare_limits(asked.directories, out))
        print(f"\n{os.path.join(out, 'figure.svg')}")
        return 0
    if asked.verb == "compare":
        return compare(asked.directories, asked.out)
    return run(asked, version, Programs(bin_directory))


def list_experiments():
    for one in catalogue.EXPERIMENTS:
        meshes = " or ".join(figures.MESH_NAMES[mesh] for mesh in one.meshes)
        print(f"{one.name:17} {one.where():17} {meshes:18} {one.title}")
        print(f"{'':17} {one.messages} messages each {one.period_ms:g} ms; thesis: {one.thesis}")
    return 0


def plot(directory):
    result, events = folder.measure_again(directory)
    folder.write_result(directory, result)
    figures.draw(directory, result, events)
    print(os.path.join(directory, "figure.svg"))
    return 0


def plot_series(directory):
    print(series.draw(directory))
    print(os.path.join(directory, "figure.svg"))
    return 0


def compare(directories, out):
    print(page.compare(directories, out))
    print(f"\n{out}")
    return 0


def chosen_runs(asked):
    """Returns [(experiment, mesh)], or a text with the fault."""
    wanted = {"ble": ["ble"], "thread": ["thread"], "both": ["ble", "thread"]}
    if asked.name == "all":
        meshes = wanted[asked.mesh or "both"]
        return [(one, mesh) for one in catalogue.EXPERIMENTS if one.kind != "limits" for mesh in one.meshes if mesh in meshes]
    experiment = catalogue.find(asked.name)
    if not experiment:
        return f"there is no experiment {asked.name}; there are {', '.join(one.name for one in catalogue.EXPERIMENTS)}, and all"
    if asked.mesh is None:
        return [(experiment, experiment.meshes[0])]
    meshes = [mesh for mesh in wanted[asked.mesh] if mesh in experiment.meshes]
    if asked.mesh != "both" and not meshes or asked.mesh == "both" and len(meshes) < 2:
        return f"{experiment.name} is measured on {figures.MESH_NAMES[experiment.meshes[0]]} only"
    return [(experiment, mesh) for mesh in meshes]


def wrong_robots(asked, runs):
    """Returns the fault of --robots or --sim, if any."""
    text = ",".join(asked.robots or [])
    if not asked.sim and not text:
        return "one of --robots ID,... and --sim is required"
    if asked.sim and text and (not text.isdecimal() or not 1 <= int(text) <= MOST_SIMULATED):
        return f"--robots {text}: with --sim this is a number, 1 to {MOST_SIMULATED}"
    if asked.sim and text and runs[0][0].kind == "limits":
        return "limits chooses by itself how many robots it simulates: leave --robots out"
    if asked.sim and asked.broker:
        return "--sim starts a broker of its own and counts there: leave --broker out"
    return None


def run(asked, version, programs):
    runs = chosen_runs(asked)
    wrong = runs if isinstance(runs, str) else wrong_robots(asked, runs)
    if wrong:
        print(f"slam-gateway-experiment: {wrong}", file=sys.stderr)
        return WRONG_ARGUMENTS
    given = [name for name in OF_SIMULATOR if getattr(asked, name) is not None]
    if given and not asked.sim:
        print(f"slam-gateway-experiment: only with --sim: --{', --'.join(given).replace('_', '-')}", file=sys.stderr)
        return WRONG_ARGUMENTS
    asked = changed(asked, **{name: value for name, value in OF_SIMULATOR.items() if name not in given})
    if asked.repeat > 1 and (len(runs) > 1 or runs[0][0].kind == "limits"):
        print("slam-gateway-experiment: --repeat repeats one experiment on one mesh, and not limits", file=sys.stderr)
        return WRONG_ARGUMENTS
    stop = Stop()
    now = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    out = folder.make(asked.out) if asked.out else folder.make_new(f"{asked.name}-{now}")
    if asked.repeat > 1:
        return run_repeated(asked, *runs[0], out, version, programs, stop)
    if runs[0][0].kind == "limits":
        return run_limits(asked, runs, out, version, programs, stop)
    if len(runs) == 1:
        return run_one(asked, *runs[0], out, version, programs, stop)
    statuses = []
    for number, (experiment, mesh) in enumerate(runs, 1):
        if stop():
            break
        print(f"{number} of {len(runs)}: {experiment.name} on {figures.MESH_NAMES[mesh]}", file=sys.stderr)
        name = experiment.name if len(experiment.meshes) == 1 else f"{experiment.name}-{mesh}"
        statuses.append(run_one(asked, experiment, mesh, folder.make(os.path.join(out, name)), version, programs, stop))
    index = os.path.join(out, "index.html")
    page.write_both(index, out)
    print(index)
    return max(statuses + [1 if stop() else 0])


def changed(asked, **members):
    return argparse.Namespace(**vars(asked) | members)


def run_repeated(asked, experiment, mesh, out, version, programs, stop):
    series.write(out, series.REPEATED)
    statuses = []
    for number in range(asked.repeat):
        if stop():
            break
        print(f"{number + 1} of {asked.repeat}", file=sys.stderr)
        name = f"seed-{asked.seed + number}" if asked.sim else f"run-{number + 1}"
        one = changed(asked, seed=asked.seed + number)
        statuses.append(run_one(one, experiment, mesh, folder.make(os.path.join(out, name)), version, programs, stop))
    return max([plot_series(out), 1 if stop() else 0, *statuses])


def run_limits(asked, runs, out, version, programs, stop):
    """Runs the sweeps of both meshes. Real robots give one run, because the program cannot change their number or rate."""
    series.write(out, series.LIMITS)
    statuses = []
    for experiment, mesh in runs:
        messages, period_ms = asked.messages or experiment.messages, asked.period_ms or experiment.period_ms
        sweeps = series.settings_of_limits(period_ms, messages, mesh) if asked.sim else [[(mesh, len(asked.robots), period_ms, messages)]]
        for sweep in sweeps:
            for name, robots, period_ms, messages in sweep:
                if stop():
                    break
                print(name, file=sys.stderr)
                inner = folder.make(os.path.join(out, name))
                one = changed(asked, messages=messages, period_ms=period_ms)
                statuses.append(run_one(one, dataclasses.replace(experiment, robots=robots), mesh, inner, version, programs, stop))
                if series.is_broken(folder.read_result(inner)):
                    break
    return max([plot_series(out), 1 if stop() else 0, *statuses])


def run_one(asked, experiment, mesh, out, version, programs, stop):
    payload = "probe" if asked.probe else experiment.payload
    message_type = asked.message_type or ("probe" if payload == "probe" else "update")
    # The clients' repeats can be made shorter on Thread; BLE Mesh's times are fixed in its stack.
    compress = asked.compress if asked.sim and mesh == catalogue.THREAD else 1
    messages = asked.messages or experiment.messages
    if asked.name == "all":
        messages = min(messages, experiment.messages)
    request = Asked(messages, asked.period_ms or experiment.period_ms, message_type, asked.seed, asked.wait_s, compress,
                    asked.format, version, shlex.join(asked.sim_args), SETTLE_S[mesh])
    if asked.sim:
        site = simulated_site(asked, experiment, mesh, payload, request, programs, stop)
    else:
        site = RunningDaemon(programs, asked.socket, asked.robots, asked.broker, asked.topic_prefix)
    status = Run(experiment, mesh, site, out, request, programs, stop).measure()
    print(os.path.join(out, "figure.svg"))
    return status


def simulated_site(asked, experiment, mesh, payload, request, programs, stop):
    period_ms = request.period_ms / request.compress
    arguments = ["--payload", payload, "--seed", str(request.seed), "--messages", str(request.messages), "--rate",
                 f"{1000 / period_ms:.6f}"]
    if mesh == catalogue.THREAD:
        arguments += ["--retry", f"{8 / request.compress:.6f}"]
    robots = int(asked.robots[0]) if asked.robots else experiment.robots
    return SimulatedSite(programs, mesh, robots, [*arguments, *catalogue.simulator_options(experiment, mesh, asked.sim_args)],
                         experiment.daemon, request.message_type, stop)
