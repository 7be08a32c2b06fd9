# SPDX-License-Identifier: Apache-2.0
"""Actions of steps in the booted guest: commands, the service, its journal. Used by the files of steps."""
import contextlib
import json
import pathlib
import subprocess
import time

CONFIG = pathlib.Path("/etc/slam-gateway/gateway.json")
CREDENTIALS = pathlib.Path("/etc/slam-gateway/credentials.json")
STATE = pathlib.Path("/var/lib/slam-gateway")
BOARD = "/dev/simulated/board"  # where the service sees it; a restart removes /run/slam-gateway
SLOWER = 1 if pathlib.Path("/run/systemd/container").exists() else 5  # factor: a virtual machine may be emulated
PATIENCE_S = 60 * SLOWER  # only a failure takes this long
GATEWAY = "guest"  # the default gateway.id: the host name


class Failure(Exception):
    pass


def demand(is_right, complaint):
    if not is_right:
        raise Failure(complaint)


def run(*arguments, status=0):
    """Returns the command's output; status None accepts any exit status."""
    done = subprocess.run([str(word) for word in arguments], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, check=False)
    demand(status in (None, done.returncode),
           f"{' '.join(map(str, arguments))}: status {done.returncode}\n{done.stdout[-2000:]}")
    return done.stdout.strip()


def wait_for(what, condition):
    """Waits until the condition is true; returns its result."""
    end = time.monotonic() + PATIENCE_S
    while True:
        with contextlib.suppress(Failure):
            if result := condition():
                return result
        demand(time.monotonic() < end, f"{what}: not within {PATIENCE_S} s; the service reports: {service('StatusText')}")
        time.sleep(0.1)


def service(what):
    """Returns a property of the service from systemd."""
    return run("systemctl", "show", "-P", what, "slam-gateway")


def wait_for_status(text):
    wait_for(f"'{text}' in the service's status", lambda: text in service("StatusText"))


def restart():
    run("systemctl", "restart", "slam-gateway")
    demand(service("ActiveState") == "active", "the service is not active after a restart")


def status():
    """Returns the daemon's status."""
    return json.loads(run("slam-gatewayctl", "--json", "status"))


def journal(*matches):
    """Returns the service's matching entries as dictionaries of fields."""
    run("journalctl", "--sync")
    lines = run("journalctl", "-q", "--no-pager", "-u", "slam-gateway", "-o", "json", *matches)
    return [json.loads(line) for line in lines.splitlines()]


def now():
    """Returns a match for `journal(*since)`: later entries only. (journalctl 252 omits the first match after a cursor.)"""
    return ("--since", f"@{time.time():.6f}")


def logged(word, *matches):
    """Returns the first message with that word among the matching entries."""
    return next((entry["MESSAGE"] for entry in journal(*matches) if word in str(entry.get("MESSAGE"))), None)


def install(*packages):
    # Keeps the configuration that an operator has changed, without asking.
    run("apt-get", "-y", "-q", "-o", "Dpkg::Options::=--force-confold", "install", *packages)


def write_config(**changes):
    """Writes a configuration with both meshes, names for the BLE robots, and these changes."""
    config = {
        "ble_mesh": {"enabled": True, "device": BOARD},
        "robots": [{"id": f"ble{n + 1}", "ble_address": f"0x{0x100 + n:04x}"} for n in range(3)],
    }
    CONFIG.write_text("// of this site\n" + json.dumps(config | changes, indent=2) + "\n", encoding="utf-8")


def write_credentials(password):
    CREDENTIALS.touch(mode=0o600)
    CREDENTIALS.write_text(json.dumps({"username": "slam-gateway", "password": password}), encoding="utf-8")
