#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The steps of ./dev system-test, in the guest and in their order; each says in one line what it shows."""
import sys
import time

import broker_and_traffic
import install_and_remove
import tasks
import trouble
from machine import journal

STEPS = [
    install_and_remove.runs_once_installed,
    install_and_remove.is_confined,
    broker_and_traffic.starts_without_a_broker,
    broker_and_traffic.tells_of_a_wrong_password,
    broker_and_traffic.logs_in_with_the_right_one,
    broker_and_traffic.carries_both_meshes,
    broker_and_traffic.journal_has_the_documented_fields,
    broker_and_traffic.warning_is_found_under_load,
    trouble.reload_takes_over_a_good_configuration,
    trouble.reload_refuses_a_bad_configuration,
    trouble.kill_goes_unnoticed,
    trouble.restarts_refuse_no_message,
    trouble.watchdog_restarts_a_stopped_daemon,
    *tasks.STEPS,
    install_and_remove.upgrade_keeps_what_is_undelivered,
    install_and_remove.remove_keeps_the_state,
    install_and_remove.purge_takes_everything,
    install_and_remove.no_secret_is_in_the_journal,
]


def main():
    failed = []
    for step in STEPS:
        began = time.monotonic()
        try:
            note = step()
        except Exception as error:  # a step that breaks is a step that failed, and the next ones still tell something
            failed.append(step.__name__)
            print(f"FAILED  {step.__doc__}\n  {type(error).__name__}: {error}", flush=True)
            for entry in journal()[-12:]:
                print(f"  | {entry.get('MESSAGE')}", flush=True)
        else:
            print(f"ok      {step.__doc__} ({time.monotonic() - began:.1f} s{', ' + note if note else ''})", flush=True)
    print(f"{len(STEPS) - len(failed)} of {len(STEPS)} steps passed", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
