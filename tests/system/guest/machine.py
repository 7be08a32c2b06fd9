# SPDX-License-Identifier: Apache-2.0
"""What a step does with the booted guest: commands, the service, its journal. Used by the files of steps."""
import contextlib
import json
import pathlib
import subprocess
import time

CONFIG = pathlib.Path("/etc/slam-gateway/gateway.json")
CREDENTIALS = pathlib.Path("/etc/slam-gateway/credentials.json")
STATE = pathlib.Path("/var/lib/slam-gateway")
BOARD = "/dev/simulated/board"  # where the service sees it; /run/slam-gateway goes with each restart
SLOWER = 1 if pathlib.Path("/run/systemd/container").exists() else 5  # times: a virtual machine may be emulated
PATIENCE_S = 60 * SLOWER  # nothing here is measured by the clock: only a failure uses this up
GATEWAY = "guest"  # the default gateway.id: the host name


class Failure(Exception):
    pass


def demand(is_right, complaint):
    if not is_right:
        raise Failure(complaint)


def run(*arguments, status=0):
    """The command's output; status None accepts any end."""
    done = subprocess.run([str(word) for word in arguments], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, check=False)
    demand(status in (None, done.returncode),
           f"{' '.join(map(str, arguments))}: status {done.returncode}\n{done.stdout[-2000:]}")
    return done.stdout.strip()


def wait_for(what, condition):
    """What the condition returns as soon as that is true."""
    end = time.monotonic() + PATIENCE_S
    while True:
        with contextlib.suppress(Failure):
            if result := condition():
                return result
        demand(time.monotonic() < end, f"{what}: not within {PATIENCE_S} s; the service says: {service('StatusText')}")
        time.sleep(0.1)


def service(what):
    """A property of the service, as systemd shows it."""
    return run("systemctl", "show", "-P", what, "slam-gateway")


def wait_for_status(text):
    wait_for(f"the service's status says '{text}'", lambda: text in service("StatusText"))


def restart():
    run("systemctl", "restart", "slam-gateway")
    demand(service("ActiveState") == "active", "the service is not active after a restart")


def status():
    """The daemon's own account of itself."""
    return json.loads(run("slam-gatewayctl", "--json", "status"))


def journal(*matches):
    """The service's entries that match, as dictionaries of fields."""
    run("journalctl", "--sync")
    lines = run("journalctl", "-q", "--no-pager", "-u", "slam-gateway", "-o", "json", *matches)
    return [json.loads(line) for line in lines.splitlines()]


def now():
    """For `journal(*since)`: only what comes later. (journalctl 252 leaves out the first match after a cursor.)"""
    return ("--since", f"@{time.time():.6f}")


def says(word, *matches):
    """The message with that word, among the entries that match."""
    return next((entry["MESSAGE"] for entry in journal(*matches) if word in str(entry.get("MESSAGE"))), None)


def install(*packages):
    # The configuration that an operator has changed stays without a question.
    run("apt-get", "-y", "-q", "-o", "Dpkg::Options::=--force-confold", "install", *packages)


def write_config(**changes):
    """Both meshes, names for the BLE robots, and what else is given."""
    config = {
        "ble_mesh": {"enabled": True, "device": BOARD},
        "robots": [{"id": f"ble{n + 1}", "ble_address": f"0x{0x100 + n:04x}"} for n in range(3)],
    }
    CONFIG.write_text("// of this site\n" + json.dumps(config | changes, indent=2) + "\n", encoding="utf-8")


def write_credentials(password):
    CREDENTIALS.touch(mode=0o600)
    CREDENTIALS.write_text(json.dumps({"username": "slam-gateway", "password": password}), encoding="utf-8")
