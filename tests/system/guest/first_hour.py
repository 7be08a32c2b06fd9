# SPDX-License-Identifier: Apache-2.0
"""The commands of docs/first-hour.md, taken from the page that is in the package, and an operator who types them."""
import functools
import re

from machine import demand, run, wait_for

OPERATOR = "pi"
# Parts of commands that need another computer, a clock server, a mirror of Debian's, or a border router.
NOT_HERE = ("raspberrypi.local", "git clone", "./dev ", "apt update", "timedatectl", "ot-ctl")


def make_operator():
    run("useradd", "-m", "-s", "/bin/bash", "-G", "sudo", OPERATOR)
    run("sh", "-c", f"echo '{OPERATOR} ALL=(ALL) NOPASSWD: ALL' >/etc/sudoers.d/{OPERATOR}")


@functools.cache
def page():
    return run("sh", "-c", "dpkg-deb --fsys-tarfile /job/input/debs/slam-gateway_*.deb"
                           " | tar -xO ./usr/share/doc/slam-gateway/first-hour.md")


def commands(section):
    """The lines of the section's blocks, with their comments."""
    text = page().split(f"{section}\n", 1)[1].split("\n#", 1)[0]
    lines = "".join(re.findall(r"```sh\n(.*?)```", text, re.DOTALL)).splitlines()
    found = [line for line in lines if not any(word in line for word in NOT_HERE)]
    demand(found, f"{section} has no commands")
    return found


def operator(command):
    """Runs each command in a login of its own, so that a new group is in force."""
    return ["runuser", "-l", OPERATOR, f"--session-command={command}"]


def type_in(line):
    """Types the command until its output contains the quotes of its comment; returns the output."""
    promised = re.findall(r'"([^"]+)"', line.partition(" # ")[2])

    def output():
        text = run(*operator(line))
        missing = [words for words in promised if words not in text]
        demand(not missing, f"{line}\nlacks {missing}:\n{text}")
        return text or "nothing"
    return wait_for(line, output)
