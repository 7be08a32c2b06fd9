# SPDX-License-Identifier: Apache-2.0
"""A wall clock of the daemon's own, which can be moved while it runs: moved_clock.c, preloaded. Used by World."""
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
        """So far from the real time, from now on."""
        with open(self.offset, "r+b" if self.offset.exists() else "wb") as file:
            file.write(struct.pack("q", round(seconds)))

    def prefix(self):
        """In front of a command."""
        if not self.can_be_moved:
            return []
        return ["env", f"LD_PRELOAD={self.library}", f"MOVED_CLOCK={self.offset}"]
