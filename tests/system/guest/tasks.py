# SPDX-License-Identifier: Apache-2.0
"""Steps: an operator's everyday tasks and mistakes, each as described in docs/tasks.md."""
import contextlib
import json
import os
import pathlib
import signal
import socket
import subprocess
import tempfile

from actors import ACL, PASSWORDS, Listener, Robots, as_server, demand_nothing_lost, retained
from machine import (CONFIG, CREDENTIALS, GATEWAY, STATE, demand, logged, now, restart, run, service, status,
                     wait_for, wait_for_status, write_credentials)
from trouble import DROP_IN

SITE = CONFIG.parent / "gateway.d/site.json"
BACKUP = pathlib.Path("/root/gateway.tar.gz")


def site(**keys):
    SITE.write_text(json.dumps(keys), encoding="utf-8")


@contextlib.contextmanager
def site_settings():
    """Removes the settings that a step writes with `site` when it ends."""
    try:
        yield
    finally:
        SITE.unlink(missing_ok=True)
        run("systemctl", "reload-or-restart", "slam-gateway")


@contextlib.contextmanager
def broker_away():
    run("systemctl", "stop", "mosquitto")
    try:
        yield
    finally:
        run("systemctl", "start", "mosquitto")
    wait_for_status("broker up")


@contextlib.contextmanager
def small_disk():
    """Puts the state on a disk of its own of 1 MiB until the step ends."""
    run("systemctl", "stop", "slam-gateway")
    run("sh", "-ec", f"mv {STATE} {STATE}.kept; mkdir {STATE}; mount -t tmpfs -o size=1m,mode=700 tmpfs {STATE}; "
                     f"cp -a {STATE}.kept/. {STATE}/; chown slam-gateway: {STATE}")
    try:
        run("systemctl", "start", "slam-gateway")
        wait_for_status("broker up")
        yield
    finally:
        run("systemctl", "stop", "slam-gateway")
        run("sh", "-ec", f"umount {STATE}; rmdir {STATE}; mv {STATE}.kept {STATE}")
        run("systemctl", "start", "slam-gateway")


def check_config(expected_status=0):
    return run("slam-gatewayd", "--check-config", status=expected_status)


def finding(findings, step):
    return next((entry for entry in findings if entry["step"] == step), None)


def doctor(*robot, expected_status=None):
    return json.loads(run("slam-gatewayctl", "--json", "doctor", *robot, status=expected_status))


def readable_credentials_stop_the_service():
    """credentials that others can read: refused with the command to type, and the service is not restarted"""
    CREDENTIALS.chmod(0o644)
    demand(f"type: sudo chmod o= {CREDENTIALS}" in check_config(78), "--check-config does not name the command to type")
    since = now()
    run("systemctl", "restart", "slam-gateway", status=1)
    demand(logged(f"type: sudo chmod o= {CREDENTIALS}", *since), "the journal does not name the command to type")
    demand(service("ActiveState") == "failed" and service("ExecMainStatus") == "78", "the service is started again")
    output = run("slam-gatewayctl", "status", status=1)
    demand("its configuration was refused: sudo slam-gatewayd --check-config" in output, output)
    run("chmod", "o=", CREDENTIALS)
    restart()
    wait_for_status("broker up")


def broken_credentials_are_reported_with_the_file_to_edit():
    """credentials that are not JSON: --check-config and the journal name the file to edit"""
    CREDENTIALS.write_text('{"username": "slam-gateway",\n "password": ', encoding="utf-8")
    demand(f"{CREDENTIALS}:2: syntax" in check_config(78), "--check-config does not report it")
    since = now()
    run("systemctl", "restart", "slam-gateway", status=1)
    demand(logged(f"{CREDENTIALS}:2: syntax", *since), "the journal names another file")
    write_credentials(PASSWORDS["slam-gateway"])
    restart()
    wait_for_status("broker up")


def password_in_the_wrong_file_is_reported():
    """a password in the configuration: --check-config names the file where it belongs"""
    with site_settings():
        site(broker={"password": "x"})
        demand("into credentials.json" in check_config(78), "--check-config does not name credentials.json")


