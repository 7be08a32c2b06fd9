# SPDX-License-Identifier: Apache-2.0
"""Writes events.csv and result.json of a result folder, and reads both back."""
import contextlib
import csv
import json
import os

from slamgw_experiment import catalogue, events, measure

FORMAT = 1
EVENTS, RESULT = "events.csv", "result.json"


class BadFolder(Exception):
    """Names in one line the fault of a folder and the remedy."""


class CannotWrite(Exception):
    """The disk is full, or fails."""


class Recorder:
    """Writes each event at once, so that events survive any end of the program. A second recorder in the same folder fails."""

    def __init__(self, directory):
        self._path = os.path.join(directory, EVENTS)
        try:
            self._file = open(self._path, "x", newline="", encoding="utf-8", errors="backslashreplace")
            events.write_header(self._file)
            self._file.flush()
        except FileExistsError as error:
            raise BadFolder(f"{self._path} is there already: another run writes to this folder; choose another with --out") from error
        except OSError as error:
            raise BadFolder(f"{self._path} cannot be written: {error.strerror}") from error

    def write(self, event):
        self._attempt(lambda: events.write_row(self._file, event))

    def flush(self):
        self._attempt(self._file.flush)

    def _attempt(self, write):
        try:
            write()
        except OSError as error:
            raise CannotWrite(f"{self._path} cannot be written: {error.strerror}") from error

    def close(self):
        try:
            self._file.close()
        except OSError:
            pass  # the same failure again: unwritten lines are still in the buffer


def make(path):
    """Makes the folder; accepts an empty one."""
    try:
        os.makedirs(path, exist_ok=True)
        if os.listdir(path):
            raise BadFolder(f"{path} is not empty; choose another with --out, results are never overwritten")
    except OSError as error:
        raise BadFolder(f"{path} cannot be used: {error.strerror}") from error
    return path


def make_new(path):
    """Makes a new folder of this name, or `path-2`, `path-3`, ... if it exists."""
    number = 1
    while True:
        chosen = path if number == 1 else f"{path}-{number}"
        try:
            os.mkdir(chosen)
            return chosen
        except FileExistsError:
            number += 1
        except OSError as error:
            raise BadFolder(f"{chosen} cannot be made: {error.strerror}; name another place with --out") from error


def write_result(directory, result):
    """Replaces the file in one step, so that a reader finds the old one or the new one."""
    path = os.path.join(directory, RESULT)
    try:
        with open(path + ".new", "w", encoding="utf-8") as file:
            json.dump(result, file, indent=2, allow_nan=False)
            file.write("\n")
        os.replace(path + ".new", path)
    except OSError as error:
        with contextlib.suppress(OSError):
            os.unlink(path + ".new")
        raise BadFolder(f"{path} cannot be written: {error.strerror}; {EVENTS} has what came so far, and plot counts and draws "
                        "it once there is room") from error


def read_result(directory):
    path = os.path.join(directory, RESULT)
    try:
        with open(path, encoding="utf-8") as file:
            result = json.load(file)
    except FileNotFoundError as error:
        raise BadFolder(f"{directory} has no {RESULT}: it is no result folder of this program") from error
    except (OSError, ValueError, RecursionError) as error:
        raise BadFolder(f"{path} cannot be read: {error}") from error
    if not isinstance(result, dict) or "format" not in result:
        raise BadFolder(f"{path} was not written by this program")
    if result["format"] != FORMAT:
        raise BadFolder(f"{path} has format {result['format']}, and this program reads {FORMAT}; it was written by "
                        f"{result.get('program', 'another version')}")
    check_members(path, result)
    return result


# Members of result.json that figures and pages need besides `measured`, which is counted again. A type, or a tuple of types.
NUMBER = (int, float)
MEMBERS = {
    "experiment": str, "title": str, "mesh": str, "complete": bool, "simulated": bool, "incidents": list, "differs": list,
    "conditions": dict, "conditions.type": str, "conditions.period_ms": NUMBER, "conditions.time_compressed": NUMBER,
    "conditions.messages": NUMBER, "conditions.robots": list, "conditions.begun": str,
    "thesis": dict, "thesis.where": str, "thesis.result": str, "thesis.unknown": str, "thesis.chosen": str, "thesis.numbers": dict,
}


def check_members(path, result):
    """Raises BadFolder for a result that lacks a member, or has one of another type."""
    def bad(name):
        raise BadFolder(f"{path}: {name} is missing, or not what this program writes there")

    for name, kind in MEMBERS.items():
        value = result
        for step in name.split("."):
            value = value.get(step)
        if not isinstance(value, kind) or kind is NUMBER and not 0 < value < 1e12:
            bad(name)
    if result["mesh"] not in (catalogue.BLE, catalogue.THREAD):
        bad("mesh")
    if result["simulated"] and not isinstance(result["conditions"].get("seed"), int):
        bad("conditions.seed")
    settle_s = result["conditions"].get("settle_s", 0)
    if not isinstance(settle_s, NUMBER) or not 0 <= settle_s < 1e6:
        bad("conditions.settle_s")
    end_us = result["conditions"].get("end_us") or 0
    if not isinstance(end_us, NUMBER) or not abs(end_us) < 1e15:
        bad("conditions.end_us")
    if not all(isinstance(text, str) for text in result["differs"]):
        bad("differs")
    for one in result["incidents"]:
        if not isinstance(one, dict) or not isinstance(one.get("t_us"), NUMBER) or not isinstance(one.get("what"), str):
            bad("incidents")
    if not all(isinstance(value, (*NUMBER, list)) for value in result["thesis"]["numbers"].values()):
        bad("thesis.numbers")


def read_events(directory):
    path = os.path.join(directory, EVENTS)
    try:
        return events.read_csv(path)
    except events.WrongColumns as error:
        raise BadFolder(str(error)) from error
    except FileNotFoundError as error:
        raise BadFolder(f"{directory} has no {EVENTS}") from error
    except (OSError, UnicodeDecodeError, ValueError, csv.Error) as error:
        raise BadFolder(f"{path} cannot be read: {error}") from error


def measure_again(directory):
    """Returns (result, counted events), with `measured` and restarts of robots counted again from events.csv."""
    result = read_result(directory)
    conditions, experiment = result["conditions"], catalogue.find(result["experiment"])
    kind, period_ms = conditions["type"], float(conditions["period_ms"])
    ones = read_events(directory)
    end_us = conditions.get("end_us")
    if end_us is None:  # the program was killed, or is older
        end_us = (ones[-1].t_us if ones else 0) - float(conditions.get("settle_s", 0)) * 1e6
    ones = measure.counted(ones, kind, conditions["messages"], period_ms, end_us)
    result["measured"] = measure.measured(ones, kind, period_ms,
                                          experiment is not None and experiment.is_in_ring())
    result["incidents"] += [one for one in measure.restarts_of_robots(ones) if one not in result["incidents"]]
    result["complete"] = result["complete"] and not measure.restarts_of_robots(ones)
    return result, ones
