#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The steps of ./dev system-test, in the guest and in their order; each describes itself in one line."""
import sys

import broker_and_traffic
import install_and_remove
import page_and_experiment
import tasks
import trouble
from stepping import run_steps

STEPS = [
    install_and_remove.runs_once_installed,
    install_and_remove.is_confined,
    broker_and_traffic.starts_without_a_broker,
    broker_and_traffic.reports_a_wrong_password,
    broker_and_traffic.logs_in_with_the_right_password,
    broker_and_traffic.carries_both_meshes,
    broker_and_traffic.journal_has_the_documented_fields,
    broker_and_traffic.warning_is_found_under_load,
    trouble.reload_applies_a_good_configuration,
    trouble.reload_refuses_a_bad_configuration,
    trouble.kill_loses_no_message_or_session,
    trouble.restarts_lose_no_datagram,
    trouble.watchdog_restarts_a_stopped_daemon,
    *tasks.STEPS,
    *page_and_experiment.STEPS,
    install_and_remove.upgrade_keeps_what_is_undelivered,
    install_and_remove.remove_keeps_the_state,
    install_and_remove.purge_removes_everything,
    install_and_remove.no_secret_is_in_the_journal,
]


if __name__ == "__main__":
    sys.exit(run_steps(STEPS))