def site_keys_override_and_errors_name_their_file():
    """gateway.d: the site's keys win over gateway.json; a problem there is named by its file"""
    with site_settings():
        site(log={"level": "debug"})
        run("systemctl", "reload", "slam-gateway")
        site(log={"level": "loud"})
        demand(check_config(78).startswith(f"{SITE}:1: log.level: "), "the problem is not named by its file")
        run("systemctl", "reload", "slam-gateway", status=1)
        site(log={"level": "info"})
        misnamed = SITE.with_suffix(".jsn")
        misnamed.write_text("{}", encoding="utf-8")
        output = check_config()
        misnamed.unlink()
        demand(f"warning: {misnamed}:1: file: is not read" in output, output)


def unreadable_file_is_reported_before_the_restart():
    """a file or gateway.d that root reads and the service may not: --check-config, as root, names the command to type"""
    with site_settings():
        site(log={"level": "debug"})
        SITE.chmod(0o600)
        output = check_config(78)
        demand(f"{SITE}:1: file: cannot be read by the service's user slam-gateway; type: sudo chgrp" in output, output)
        run("sh", "-ec", output.partition("type: ")[2].replace("sudo ", ""))
        demand(check_config().endswith("OK") and SITE.stat().st_mode & 0o777 == 0o640, "its command does not help")
        SITE.parent.chmod(0o700)
        output = check_config(78)
        words = f"{SITE.parent}:1: file: cannot be read by the service's user slam-gateway; type: sudo chmod 755"
        demand(words in output and f"{SITE}:1" not in output, output)
        run("systemctl", "reload", "slam-gateway", status=1)
        run("sh", "-ec", output.partition("type: ")[2].replace("sudo ", ""))
        demand(check_config().endswith("OK"), "its command does not help")


def taken_port_is_reported():
    """port taken: reported with the port, and the service recovers when the port is free"""
    run("systemctl", "stop", "slam-gateway")
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as taker:
        taker.bind(("::", 47193))
        since = now()
        run("systemctl", "start", "slam-gateway", status=None)
        wait_for("a line about the port", lambda: logged("another MQTT-SN gateway has the port", *since))
        wait_for("doctor's finding about the port", lambda: finding(doctor(), "thread: port"))
    wait_for_status("broker up")


def doctor_blames_no_program_for_a_kept_port():
    """port kept by systemd while the service waits for its restart: doctor blames no other program for it"""
    DROP_IN.parent.mkdir(exist_ok=True)
    DROP_IN.write_text("[Service]\nRestartSec=1h\n", encoding="utf-8")
    run("systemctl", "daemon-reload")
    run("systemctl", "kill", "--kill-whom=main", "-s", "KILL", "slam-gateway")
    wait_for("the pause before a restart", lambda: service("SubState") == "auto-restart")
    demand(service("NFileDescriptorStore") != "0", "systemd has not kept the socket")
    findings = doctor(expected_status=1)
    DROP_IN.unlink()
    run("systemctl", "daemon-reload")
    restart()
    demand(finding(findings, "daemon")["health"] == "problem", "doctor does not report that the daemon is down")
    demand(not finding(findings, "thread: port"), f"doctor reports: {finding(findings, 'thread: port')}")
    wait_for_status("broker up")


def robot_is_renamed():
    """rename: a robot gets its new name by a reload, without a restart"""
    robots = Robots("thread", "--robots", 1, "--id-prefix", "plain", "--keep-alive", 5)
    wait_for("the robot", lambda: "plain1" in run("slam-gatewayctl", "robots"))
    process = service("MainPID")
    with site_settings():
        site(robots=[{"id": "lego-9", "mqttsn_client_id": "plain1"}])
        run("systemctl", "reload", "slam-gateway")
        wait_for("the new name", lambda: "lego-9" in run("slam-gatewayctl", "robots"))
        demand(service("MainPID") == process, "it is another process")
    robots.end()


