# SPDX-License-Identifier: Apache-2.0
"""A private wall clock for the daemon, which can be moved while the daemon runs: moved_clock.c, preloaded. Used by World."""
import pathlib
import shutil
import struct
import subprocess

SOURCE = pathlib.Path(__file__).parent / "moved_clock.c"


class MovedClock:
    def __init__(self, directory):
        self.offset = directory / "clock"
        self.move(0)
        self.library = directory / "moved_clock.so"
        compiler = shutil.which("cc") or shutil.which("gcc")
        self.can_be_moved = compiler is not None and subprocess.run(
            [compiler, "-shared", "-fPIC", "-O1", "-o", self.library, SOURCE, "-ldl"], check=False).returncode == 0

    def move(self, seconds):
        """Sets the clock this many seconds off the real time."""
        with open(self.offset, "r+b" if self.offset.exists() else "wb") as file:
            file.write(struct.pack("q", round(seconds)))

    def prefix(self):
        """Returns the words to put before a command."""
        if not self.can_be_moved:
            return []
        return ["env", f"LD_PRELOAD={self.library}", f"MOVED_CLOCK={self.offset}"]
