# SPDX-License-Identifier: Apache-2.0
# The guest of guest.sh as a virtual machine (QEMU): Debian's own kernel, with modules, udev, USB and 802.15.4. Emulated
# without KVM: then its clock counts its instructions (4 ns each, 250 millions in a second) while it works. So nothing in it times
# out because this machine is slow or busy. It is booted once; memory and devices are kept, and each run begins there, with a disk of
# its own on top.
# shellcheck shell=bash disable=SC2034,SC2054,SC2154

extra_packages=,linux-image-$arch,initramfs-tools,udev,wpan-tools,sudo,adduser
machine=machine-$arch
if [ "$machine_steps" = bluez_steps ]; then
  machine=machine-bluez-$arch
  extra_packages+=,bluez,bluez-meshd,bluez-test-tools,python3-dbus,python3-gi
fi
# Modules of its initial file system: the disk, and the directory that it shares with the host.
# shellcheck disable=SC2016 # "$1" is mmdebstrap's
tree_options=(
  --essential-hook='mkdir -p "$1"/usr/share/initramfs-tools/conf.d "$1"/usr/share/initramfs-tools/modules.d'
  --essential-hook='echo MODULES=list >"$1/usr/share/initramfs-tools/conf.d/guest"'
  --essential-hook='printf "%s\n" virtio_pci virtio_blk ext4 9pnet_virtio >"$1/usr/share/initramfs-tools/modules.d/guest"')
guest_limit_s=14400
boot_limit_s=3600

prepare_guests() {
  run_programs_of "$arch"
  make_guest_tree "$machine"
  choose_machine
  local begins_as
  begins_as=$({
    cat "$tree/made-of"
    ls "$tree/root/var/cache/apt/archives"
    "${qemu[0]}" --version
    echo "${qemu[*]}"
  } | sha256sum)
  [ "$(cat "$tree/begins-as" 2>/dev/null)" != "$begins_as" ] || return 0
  rm -f "$tree/begins-as"
  make_disk
  keep_booted_machine
  echo "$begins_as" >"$tree/begins-as"
}

# Sets qemu, the command, and job_port, the port for a plugged-in device.
choose_machine() {
  local processor console kernel=("$tree"/root/boot/vmlinuz-*) initrd=("$tree"/root/boot/initrd.img-*)
  case $arch in
    amd64)
      qemu=(qemu-system-x86_64 -machine pc)
      processor=Nehalem console=ttyS0 job_port=''
      ;;
    arm64)
      qemu=(qemu-system-aarch64 -machine virt -device "pcie-root-port,id=job-port,chassis=1")
      processor=cortex-a72 console=ttyAMA0 job_port=job-port
      ;;
    *) die "there is no machine of $arch" ;;
  esac
  # /dev/kvm alone is not enough: in some virtual machines it exists, but is slower than emulation.
  if [ "$arch" = "$(dpkg --print-architecture)" ] && [ -w /dev/kvm ] && grep -qwE 'vmx|svm' /proc/cpuinfo; then
    qemu+=(-accel kvm -cpu host -smp 2)
  else
    qemu+=(-accel tcg -cpu "$processor" -smp 1 -icount shift=2)
  fi
  qemu+=(-m 1024 -nodefaults -nic none -display none -serial file:console -qmp unix:monitor,server=on,wait=off
    -kernel "${kernel[0]}" -initrd "${initrd[0]}"
    -append "console=$console root=/dev/vda rw quiet mitigations=off random.trust_cpu=on no_timer_check panic=5"
    -device virtio-rng-pci)
}

make_disk() {
  say "making the machine's disk"
  rm -f "$tree/disk"
  truncate -s 6G "$tree/disk"
  mke2fs -q -t ext4 -E lazy_itable_init=1 -d "$tree/root" "$tree/disk"
}

keep_booted_machine() {
  say "booting the machine"
  rm -f "$tree/console"
  (cd "$tree" && exec timeout "$boot_limit_s" "${qemu[@]}" \
    -drive "file=$tree/disk,if=virtio,format=raw,cache=unsafe") </dev/null &
  until grep -aq 'waits for its job' "$tree/console" 2>/dev/null; do
    kill -0 $! 2>/dev/null || die "the machine does not boot; its console is in $tree/console"
    sleep 0.5
  done
  tests/system/monitor "$tree" save "$tree/state"
  wait $!
}

make_guest() { qemu-img create -q -f qcow2 -F raw -b "$tree/disk" "$1/disk"; } # directory

# start_machine MACHINE DIRECTORY [option...]: starts it in the background. Like a real disk's cache, QEMU keeps writes in
# memory until the guest flushes them.
start_machine() {
  local machine=$1 directory=$2
  shift 2
  (cd "$directory" && exec timeout --kill-after=20 "$guest_limit_s" "${qemu[@]}" -name "$machine" -pidfile pid \
    -drive file=disk,if=virtio,format=qcow2,cache=writeback \
    -fsdev "local,id=job,path=$directory/job,security_model=none" "$@") </dev/null &
}

# boot MACHINE DIRECTORY: runs until it is switched off, or the time limit is reached. A guest that creates the file
# /job/power-cut loses its power, and is booted from its disk.
boot() {
  start_machine "$@" -incoming "exec:cat '$tree/state'"
  # shellcheck disable=SC2086 # a word or none
  tests/system/monitor "$2" give-job $job_port || kill $!
  while kill -0 $! 2>/dev/null; do
    if [ -e "$2/job/power-cut" ]; then
      kill -KILL "$(cat "$2/pid")"
      wait $! 2>/dev/null || true
      rm "$2/job/power-cut"
      start_machine "$@" -device virtio-9p-pci,fsdev=job,mount_tag=job
    fi
    sleep 0.2
  done
  rm "$2/disk"
}
