# SPDX-License-Identifier: Apache-2.0
"""A result folder: events.csv while it is written, result.json, and reading both back."""
import json
import os

from slamgw_experiment import events, measure

FORMAT = 1
EVENTS, RESULT = "events.csv", "result.json"


class BadFolder(Exception):
    """Tells in one line what is wrong with a folder, and what to do."""


class Recorder:
    """Writes events as they come, so that whatever ends the program leaves them."""

    def __init__(self, directory):
        self._file = open(os.path.join(directory, EVENTS), "w", newline="", encoding="utf-8")
        events.write_header(self._file)

    def write(self, event):
        events.write_row(self._file, event)

    def flush(self):
        self._file.flush()

    def close(self):
        self._file.close()


def make(path):
    """A new, or an empty, folder."""
    try:
        os.makedirs(path, exist_ok=True)
        if os.listdir(path):
            raise BadFolder(f"{path} is not empty; choose another with --out, results are never overwritten")
    except (FileExistsError, NotADirectoryError, PermissionError) as error:
        raise BadFolder(f"{path} cannot be used: {error.strerror}") from error
    return path


def write_result(directory, result):
    """In one step, so that a reader finds the old one or the new one."""
    path = os.path.join(directory, RESULT)
    with open(path + ".new", "w", encoding="utf-8") as file:
        json.dump(result, file, indent=2, allow_nan=False)
        file.write("\n")
    os.replace(path + ".new", path)


def read_result(directory):
    path = os.path.join(directory, RESULT)
    try:
        with open(path, encoding="utf-8") as file:
            result = json.load(file)
    except FileNotFoundError as error:
        raise BadFolder(f"{directory} has no {RESULT}: it is no result folder of this program") from error
    except (OSError, ValueError) as error:
        raise BadFolder(f"{path} cannot be read: {error}") from error
    if not isinstance(result, dict) or "format" not in result:
        raise BadFolder(f"{path} was not written by this program")
    if result["format"] != FORMAT:
        raise BadFolder(f"{path} has format {result['format']}, and this program reads {FORMAT}; it was written by "
                        f"{result.get('program', 'another version')}")
    return result


def read_events(directory):
    path = os.path.join(directory, EVENTS)
    try:
        return events.read_csv(path)
    except events.WrongColumns as error:
        raise BadFolder(str(error)) from error
    except FileNotFoundError as error:
        raise BadFolder(f"{directory} has no {EVENTS}") from error
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise BadFolder(f"{path} cannot be read: {error}") from error


def measure_again(directory):
    """(result, events), with `measured` counted anew from events.csv."""
    result = read_result(directory)
    ones = read_events(directory)
    try:
        message_type, period_ms = result["conditions"]["type"], float(result["conditions"]["period_ms"])
        settle_s = float(result["conditions"].get("settle_s", 0))
    except (KeyError, TypeError, ValueError) as error:
        raise BadFolder(f"{os.path.join(directory, RESULT)} lacks conditions.type or .period_ms") from error
    result["measured"] = measure.measured(ones, message_type, period_ms, settle_s)
    return result, ones
