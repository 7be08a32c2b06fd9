# SPDX-License-Identifier: Apache-2.0
"""Runs steps in their order, over reboots of the guest, and says ok or FAILED for each."""
import json
import pathlib
import time

from machine import Failure, demand, journal, run

PROGRESS = pathlib.Path("/job/progress.json")


class Reboot(Exception):
    """Raised by a step: the guest starts anew, and the step is called again."""

    def begin(self):
        run("systemctl", "reboot")


class PowerCut(Reboot):
    """The same, as when somebody pulls the plug of a virtual machine."""

    def begin(self):
        pathlib.Path("/job/power-cut").touch()


def progress():
    if not PROGRESS.exists():
        return {"next": 0, "failed": []}
    return json.loads(PROGRESS.read_text(encoding="utf-8"))


def chosen(steps, names):
    """All steps, or those of that name."""
    known = [step.__name__ for step in steps]
    unknown = [name for name in names if name not in known]
    demand(not unknown, f"no such step: {' '.join(unknown)}; the steps are\n  " + "\n  ".join(known))
    return [step for step in steps if not names or step.__name__ in names]


def run_steps(steps, names=()):
    """0 when all have passed, or those of that name."""
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