def doctor_finds_what_is_wrong():
    """doctor: finds no problem; without the broker, it names the broker"""
    wait_for("a healthy broker", lambda: finding(doctor(), "broker")["health"] == "ok")
    demand(finding(doctor(), "thread: search")["health"] == "ok", "the search was not answered")
    demand(finding(doctor(), "thread: multicast")["health"] == "ok", "the multicast group is not seen")
    with broker_away():
        wait_for("the broker as a problem",
                 lambda: finding(doctor(expected_status=1), "broker")["health"] == "problem")
    demand(finding(doctor("unknown", expected_status=1), "heard")["health"] == "problem", "an unknown robot is healthy")


def refused_topic_loses_nothing():
    """a topic that the broker refuses: status names it; all messages arrive once the rights are corrected"""
    rights = ACL.read_text(encoding="utf-8")
    topic = "ntnu-slam/robot/shy1/update"
    listener = Listener(topic)
    # The gateway's own right only: its user comes first (actors.set_up_broker).
    ACL.write_text(rights.replace("topic readwrite ntnu-slam/robot/#", "topic read ntnu-slam/robot/#", 1), encoding="utf-8")
    try:
        run("systemctl", "reload", "mosquitto")
        robots = Robots("thread", "--robots", 1, "--id-prefix", "shy", "--messages", 5)
        wait_for("the refused topic", lambda: any(entry["topic"] == topic for entry in status()["broker"]["refused"]["list"]))
        demand(topic in run("slam-gatewayctl", "status"), "the status does not name the topic")
    finally:
        ACL.write_text(rights, encoding="utf-8")
        run("systemctl", "reload", "mosquitto")
    listener.wait_for({topic: 5})
    demand_nothing_lost(robots.result())
    listener.end()


