# SPDX-License-Identifier: Apache-2.0
# A Debian that systemd boots as process 1, in a container (systemd-nspawn). Sourced by tests/system/run, which sets
# $work.
# shellcheck shell=bash disable=SC2154

say() { printf '\n== %s\n' "$*" >&2; }
die() { printf './dev system-test: %s\n' "$*" >&2; exit 1; }

guest_packages=systemd,systemd-sysv,dbus,kmod,procps,iproute2,python3,mosquitto,mosquitto-clients
guest_limit_s=900

# make_guest_tree SUITE: the tree that every guest is a copy of, with what our packages depend on ready to be installed
# offline.
make_guest_tree() {
  tree=$work/tree-$1
  # shellcheck disable=SC2016 # "$1" is mmdebstrap's
  packaging/debian-tree "$tree" "$1" "$(dpkg --print-architecture)" "$(sha256sum <tests/system/guest/job.service)" \
    --include="$guest_packages" \
    --customize-hook='upload tests/system/guest/job.service /etc/systemd/system/job.service' \
    --customize-hook='chroot "$1" systemctl -q enable job' \
    --customize-hook='chroot "$1" systemctl -q mask apt-daily.timer apt-daily-upgrade.timer systemd-firstboot' \
    --customize-hook='mkdir -p "$1/var/log/journal" "$1/job"; : >"$1/etc/machine-id"; echo guest >"$1/etc/hostname"' \
    --customize-hook='printf "127.0.0.1 localhost guest\n::1 localhost\n" >"$1/etc/hosts"'
  rm -rf "$tree/root/debs"
  mkdir "$tree/root/debs"
  cp "$work"/debs/*.deb "$tree/root/debs/"
  fetch_dependencies || { chroot "$tree/root" apt-get -qq update && fetch_dependencies; } ||
    die "what the packages depend on can't be fetched"
}

fetch_dependencies() {
  cp /etc/resolv.conf "$tree/root/etc/resolv.conf"
  chroot "$tree/root" sh -c 'exec apt-get -q -y install --download-only /debs/*.deb' >"$work/fetch.log" 2>&1
}

# run_in_guest NAME DEBS FILES COMMAND...: boots a fresh copy of the tree, runs the command there as root with DEBS in
# /job/input/debs and the directory FILES in /job/input/<its name>, prints its output, and returns its exit status.
run_in_guest() {
  local name=$1 guest=$work/$1
  rm -rf "$guest"
  mkdir -p "$guest/job/input"
  cp -a "$tree/root" "$guest/root"
  cp -r "$2" "$guest/job/input/debs"
  cp -r "$3" "$guest/job/input/"
  shift 3
  printf '#!/bin/sh\nexec%s\n' "$(printf ' %q' "$@")" >"$guest/job/program"
  chmod 755 "$guest/job" "$guest/job/program"
  : >"$guest/job/log"
  tail -n +1 -f "$guest/job/log" &
  local follower=$! status=1
  boot "slamgw-$name-$$" "$guest"
  sleep 0.3 # for the last lines
  kill "$follower"
  rm -rf "$guest/root"
  if [ -s "$guest/job/status" ]; then
    status=$(cat "$guest/job/status")
  else
    echo "the guest came to no end; its console is in $guest/console" >&2
  fi
  return "$status"
}

# boot MACHINE DIRECTORY: until it is switched off, or the time limit is reached. A second SIGTERM ends it at once.
boot() {
  local options=(--quiet --machine="$1" --directory="$2/root" --bind="$2/job:/job" --private-network --boot
    --link-journal=no --resolv-conf=off --timezone=off --register=no --console=read-only
    # for what of a unit's confinement is a BPF program: DeviceAllow=, IPAddressDeny=
    --capability=CAP_BPF,CAP_PERFMON --system-call-filter=bpf)
  local groups=() group
  if [ ! -d /run/systemd/system ]; then
    # Nobody here gives the container a control group: it gets one below ours, in each hierarchy.
    options+=(--keep-unit)
    for group in /sys/fs/cgroup/unified /sys/fs/cgroup/systemd /sys/fs/cgroup; do
      [ -e "$group/cgroup.procs" ] && mkdir -p "$group/$1" && groups+=("$group/$1")
    done
  fi
  (
    for group in "${groups[@]}"; do echo "$BASHPID" >"$group/cgroup.procs"; done
    export SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=1
    exec timeout --kill-after=20 "$guest_limit_s" systemd-nspawn "${options[@]}"
  ) </dev/null >"$2/console" 2>&1 || true
  for group in "${groups[@]}"; do
    # A guest that outlived the time limit: the processes of its own control group, nobody else's.
    find "$group" -name cgroup.procs -exec cat {} + 2>/dev/null | xargs -r kill -KILL 2>/dev/null || true
    for _ in 1 2 3 4 5; do
      find "$group" -depth -type d -exec rmdir {} \; 2>/dev/null || true
      [ -d "$group" ] || break
      sleep 0.2
    done
  done
  rmdir "/run/systemd/nspawn/propagate/$1" 2>/dev/null || true
}
