# SPDX-License-Identifier: Apache-2.0
"""Finds, starts and ends other programs, and reads their versions and lines without waiting."""
import os
import queue
import shutil
import signal
import subprocess
import threading
import time


class Missing(Exception):
    """A program that is needed is not installed."""


class Programs:
    """Finds programs beside this one (a build tree), else as a shell does, else where Debian puts a broker."""

    def __init__(self, directory=None):
        self._directory = directory

    def find(self, name):
        places = [self._directory] if self._directory else []
        path = os.pathsep.join(places + [os.environ.get("PATH", os.defpath), "/usr/sbin", "/usr/local/sbin"])
        found = shutil.which(name, path=path)
        if not found:
            raise Missing(f"{name} is not installed, or not found: {WHERE_FROM.get(name, 'it is part of slam-gateway')}")
        return found

    def version(self, name, option="--version"):
        try:
            said = subprocess.run([self.find(name), option], capture_output=True, text=True, timeout=10, check=False)
        except (OSError, subprocess.SubprocessError, Missing):
            return None
        first = (said.stdout or said.stderr).strip().splitlines()
        return first[0] if first else None


WHERE_FROM = {
    "mosquitto": "install the Debian package mosquitto",
    "mosquitto_sub": "install the Debian package mosquitto-clients",
    "slam-gatewayctl": "install the Debian package slam-gateway",
    "slam-gatewayd": "install the Debian package slam-gateway",
    "slam-gateway-sim": "install the Debian package slam-gateway-sim",
}


# Ends a child with this program, also when this program is killed; part of util-linux.
WITH_PARENT = ("setpriv", "--pdeathsig", "TERM", "--")
NO_REASON = "Run with --help"  # last line of a program that refuses its arguments


class Child:
    """A process in a session of its own, so that Ctrl-C ends this program first; its output goes to `log`.

    To be made in the main thread: the kernel ends the child together with the thread that made it.
    """

    def __init__(self, arguments, log, stdout=None):
        self.name = os.path.basename(arguments[0])
        self.log_path = log
        with open(log, "ab") as file:
            self.process = subprocess.Popen([*WITH_PARENT, *arguments], stdin=subprocess.DEVNULL, stdout=stdout or file, stderr=file,
                                            start_new_session=True)

    def has_ended(self):
        return self.process.poll() is not None

    def last_words(self):
        try:
            with open(self.log_path, encoding="utf-8", errors="replace") as file:
                lines = [line for line in file.read().splitlines() if line.strip() and not line.startswith(NO_REASON)]
        except OSError:
            return ""
        return lines[-1].strip() if lines else ""

    def end(self, patience_s=5):
        if self.has_ended():
            return self.process.returncode
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


class Lines:
    """Reads lines in a thread of its own and puts (source, text, when) into a queue; `when` comes from `now_us`."""

    def __init__(self, source, lines, now_us):
        self.source = source
        self._queue = lines
        self._now_us = now_us
        self.has_ended = False

    def start(self, read):
        self._thread = threading.Thread(target=self._run, args=(read,), daemon=True)
        self._thread.start()
        return self

    def _run(self, read):
        try:
            for line in read():
                self._queue.put((self.source, line, self._now_us()))
        finally:
            self.has_ended = True


def lines_of_pipe(pipe):
    def read():
        for line in pipe:
            yield line.decode("utf-8", "replace")
    return read


def lines_of_growing_file(path, is_over):
    """Whole lines of a file that another program appends to, until `is_over()` and nothing is left."""
    def read():
        while not os.path.exists(path):
            if is_over():
                return
            time.sleep(0.02)
        with open(path, encoding="utf-8", errors="replace") as file:
            rest = ""
            while True:
                was_over = is_over()
                text = file.read()
                if text:
                    rest += text
                    *whole, rest = rest.split("\n")
                    yield from whole
                elif was_over:
                    return
                else:
                    time.sleep(0.02)
    return read


def new_queue():
    return queue.Queue()
