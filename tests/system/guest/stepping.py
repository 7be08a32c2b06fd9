# SPDX-License-Identifier: Apache-2.0
"""Runs steps in their order, over reboots of the guest, and says ok or FAILED for each."""
import json
import pathlib
import time

from machine import journal, run

PROGRESS = pathlib.Path("/job/progress.json")


class Reboot(Exception):
    """Raised at a step's end: the guest starts anew, and the next step follows."""


def progress():
    if not PROGRESS.exists():
        return {"next": 0, "failed": []}
    return json.loads(PROGRESS.read_text(encoding="utf-8"))


def run_steps(steps):
    """0 when all have passed."""
    done = progress()
    for number in range(done["next"], len(steps)):
        step = steps[number]
        began = time.monotonic()
        done["next"] = number + 1
        try:
            note = step()
        except Reboot:
            PROGRESS.write_text(json.dumps(done), encoding="utf-8")
            print(f"ok      {step.__doc__}", flush=True)
            run("systemctl", "reboot")
            time.sleep(3600)  # ended by that
        except Exception as error:  # a step that breaks is a step that failed, and the next ones still tell something
            done["failed"].append(step.__name__)
            print(f"FAILED  {step.__doc__}\n  {type(error).__name__}: {error}", flush=True)
            for entry in journal()[-12:]:
                print(f"  | {entry.get('MESSAGE')}", flush=True)
        else:
            print(f"ok      {step.__doc__} ({time.monotonic() - began:.1f} s{', ' + note if note else ''})", flush=True)
    print(f"{len(steps) - len(done['failed'])} of {len(steps)} steps passed", flush=True)
    return 1 if done["failed"] else 0
