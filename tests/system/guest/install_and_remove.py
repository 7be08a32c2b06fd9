# SPDX-License-Identifier: Apache-2.0
"""Steps: install, upgrade, removal and purge of the package, and the files that remain."""
import glob
import json
import pathlib
import pwd
import re

from actors import PASSWORDS, WRONG_PASSWORD, Listener, Robots, demand_nothing_lost
from hardware import PORT
from machine import (BOARD, CONFIG, CREDENTIALS, STATE, demand, install, run, service, status, wait_for,
                     wait_for_status)

secrets = [*PASSWORDS.values(), WRONG_PASSWORD]  # and the mesh's keys, once they are known
REPOSITORY = "/job/input/debs/repository"
RECEIVE_LIMIT = pathlib.Path("/proc/sys/net/core/rmem_max")


def mode_of(path):
    return run("stat", "-c", "%U %a", path)


def pretend_small_receive_limit():
    """Shows the kernel's default limit. The true one is the whole machine's, and read-only in a container."""
    limit = pathlib.Path("/run/rmem_max")
    limit.write_text("212992\n", encoding="ascii")
    run("mount", "--bind", limit, RECEIVE_LIMIT)


def install_from_repository():
    """Runs the commands of docs/manual.md, with a folder in place of a web server and without the page."""
    package = glob.glob("/job/input/debs/slam-gateway_*.deb")[0]
    page = run("sh", "-c", f"dpkg-deb --fsys-tarfile {package} | tar -xO ./usr/share/doc/slam-gateway/manual.md")
    lines = re.search(r"### A repository for apt\n.*?```sh\n(.*?)```", page, re.DOTALL)[1]
    for theirs, ours in {"wget -qO- https://apt.example.org": f"cat {REPOSITORY}", "https://apt.example.org": f"file:{REPOSITORY}",
                         "sudo ": "", "apt install slam-gateway slam-gateway-web": "apt install -y slam-gateway slam-gateway-sim"}.items():
        demand(theirs in lines, f"the page does not contain '{theirs}'")
        lines = lines.replace(theirs, ours)
    run("sh", "-ec", lines)


def runs_once_installed():
    """install from a repository: the service is active, ready, and reports its status; user, directories and limits are there"""
    run("systemctl", "stop", "mosquitto")
    pretend_small_receive_limit()
    install_from_repository()
    demand(service("ActiveState") == "active" and service("SubState") == "running", "the service is not active")
    demand(service("UnitFileState") == "enabled", "the service is not enabled")
    wait_for_status("broker down, thread up, 0 robots online")
    demand(mode_of(STATE) == "slam-gateway 700", f"{STATE}: {mode_of(STATE)}")
    demand(pwd.getpwnam("slam-gateway").pw_uid < 1000, "the user is not a system user")
    demand("rmem_max = 4194304" in run("systemd-analyze", "cat-config", "sysctl.d"), "the file in sysctl.d is not seen")
    demand(RECEIVE_LIMIT.read_text(encoding="ascii").strip() == "4194304", "net.core.rmem_max was not raised")
    return service("StatusText")


def is_confined():
    """confinement: systemd-analyze security reports 1.5 or less, and memory is limited"""
    demand(service("MemoryMax") == str(512 << 20), f"MemoryMax: {service('MemoryMax')}")
    verdict = run("systemd-analyze", "security", "--no-pager", "--threshold=15", "slam-gateway").splitlines()[-1]
    return re.sub(r"[^ -~]", "", verdict).strip()


def mesh_keys():
    keys = set()

    def collect(value, name=""):
        if isinstance(value, dict):
            for key, inner in value.items():
                collect(inner, key)
        elif isinstance(value, list):
            for inner in value:
                collect(inner, name)
        elif "key" in name and isinstance(value, str):
            keys.add(value)
    collect(json.loads((STATE / "mesh.json").read_text(encoding="utf-8")))
    return keys


def packages_to_upgrade_to():
    """Installs the last release and returns this version's packages; without a release, the same ones with a higher version."""
    last = glob.glob("/job/input/debs/last/slam-gateway_*.deb")
    if not last:
        return glob.glob("/job/input/debs/newer/slam-gateway_*.deb")
    run("systemctl", "stop", "slam-gateway")
    run("find", STATE, "-mindepth", 1, "-not", "-name", "mesh.json", "-delete")  # it cannot read newer files
    install("--allow-downgrades", *last)
    return glob.glob("/job/input/debs/slam-gateway_*.deb")


