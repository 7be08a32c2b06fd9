# SPDX-License-Identifier: Apache-2.0
"""The faults of a run. Each act breaks something, waits and repairs it. It returns when the daemon is connected again. Used by run.

An act draws its lengths from the run's seed before it begins, so that a seed always makes the same acts in the same order.

Bounds for messages that arrive twice because of an act:
- The connection to the broker ended: at most the window. Messages in flight may have been acknowledged, and are sent again.
- kill -9 of the daemon: also delivered rows that were not deleted yet, at most a batch. For each robot, also the message whose
  acknowledgement was lost with the daemon.
- The board restarted or was unplugged: for each of its robots a message whose STATUS was lost.
- The store was damaged: rows whose entry in the list of erased records is lost, at most a segment of them.
"""
import contextlib
import signal
import time

from program import Failure
from stranger import Stranger
from world import FLEETS, LARGEST_PACKET, PREFIX

WINDOW = 16  # broker.max_inflight
FORGET_BATCH = 256  # Backlog::forget_batch
LINK_LOST = WINDOW
DAEMON_KILLED = WINDOW + FORGET_BATCH + sum(FLEETS.values())
BOARD_LOST = FLEETS["ble"]
MOST_CLOSINGS = 12  # of connections while a robot is refused
STORE_DAMAGED = 4000
SMALL_PACKET = 400  # larger than robots' messages, smaller than the gateway's statistics


