# SPDX-License-Identifier: Apache-2.0
# A throw-away Debian that runs one command. Sourced by tests/system/run, which sets $work, $suite and $arch, together with
# container.sh or machine.sh. These define its content (extra_packages, tree_options) and how it boots (make_guest, boot).
# shellcheck shell=bash disable=SC2154

say() { printf '\n== %s\n' "$*" >&2; }
die() { printf './dev system-test: %s\n' "$*" >&2; exit 1; }

guest_packages=systemd,systemd-sysv,dbus,kmod,procps,iproute2,python3,openssl,mosquitto,mosquitto-clients

# make_guest_tree NAME: the tree that every guest is a copy of, with our packages' dependencies ready for an offline
# installation.
make_guest_tree() {
  tree=$work/$1-$suite
  # shellcheck disable=SC2016 # "$1" is mmdebstrap's
  packaging/debian-tree "$tree" "$suite" "$arch" "$(cat tests/system/guest/job{,.service} | sha256sum)" \
    --include="$guest_packages$extra_packages" "${tree_options[@]}" \
    --customize-hook='upload tests/system/guest/job /usr/local/sbin/job' \
    --customize-hook='chmod 755 "$1/usr/local/sbin/job"' \
    --customize-hook='upload tests/system/guest/job.service /etc/systemd/system/job.service' \
    --customize-hook='chroot "$1" systemctl -q enable job' \
    --customize-hook='chroot "$1" systemctl -q mask apt-daily.timer apt-daily-upgrade.timer systemd-firstboot' \
    --customize-hook='mkdir -p "$1/var/log/journal" "$1/job"; : >"$1/etc/machine-id"; echo guest >"$1/etc/hostname"' \
    --customize-hook='printf "127.0.0.1 localhost guest\n::1 localhost\n" >"$1/etc/hosts"'
  rm -rf "$tree/root/debs"
  mkdir "$tree/root/debs"
  cp "$work"/debs/*.deb "$work"/debs/more/*.deb "$tree/root/debs/"
  fetch_dependencies || { chroot "$tree/root" apt-get -qq update && fetch_dependencies; } ||
    die "the packages' dependencies can't be fetched"
  rm -rf "$tree/root/debs"
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
  make_guest "$guest"
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
    echo "the guest did not finish; its console is in $guest/console" >&2
  fi
  return "$status"
}