def upgrade_keeps_what_is_undelivered():
    """upgrade: messages stored before it arrive after it; sessions, the mesh and the configuration are kept"""
    packages = packages_to_upgrade_to()
    before = run("dpkg-query", "-W", "-f", "${Version}", "slam-gateway")
    board = None if PORT.exists() else Robots("ble", "--robots", 1, "--id-prefix", "ble")
    listener = Listener()
    robots = Robots("thread", "--robots", 2, "--id-prefix", "upgrade", "--qos", 2)
    wait_for_status("ble up")
    listener.wait_for({"ntnu-slam/robot/upgrade1/update": 5, "ntnu-slam/robot/upgrade2/update": 5})
    run("systemctl", "stop", "mosquitto")
    wait_for("stored messages", lambda: status()["store"]["depth"] > 20)
    keys, config = mesh_keys(), CONFIG.read_text(encoding="utf-8")
    demand(len(keys) >= 2, "mesh.json has no keys")
    secrets.extend(keys)
    process = service("MainPID")
    install(*packages)
    version = run("dpkg-query", "-W", "-f", "${Version}", "slam-gateway")
    demand(version == run("dpkg-deb", "-f", *packages, "Version") != before, f"version {version}")
    demand(service("MainPID") not in ("0", process), "the new version does not run")
    stored = status()["store"]["depth"]
    demand(stored > 20, f"{stored} messages are stored after the upgrade")
    demand({"messages", "sessions", "mesh.json"} <= {file.name for file in STATE.iterdir()}, "files are gone")
    demand(mesh_keys() >= keys, "the mesh has other keys")
    demand(CONFIG.read_text(encoding="utf-8") == config, "the operator's configuration was replaced")
    run("systemctl", "start", "mosquitto")
    wait_for_status("broker up")
    run("slam-gatewayctl", "send", "upgrade1", "cmd", "7,8")
    result = robots.end()
    demand(result["commands_received"] == 1, f"commands received: {result}")
    listener.wait_for({f"ntnu-slam/robot/{name}/update": tally["acknowledged"]
                       for name, tally in result["robots"].items()})
    wait_for("an empty store", lambda: status()["store"]["depth"] == 0)
    listener.end()
    if board:
        board.end()
    return f"{stored} messages stored at the upgrade from {before} to {version}"


def remove_keeps_the_state():
    """remove: the service is gone; state, configuration and credentials are kept"""
    run("apt-get", "-y", "-q", "remove", "slam-gateway")
    demand(service("ActiveState") == "inactive", "the service still runs")
    demand("47193" not in run("ss", "-lun"), "the port is still taken")
    for path in (STATE / "mesh.json", STATE / "sessions", CONFIG, CREDENTIALS):
        demand(path.exists(), f"{path} is gone")


def purge_removes_everything():
    """purge: only the user is left"""
    has_page = pathlib.Path("/usr/bin/slam-gateway-web").exists()
    site = CONFIG.parent / "gateway.d/site.json"
    site.parent.mkdir(exist_ok=True)  # dpkg removes it when it is empty
    site.write_text("{}\n", encoding="utf-8")
    run("dpkg", "--purge", "slam-gateway")
    demand(site.exists() == has_page, "gateway.d is kept for slam-gateway-web alone")
    run("dpkg", "--purge", "slam-gateway-web")
    for path in (STATE, CONFIG.parent, "/run/slam-gateway", "/usr/share/doc/slam-gateway",
                 "/usr/lib/sysctl.d/60-slam-gateway.conf", "/usr/lib/credstore/slam-gateway.broker"):
        demand(not pathlib.Path(path).exists(), f"{path} is left")
    left = run("systemctl", "list-units", "--all", "--no-legend", "--plain", "slam-gateway*")
    demand(not left, f"left with systemd: {left}")


def no_secret_is_in_the_journal():
    """secrets: no password and no key of the mesh was ever written to the journal"""
    run("journalctl", "--sync")
    everything = run("journalctl", "--no-pager", "-a", "-o", "export").lower()
    demand("slam-gatewayd" in everything, "the journal is empty")
    demand(len(secrets) > 4, "the mesh's keys are not known")
    demand(not [secret for secret in secrets if secret.lower() in everything], "a secret is in the journal")
    return f"{len(secrets)} secrets looked for in {len(everything) // 1024} KiB"
