#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""cable.py A B: carries octets between two ttys, and opens them again when one of them hangs up and returns."""
import os
import select
import sys
import termios
import time
import tty


def open_tty(path):
    while True:
        try:
            end = os.open(path, os.O_RDWR | os.O_NOCTTY)
            tty.setraw(end)
            return end
        except (OSError, termios.error):
            time.sleep(0.05)


def carry(first, second):
    """Carries octets until one end hangs up. While one end does not read, both wait, as behind a real port."""
    other = {first: second, second: first}
    while True:
        for end in select.select([first, second], [], [])[0]:
            octets = os.read(end, 512)
            if not octets:
                return
            while octets:
                octets = octets[os.write(other[end], octets):]


while True:
    ends = [open_tty(path) for path in sys.argv[1:3]]
    try:
        carry(*ends)
    except OSError:
        pass
    for one in ends:
        os.close(one)
    time.sleep(0.05)
