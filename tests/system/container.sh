# SPDX-License-Identifier: Apache-2.0
# The guest of guest.sh as a container (systemd-nspawn): systemd as process 1, on this machine's kernel.
# shellcheck shell=bash disable=SC2034,SC2154

extra_packages='' tree_options=()
guest_limit_s=900

prepare_guests() { make_guest_tree tree; }

make_guest() { cp -a "$tree/root" "$1/root"; } # directory

# boot MACHINE DIRECTORY: runs until it is switched off, or the time limit is reached. A second SIGTERM ends it at once.
boot() {
  local options=(--quiet --machine="$1" --directory="$2/root" --bind="$2/job:/job" --private-network --boot
    --link-journal=no --resolv-conf=off --timezone=off --register=no --console=read-only
    # for the parts of a unit's confinement that are BPF programs: DeviceAllow=, IPAddressDeny=
    --capability=CAP_BPF,CAP_PERFMON --system-call-filter=bpf)
  local groups=() group
  if [ ! -d /run/systemd/system ]; then
    # Without systemd here, the container gets a control group below ours, in each hierarchy.
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
    # Kills a guest that exceeded the time limit: only the processes of its own control group.
    find "$group" -name cgroup.procs -exec cat {} + 2>/dev/null | xargs -r kill -KILL 2>/dev/null || true
    for _ in 1 2 3 4 5; do
      find "$group" -depth -type d -exec rmdir {} \; 2>/dev/null || true
      [ -d "$group" ] || break
      sleep 0.2
    done
  done
  rmdir "/run/systemd/nspawn/propagate/$1" 2>/dev/null || true
}