def reserve_broker_takes_over():
    """a second broker in reserve: used only while the first one is down"""
    reserve = subprocess.Popen(["mosquitto", "-p", "1884"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    with site_settings():
        site(broker={"uri": ["mqtt://127.0.0.1:1883", "mqtt://127.0.0.1:1884"], "return_to_first": True})
        check_config()
        run("systemctl", "reload", "slam-gateway")
        wait_for("the first broker", lambda: in_use() == "mqtt://127.0.0.1:1883")
        run("systemctl", "stop", "mosquitto")
        wait_for("the broker in reserve", lambda: in_use() == "mqtt://127.0.0.1:1884")
        run("systemctl", "start", "mosquitto")
        wait_for("the first broker again", lambda: in_use() == "mqtt://127.0.0.1:1883")
    reserve.terminate()
    reserve.wait()
    wait_for_status("broker up")


def in_use():
    broker = status()["broker"]
    return broker["uri"] if broker["state"] == "up" else None


def robot_is_forgotten():
    """forget: a robot that is gone for good leaves the list and the broker"""
    Robots("thread", "--robots", 1, "--id-prefix", "gone", "--messages", 2).result()
    demand("gone1" in run("slam-gatewayctl", "robots"), "the robot was not heard")
    demand(retained("robots/gone1"), "the broker has no retained message of it")
    run("slam-gatewayctl", "forget", "gone1")
    demand("gone1" not in run("slam-gatewayctl", "robots"), "it is still in the list")
    left = run("mosquitto_sub", *as_server(), "-t", f"ntnu-slam/gateway/{GATEWAY}/robots/gone1", "-C", "1", "-W", "2",
               status=None)
    demand("{" not in left, f"the broker still has {left}")


def old_gateway_is_removed_from_the_broker():
    """a gateway that is gone: the command of docs/fleet.md removes its retained messages, and no others"""
    user = ("-u", "slam-gateway", "-P", PASSWORDS["slam-gateway"])
    for topic in ("state", "robots/r"):
        run("mosquitto_pub", *user, "-t", f"ntnu-slam/gateway/old-name/{topic}", "-r", "-q", "1", "-m", '{"state":"online"}')
    clear = ("mosquitto_sub", *user, "-t", "ntnu-slam/gateway/old-name/#", "--retained-only", "--remove-retained", "-W", "2")
    demand("online" in run(*clear, status=None), "nothing was retained")
    demand("online" not in run(*clear, status=None), "a retained message is left")
    demand(retained("state") == "online", "another gateway's state was removed, too")


def gateways_list_each_other():
    """several gateways: the two name each other, and doctor sees both"""
    with tempfile.TemporaryDirectory() as directory:
        other = pathlib.Path(directory) / "gateway.json"
        other.write_text(json.dumps({
            "gateway": {"id": "room-b"}, "broker": {"credentials_file": str(CREDENTIALS)}, "store": {"directory": directory},
            "mqttsn": {"listen": ["127.0.0.1:47194"], "multicast_group": None},
            "control": {"socket": directory + "/control.sock"}}), encoding="utf-8")
        process = subprocess.Popen(["slam-gatewayd", "--config", str(other)], stdout=subprocess.DEVNULL,
                                   stderr=subprocess.DEVNULL)
        wait_for("the other gateway", lambda: (finding(doctor(), "fleet") or {}).get("detail") == "shares the broker with room-b")
        fleet = run("slam-gatewayctl", "--socket", directory + "/control.sock", "fleet")
        demand(GATEWAY in fleet and "room-b" in fleet, fleet)
        process.terminate()
        demand(process.wait() == 0, "the other gateway failed")


def report_has_no_secret():
    """report: an archive with journal and status, without passwords"""
    run("slam-gatewayctl", "report", "/root/report.tar.gz")
    text = run("tar", "-xzOf", "/root/report.tar.gz")
    demand("starts as gateway" in text and '"uptime_s"' in text, "journal or status is missing")
    for password in PASSWORDS.values():
        demand(password not in text, "a password is in the report")


def backup_is_restored_on_a_new_card():
    """new SD card: a backup restores configuration, credentials, mesh and messages on a purged system"""
    robots = Robots("thread", "--robots", 1, "--id-prefix", "kept", "--messages", 60, "--linger-s", 2)
    wait_for("the robot", lambda: "kept1" in run("slam-gatewayctl", "robots"))  # without a broker it finds no gateway
    with broker_away():
        wait_for("stored messages", lambda: status()["store"]["depth"] > 20)
        run("slam-gatewayctl", "backup", BACKUP)
        demand(run("stat", "-c", "%U %a", BACKUP) == "root 600", "the backup can be read by others")
        wait_for("the service again", lambda: status()["store"]["depth"] > 20)
        robots.end()
        mesh, owners = (STATE / "mesh.json").read_text(encoding="utf-8"), owners_and_modes()
        run("systemctl", "stop", "slam-gateway")
        for directory in (STATE, CONFIG.parent):
            run("find", directory, "-mindepth", 1, "-delete")
        run("slam-gatewayctl", "restore", BACKUP)
        demand((STATE / "mesh.json").read_text(encoding="utf-8") == mesh, "the mesh differs")
        demand(owners_and_modes() == owners, f"owners and modes: {owners_and_modes()}, before: {owners}")
        wait_for("the stored messages", lambda: status()["store"]["depth"] > 20)
    wait_for("an empty store", lambda: status()["store"]["depth"] == 0)
    run("sh", "-c", f"rm -rf {STATE}.before-restore-* {CONFIG.parent}.before-restore-*")


def owners_and_modes():
    return run("stat", "-c", "%n %U %G %a", STATE, STATE / "mesh.json", STATE / "messages", CREDENTIALS, CONFIG)


def journal_has_each_message_after_a_reload():
    """log.traffic: after a reload, the journal has each message of a robot"""
    with site_settings():
        site(log={"level": "debug", "traffic": "all"})
        run("systemctl", "reload", "slam-gateway")
        since = now()
        Robots("thread", "--robots", 1, "--id-prefix", "wordy", "--messages", 5).result()
        wait_for("all five messages", lambda: run("journalctl", "-q", "-u", "slam-gateway", "ROBOT_ID=wordy1",
                                                  "MESSAGE_TYPE=update", "-o", "cat", *since).count("\n") >= 4)


def broker_with_its_own_certificates():
    """TLS: a broker with a certificate of the site's own authority, as described in broker.md"""
    tls = pathlib.Path("/etc/mosquitto/certs")
    run("sh", "-c", f"""set -e; cd {tls}
      openssl req -x509 -newkey rsa:2048 -nodes -days 9 -subj /CN=site-ca -keyout ca.key -out ca.pem
      openssl req -newkey rsa:2048 -nodes -subj /CN=guest -keyout server.key -out server.csr
      printf 'subjectAltName=DNS:guest' >ext
      openssl x509 -req -in server.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 9 -extfile ext -out server.pem
      chown mosquitto server.key; chmod 600 server.key""")
    listener = pathlib.Path("/etc/mosquitto/conf.d/tls.conf")
    listener.write_text(f"listener 8883\ncertfile {tls}/server.pem\nkeyfile {tls}/server.key\n", encoding="utf-8")
    run("systemctl", "restart", "mosquitto")
    run("install", "-m", "644", tls / "ca.pem", "/etc/slam-gateway/ca.pem")
    with site_settings():
        site(broker={"uri": "mqtts://guest", "tls": {"ca_file": "/etc/slam-gateway/ca.pem"}})
        check_config()
        run("systemctl", "reload", "slam-gateway")
        wait_for("the broker over TLS", lambda: status()["broker"]["state"] == "up"
                 and status()["broker"]["uri"].startswith("mqtts://guest"))
        # The name is not in the certificate.
        site(broker={"uri": "mqtts://127.0.0.1", "tls": {"ca_file": "/etc/slam-gateway/ca.pem"}})
        run("systemctl", "reload", "slam-gateway")
        wait_for("the refusal of another name", lambda: "certificate" in status()["broker"]["why"])
    listener.unlink()
    pathlib.Path("/etc/slam-gateway/ca.pem").unlink()
    run("systemctl", "restart", "mosquitto")
    wait_for_status("broker up")


def full_disk_is_reported_until_there_is_room():
    """disk full: reported until there is room again"""
    with small_disk():
        robots = Robots("thread", "--robots", 1, "--id-prefix", "stuck")
        wait_for("the robot", lambda: "stuck1" in run("slam-gatewayctl", "robots"))
        run("sh", "-c", f"head -c 2M /dev/zero >{STATE}/filler || true")
        with broker_away():
            wait_for("a report of the full store", lambda: "full" in status()["store"]["why"])
            demand(finding(doctor(expected_status=1), "store")["health"] == "problem", "doctor does not report the store")
            run("rm", STATE / "filler")
            wait_for("a working store",
                     lambda: status()["store"]["state"] == "working" and not status()["store"]["why"])
        robots.end()


def second_gateway_with_the_same_id_is_reported():
    """second gateway: two with one client id disconnect each other, which is reported"""
    since = now()
    rival = subprocess.Popen(["sh", "-c", 'while :; do timeout 2 mosquitto_sub "$@"; sleep 0.3; done', "rival",
                              "-i", f"slam-gateway-{GATEWAY}", *as_server(), "-t", "none"], stdout=subprocess.DEVNULL,
                             stderr=subprocess.DEVNULL, start_new_session=True)
    wait_for("a line about the other client", lambda: logged("another client connects as", *since, "-p", "warning"))
    os.killpg(rival.pid, signal.SIGTERM)
    rival.wait()
    wait_for_status("broker up")


STEPS = [
    readable_credentials_stop_the_service,
    broken_credentials_are_reported_with_the_file_to_edit,
    password_in_the_wrong_file_is_reported,
    site_keys_override_and_errors_name_their_file,
    unreadable_file_is_reported_before_the_restart,
    journal_has_each_message_after_a_reload,
    taken_port_is_reported,
    doctor_blames_no_program_for_a_kept_port,
    robot_is_renamed,
    robot_is_forgotten,
    refused_topic_loses_nothing,
    reserve_broker_takes_over,
    broker_with_its_own_certificates,
    second_gateway_with_the_same_id_is_reported,
    gateways_list_each_other,
    old_gateway_is_removed_from_the_broker,
    doctor_finds_what_is_wrong,
    report_has_no_secret,
    full_disk_is_reported_until_there_is_room,
    backup_is_restored_on_a_new_card,
]