class Acts:
    def __init__(self, world, chance, seconds, only=None):
        self.world, self.chance, self.only = world, chance, only
        self.longest = min(60.0, max(1.5, seconds / 10))  # seconds of an outage

    def choices(self):
        acts = [self.kill_daemon, self.kill_daemon_again_and_again, self.stop_daemon, self.kill_broker, self.take_broker_away,
                self.lose_both, self.kill_daemon_as_it_catches_up, self.stall_broker, self.kill_daemon_at_a_stalled_broker,
                self.unplug_board, self.restart_board, self.damage_store]
        acts += [self.send_a_crowd_of_strangers, self.shrink_packets, self.poison]
        if self.world.clock.can_be_moved:
            acts += [self.move_clock, self.move_clock_of_a_killed_daemon]
        if self.world.mqtt == 5:  # an MQTT 3.1.1 broker acknowledges messages that it drops
            acts += [self.refuse_a_robot]
        if self.world.disk.can_be_filled:
            acts += [self.fill_disk, self.kill_daemon_on_a_full_disk]
        if self.world.disk.can_fail:
            acts += [self.fail_disk, self.start_daemon_on_a_failing_disk]
        return [act for act in acts if self.only is None or act.__name__ in self.only]

    def moment(self):
        return self.chance.uniform(0, 1.5)

    def outage(self):
        return self.chance.uniform(1, self.longest)

    def kill_daemon(self):
        down, world = self.moment(), self.world
        with world.trouble(f"kill -9 the daemon for {down:.1f} s", DAEMON_KILLED):
            world.end_daemon(signal.SIGKILL)
            self.start_daemon_after(down)

    def kill_daemon_again_and_again(self):
        moments, world = [self.chance.uniform(0, 0.3) for _ in range(4)], self.world
        with world.trouble("kill -9 the daemon, then 4 times during its start", (len(moments) + 1) * DAEMON_KILLED):
            for moment in moments:
                world.end_daemon(signal.SIGKILL)
                world.start_daemon()
                world.pass_time(moment)
            world.end_daemon(signal.SIGKILL)
            self.start_daemon_after(0)

    def stop_daemon(self):
        down, world = self.moment(), self.world
        with world.trouble(f"SIGTERM the daemon for {down:.1f} s", LINK_LOST + sum(FLEETS.values())):
            world.end_daemon(signal.SIGTERM)
            self.start_daemon_after(down)

    def kill_broker(self):
        down, world = self.moment(), self.world
        with world.trouble(f"kill -9 the broker for {down:.1f} s", LINK_LOST):
            world.end_broker(signal.SIGKILL)
            self.start_broker_after(down)

    def take_broker_away(self):
        down, world = self.outage(), self.world
        with world.trouble(f"stop the broker for {down:.1f} s", LINK_LOST):
            world.end_broker(signal.SIGTERM)
            self.start_broker_after(down)

    def lose_both(self):
        before, between, after, world = self.outage() / 2, self.moment(), self.outage() / 2, self.world
        with world.trouble(f"stop the broker for {before + between + after:.1f} s; kill -9 the daemon during that time",
                           LINK_LOST + DAEMON_KILLED):
            world.end_broker(signal.SIGTERM)
            world.pass_time(before)
            world.end_daemon(signal.SIGKILL)
            world.pass_time(between)
            world.start_daemon()
            self.start_broker_after(after)

    def kill_daemon_as_it_catches_up(self):
        away, down, world = self.outage(), self.moment(), self.world
        with world.trouble(f"stop the broker for {away:.1f} s; kill -9 the daemon as it catches up",
                           LINK_LOST + DAEMON_KILLED):
            world.end_broker(signal.SIGTERM)
            self.start_broker_after(away)
            world.end_daemon(signal.SIGKILL)
            self.start_daemon_after(down)

    def stall_broker(self):
        stalled, world = self.outage(), self.world
        with world.trouble(f"SIGSTOP the broker for {stalled:.1f} s", LINK_LOST):
            world.pause_broker()
            world.pass_time(stalled)
            since = time.time()
            world.resume_broker()
            world.wait_for_link(since)

    def kill_daemon_at_a_stalled_broker(self):
        before, after, world = self.outage() / 2, self.outage() / 2, self.world
        with world.trouble(f"SIGSTOP the broker for {before + after:.1f} s; kill -9 the daemon during that time",
                           LINK_LOST + DAEMON_KILLED):
            world.pause_broker()
            world.pass_time(before)
            world.end_daemon(signal.SIGKILL)
            world.start_daemon()
            world.pass_time(after)
            since = time.time()
            world.resume_broker()
            world.wait_for_daemon_at_broker(since)

    def unplug_board(self):
        with self.world.trouble("unplug the board for 2 s", BOARD_LOST):
            self.world.robots["ble"].send(signal.SIGUSR1)
            self.world.pass_time(2)
            self.wait_for_board()

    def restart_board(self):
        with self.world.trouble("restart the board", BOARD_LOST):
            self.world.robots["ble"].send(signal.SIGUSR2)
            self.world.pass_time(0.5)
            self.wait_for_board()

    def fill_disk(self):
        down, world = self.outage(), self.world
        with world.trouble(f"fill the disk and stop the broker for {down:.1f} s", LINK_LOST):
            world.disk.fill()
            world.end_broker(signal.SIGTERM)
            world.pass_time(down)
            world.disk.free()
            self.start_broker_after(0)

    def kill_daemon_on_a_full_disk(self):
        before, on_full_disk, after, world = self.outage() / 2, self.outage() / 2, self.moment(), self.world
        with world.trouble(f"stop the broker for {before + on_full_disk + after:.1f} s, fill the disk, kill -9 the daemon",
                           LINK_LOST + DAEMON_KILLED):
            world.end_broker(signal.SIGTERM)
            world.pass_time(before)
            world.disk.fill()
            world.end_daemon(signal.SIGKILL)
            world.start_daemon()
            world.pass_time(on_full_disk)
            world.disk.free()
            self.start_broker_after(after)

    def fail_disk(self):
        down, failing, world = self.outage(), self.outage() / 2, self.world
        log_position = len(world.daemon.log.read_text())
        with world.trouble(f"stop the broker for {down + failing:.1f} s; I/O errors for {failing:.1f} s of them",
                           LINK_LOST + sum(FLEETS.values())):
            world.end_broker(signal.SIGTERM)
            world.pass_time(down / 2)
            with self.failing_disk():
                world.pass_time(failing)
            self.repair_disk()
            world.pass_time(down / 2)
            self.start_broker_after(0)
        if world.reported_as_lost(log_position):
            raise Failure("messages are reported as lost although the disk failed only for a moment")

    def start_daemon_on_a_failing_disk(self):
        before, failing, world = self.outage() / 2, self.chance.uniform(1, 5), self.world
        with world.trouble(f"stop the broker for {before + failing:.1f} s, kill -9 the daemon, start it with I/O errors for "
                           f"{failing:.1f} s", LINK_LOST + DAEMON_KILLED):
            world.end_broker(signal.SIGTERM)
            world.pass_time(before)
            world.end_daemon(signal.SIGKILL)
            with self.failing_disk():
                world.start_daemon()
                world.pass_time(failing)
            self.repair_disk()
            self.start_broker_after(0)

    @contextlib.contextmanager
    def failing_disk(self):
        self.world.disk.fail()
        yield
        self.world.disk.mend()

    def repair_disk(self):
        if self.world.disk.is_broken():
            self.world.say("  the host restarts, because its file system is broken")
            self.world.end_daemon(signal.SIGTERM)
            self.world.disk.repair()
            self.world.start_daemon()

    def damage_store(self):
        down, world = self.outage(), self.world
        with world.trouble(f"stop the broker for {down:.1f} s, kill -9 the daemon, damage its store",
                           LINK_LOST + DAEMON_KILLED + STORE_DAMAGED) as trouble:
            world.end_broker(signal.SIGTERM)
            world.pass_time(down)
            world.end_daemon(signal.SIGKILL)
            world.say(f"  {world.disk.damage(self.chance)}")
            log_position = len(world.daemon.log.read_text())
            world.start_daemon()
            self.start_broker_after(0)
            world.wait_for("the backlog", lambda: world.status("store", "depth") == 0)
            trouble.may_lose = world.reported_as_lost(log_position)
            world.say(f"  {trouble.may_lose} messages are reported as lost")

    def refuse_a_robot(self):
        """Has the broker refuse a robot. It may close the connection after each refusal: the first, and the tries after 2, 4, 8 ... s."""
        refusing, robot, world = self.outage(), self.chance.choice(self.world.robot_ids()), self.world
        with world.trouble(f"the broker refuses {robot} for {refusing:.1f} s", MOST_CLOSINGS * LINK_LOST) as trouble:
            trouble.refused = robot
            world.refuse(robot)
            world.open_gap()  # it may close the connection
            world.pass_time(refusing)
            world.refuse_nothing()
            world.wait_for("the end of the refusal", lambda: world.status("broker", "refused", "topics") == 0)
            world.close_gaps()

    def shrink_packets(self):
        """Lowers the broker's packet limit. An MQTT 5 broker announces the limit at the next connection. Until then, and with MQTT 3.1.1,
        it closes the connection at a packet that is too large, and the gateway finds the limit by trying."""
        lasts, world = self.outage() + 12, self.world  # longer than the interval of its statistics
        with world.trouble(f"the broker accepts packets up to {SMALL_PACKET} octets for {lasts:.1f} s", MOST_CLOSINGS * LINK_LOST):
            world.take_packets_of(SMALL_PACKET)
            world.open_gap()
            world.pass_time(lasts)
            world.take_packets_of(LARGEST_PACKET)
            world.wait_for_link(time.time())

    def move_clock(self):
        hours, lasts, world = self.hours(), self.outage() / 2, self.world
        with world.trouble(f"the clock jumps by {hours:+.1f} h", 0):
            world.clock.move(hours * 3600)
            world.pass_time(lasts)

    def move_clock_of_a_killed_daemon(self):
        hours, down, world = self.hours(), self.moment(), self.world
        with world.trouble(f"kill -9 the daemon for {down:.1f} s; the clock jumps by {hours:+.1f} h during that time", DAEMON_KILLED):
            world.end_daemon(signal.SIGKILL)
            world.clock.move(hours * 3600)
            self.start_daemon_after(down)

    def hours(self):
        return self.chance.choice((-1, 1)) * self.chance.uniform(1, 12)

    def send_a_crowd_of_strangers(self):
        count, lasts, world = self.chance.randrange(500, 3000), self.outage() / 4, self.world
        with world.trouble(f"{count} strangers connect", 0):
            Stranger(world.mqttsn_port).send_crowd(count)
            world.pass_time(lasts)

    def poison(self):
        """Sends text for which Mosquitto closes the connection. The gateway must not pass it on."""
        world = self.world
        with world.trouble("a robot sends text for which Mosquitto closes the connection", 0):
            before = world.connections()
            Stranger(world.mqttsn_port).send_poison(PREFIX)
            world.pass_time(2)
            if world.connections() != before:
                raise Failure("a robot's text has ended the connection to the broker")

    def start_daemon_after(self, seconds):
        self.world.pass_time(seconds)
        since = time.time()
        self.world.start_daemon()
        self.world.wait_for_daemon_at_broker(since)

    def start_broker_after(self, seconds):
        self.world.pass_time(seconds)
        since = time.time()
        self.world.start_broker()
        self.world.wait_for_daemon_at_broker(since)

    def wait_for_board(self):
        self.world.wait_for("the board", lambda: self.world.status("meshes", "ble", "state") == "up")
