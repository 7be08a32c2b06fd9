# SPDX-License-Identifier: Apache-2.0
"""Runs steps in their order, over reboots of the guest, and prints ok or FAILED for each."""
import json
import pathlib
import time

from machine import Failure, demand, journal, run

PROGRESS = pathlib.Path("/job/progress.json")


class Reboot(Exception):
    """Raised by a step: the guest reboots, and the step runs again."""

    def begin(self):
        run("systemctl", "reboot")


class PowerCut(Reboot):
    """The same with a power cut of the virtual machine."""

    def begin(self):
        pathlib.Path("/job/power-cut").touch()


def progress():
    if not PROGRESS.exists():
        return {"next": 0, "failed": []}
    return json.loads(PROGRESS.read_text(encoding="utf-8"))


def chosen(steps, names):
    """Returns all steps, or those with these names."""
    known = [step.__name__ for step in steps]
    unknown = [name for name in names if name not in known]
    demand(not unknown, f"no such step: {' '.join(unknown)}; the steps are\n  " + "\n  ".join(known))
    return [step for step in steps if not names or step.__name__ in names]


def run_steps(steps, names=()):
    """Returns 0 when all steps, or those with these names, have passed."""
    try:
        steps = chosen(steps, names)
    except Failure as failure:
        print(failure, flush=True)
        return 2
    done = progress()
    for number in range(done["next"], len(steps)):
        step = steps[number]
        began = time.monotonic()
        done["next"] = number
        try:
            note = step()
        except Reboot as reboot:
            PROGRESS.write_text(json.dumps(done), encoding="utf-8")
            reboot.begin()
            time.sleep(3600)  # until the reboot
        except Exception as error:  # counts as a failure; the next steps still run
            done["failed"].append(step.__name__)
            print(f"FAILED  {step.__doc__}\n  {type(error).__name__}: {error}", flush=True)
            for entry in journal()[-12:]:
                print(f"  | {entry.get('MESSAGE')}", flush=True)
        else:
            print(f"ok      {step.__doc__} ({time.monotonic() - began:.1f} s{', ' + note if note else ''})", flush=True)
    print(f"{len(steps) - len(done['failed'])} of {len(steps)} steps passed", flush=True)
    return 1 if done["failed"] else 0
