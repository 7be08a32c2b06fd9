# SPDX-License-Identifier: Apache-2.0
"""Steps: the other packages, slam-gateway-web and slam-gateway-experiment."""
import glob
import http.client
import json
import os
import pathlib
import re
import signal

from actors import PASSWORDS, Robots, demand_nothing_lost
from machine import Failure, demand, install, run, service, wait_for

PAGE = ("127.0.0.1", 8321)
CREDENTIALS = pathlib.Path("/etc/slam-gateway/web-credentials.json")
TOKEN = pathlib.Path("/etc/slam-gateway/web-token")
SITE = pathlib.Path("/etc/slam-gateway/gateway.d/web.json")
RESULT = pathlib.Path("/root/thread-1000")


def answer(path, host=f"{PAGE[0]}:{PAGE[1]}"):
    """Returns status and text."""
    connection = http.client.HTTPConnection(*PAGE, timeout=20)
    try:
        connection.request("GET", path, headers={"Host": host})
        response = connection.getresponse()
        return response.status, response.read().decode("utf-8")
    except (OSError, http.client.HTTPException) as error:
        raise Failure(f"the page does not answer: {error}") from error


def page_service(what):
    return run("systemctl", "show", "-P", what, "slam-gateway-web")


def count_of(robot):
    """Returns the number of messages of that robot, as Prometheus reads it."""
    status, text = answer("/metrics")
    demand(status == 200, f"/metrics: status {status}")
    found = re.search(rf'^slamgw_robot_messages_total{{[^}}]*robot="{robot}"[^}}]*}} (\d+)', text, re.MULTILINE)
    return int(found[1]) if found else 0


def page_shows_the_robots():
    """page: installed, with a password of its own at the broker, it has a robot's messages; on 127.0.0.1 only"""
    install(*glob.glob("/job/input/debs/more/slam-gateway-web_*.deb"))
    CREDENTIALS.touch(mode=0o600)
    CREDENTIALS.write_text(json.dumps({"username": "slam-gateway-web", "password": PASSWORDS["slam-gateway-web"]}),
                           encoding="utf-8")
    run("systemctl", "restart", "slam-gateway-web")
    robots = Robots("thread", "--robots", 1, "--id-prefix", "seen")
    wait_for("the robot's messages in the metrics", lambda: count_of("seen1") > 3)
    demand(answer("/")[0] == 200, "there is no page")
    demand(answer("/", host="evil.example")[0] in (403, 421), "a request for another host name is answered")
    listening = run("ss", "-Hltn", "sport = :8321").splitlines()
    demand(len(listening) == 1 and "127.0.0.1:8321" in listening[0], f"it listens elsewhere: {listening}")
    demand_nothing_lost(robots.end())


def page_is_confined():
    """page: systemd-analyze security reports 1.5 or less; a token file that others can read is refused, as in docs/web.md"""
    verdict = run("systemd-analyze", "security", "--no-pager", "--threshold=15", "slam-gateway-web").splitlines()[-1]
    run("install", "-m", "640", "-g", "slam-gateway-web", "/dev/null", TOKEN)
    TOKEN.write_text("0123456789abcdef0123456789abcdef\n", encoding="ascii")
    SITE.write_text(json.dumps({"web": {"token_file": "web-token"}}), encoding="utf-8")
    run("systemctl", "restart", "slam-gateway-web")
    wait_for("the page again", lambda: answer("/")[0] == 200)
    run("chmod", "644", TOKEN)
    run("systemctl", "restart", "slam-gateway-web", status=1)
    demand(page_service("ExecMainStatus") == "78", "a token that everybody can read is accepted")
    SITE.unlink()
    TOKEN.unlink()
    run("systemctl", "restart", "slam-gateway-web")
    return re.sub(r"[^ -~]", "", verdict).strip()


def page_reports_a_key_that_it_may_not_read():
    """page: --check-config, as root, warns of the gateway's client key that the page's own user may not read"""
    certificate, key = SITE.with_name("client.pem"), SITE.with_name("client.key")
    run("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "9", "-subj", "/CN=gateway",
        "-keyout", key, "-out", certificate)
    key.chmod(0o600)
    SITE.write_text(json.dumps({"broker": {"uri": "mqtts://guest", "tls": {"certificate_file": str(certificate),
                                                                           "key_file": str(key)}}}), encoding="utf-8")
    try:
        refused = run("slam-gateway-web", "--check-config")
        run("chgrp", "slam-gateway-web", key)
        key.chmod(0o640)
        accepted = run("slam-gateway-web", "--check-config")
    finally:
        for file in (SITE, certificate, key):
            file.unlink()
    demand(f"warning: {key}:1: broker.tls.key_file: cannot be read by slam-gateway-web" in refused, refused)
    demand("cannot be read" not in accepted, accepted)


def page_restarts_after_a_kill():
    """page: restarted after a kill; the daemon keeps running and robots lose nothing"""
    robots = Robots("thread", "--robots", 1, "--id-prefix", "unmoved")
    daemon, page = service("MainPID"), page_service("MainPID")
    os.kill(int(page), signal.SIGKILL)
    wait_for("another page", lambda: page_service("MainPID") not in ("0", page) and count_of("unmoved1") > 3)
    demand_nothing_lost(robots.end())
    demand(service("MainPID") == daemon, "the daemon was restarted")
    demand("slam-gatewayd" not in run("ss", "-Hltnp"), "the daemon listens on TCP")


def experiment_is_repeated():
    """experiment: thread-1000 with simulated robots, as packaged: numbers, events, and a figure"""
    install(*glob.glob("/job/input/debs/more/slam-gateway-experiment_*.deb"))
    demand("ring" in run("slam-gateway-experiment", "list"), "the list is short")
    run("slam-gateway-experiment", "run", "thread-1000", "--sim", "--messages", 20, "--out", RESULT)
    result = json.loads((RESULT / "result.json").read_text(encoding="utf-8"))
    demand((RESULT / "figure.png").stat().st_size > 1000, "there is no figure")
    demand((RESULT / "events.csv").read_text(encoding="utf-8").count("\n") > 40, "there are hardly any events")
    return json.dumps(result["measured"]["counts"])


STEPS = [page_shows_the_robots, page_is_confined, page_reports_a_key_that_it_may_not_read, page_restarts_after_a_kill, experiment_is_repeated]
