# SPDX-License-Identifier: Apache-2.0
"""A small disk for the store, which can be filled. Where loop devices are allowed, it can also fail: every read and write by the
kernel is then an I/O error. Also damages files of the store. Used by World and acts."""
import contextlib
import fcntl
import os
import pathlib
import struct
import subprocess

SIZE = "16M"
LOOP_SET_STATUS64, LOOP_GET_STATUS64 = 0x4C04, 0x4C05
STATUS_BYTES, SIZE_LIMIT_AT = 232, 32  # struct loop_info64
SECTOR = 4096


class Disk:
    def __init__(self, directory, has_own_mounts):
        self.directory, self.image = pathlib.Path(directory), f"{directory}.image"
        self.directory.mkdir(mode=0o700)
        self.loop = self.mount_loop() if has_own_mounts else None
        self.can_fail = self.loop is not None
        self.can_be_filled = self.can_fail or has_own_mounts and succeeds(
            "mount", "-t", "tmpfs", "-o", f"size={SIZE},mode=0700", "store", self.directory)

    def mount_loop(self):
        """Mounts a loop device with ext2, which works again once the device does. (ext4 aborts a journal that it could not write, and
        its delayed allocation retries without end.)"""
        if not (succeeds("truncate", "-s", SIZE, self.image) and succeeds("mkfs.ext2", "-q", self.image)):
            return None
        attached = subprocess.run(["losetup", "-f", "--show", self.image], capture_output=True, text=True, check=False)
        loop = attached.stdout.strip()
        return loop if attached.returncode == 0 and self.mount(loop) else None

    def mount(self, loop):
        is_mounted = succeeds("mount", "-t", "ext2", "-o", "errors=continue", loop, self.directory)
        with contextlib.suppress(OSError):  # e2fsck may have filled it
            os.rmdir(self.directory / "lost+found")
        return is_mounted

    def is_broken(self):
        """Returns True after an I/O error in a table of the file system, which the kernel then rejects until the host restarts."""
        listing = subprocess.run(["tune2fs", "-l", self.loop], capture_output=True, text=True, check=False).stdout
        return "with errors" in listing

    def repair(self):
        """Checks and mounts the file system, as a host does when it starts."""
        if self.loop and succeeds("umount", self.directory):
            succeeds("e2fsck", "-f", "-y", self.loop)
            if not self.mount(self.loop):
                raise RuntimeError(f"{self.loop} cannot be mounted any more")

    def unmount(self):
        if self.loop:
            self.mend()  # a failing file system cannot be unmounted
        if self.can_be_filled:
            succeeds("umount", "--lazy", self.directory)
        if self.loop:
            succeeds("losetup", "-d", self.loop)

    def fill(self):
        with contextlib.suppress(OSError), open(self.directory / "filler", "wb", buffering=0) as filler:
            while filler.write(b"\0" * 4096):
                pass

    def free(self):
        os.unlink(self.directory / "filler")

    def fail(self):
        self.forget_what_was_read()
        self.limit(SECTOR)

    def mend(self):
        self.limit(0)

    def limit(self, octets):
        """Limits the device to this many octets; 0: no limit."""
        device = os.open(self.loop, os.O_RDWR)
        status = bytearray(STATUS_BYTES)
        fcntl.ioctl(device, LOOP_GET_STATUS64, status, True)
        struct.pack_into("Q", status, SIZE_LIMIT_AT, octets)
        fcntl.ioctl(device, LOOP_SET_STATUS64, bytes(status))
        os.close(device)

    def forget_what_was_read(self):
        for path in filter(pathlib.Path.is_file, self.directory.rglob("*")):
            with open(path, "rb") as file:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)

    def damage(self, chance):
        """Damages the message store at one place, as memory cards lose data. No daemon may use it. Returns a description."""
        self.repair()
        path = chance.choice(sorted(path for path in (self.directory / "messages").iterdir() if path.stat().st_size > 0))
        octets = bytearray(path.read_bytes())
        way = chance.choice(["a zeroed page", "a zeroed sector", "a flipped bit", "a lost end"])
        at = chance.randrange(len(octets))
        if way == "a flipped bit":
            octets[at] ^= 1 << chance.randrange(8)
        elif way == "a lost end":
            del octets[at:]
        else:
            length = 512 if way == "a zeroed sector" else 4096
            at -= at % length
            octets[at:at + length] = bytes(len(octets[at:at + length]))
        path.write_bytes(octets)
        return f"{way} at {at} of {path.name}"


def succeeds(*command):
    with contextlib.suppress(FileNotFoundError):
        return subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False).returncode == 0
    return False
