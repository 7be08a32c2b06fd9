# SPDX-License-Identifier: Apache-2.0
# The guest of guest.sh as a virtual machine (QEMU): Debian's own kernel, with modules, udev, USB and 802.15.4. Emulated
# where the processor can't help.
# shellcheck shell=bash disable=SC2034,SC2154

extra_packages=,linux-image-$(dpkg --print-architecture),initramfs-tools,udev,wpan-tools
# What its initial file system loads: the disk, and the directory that it shares with us.
# shellcheck disable=SC2016 # "$1" is mmdebstrap's
tree_options=(
  --essential-hook='mkdir -p "$1"/usr/share/initramfs-tools/conf.d "$1"/usr/share/initramfs-tools/modules.d'
  --essential-hook='echo MODULES=list >"$1/usr/share/initramfs-tools/conf.d/guest"'
  --essential-hook='printf "%s\n" virtio_pci virtio_blk ext4 9pnet_virtio >"$1/usr/share/initramfs-tools/modules.d/guest"'
  --customize-hook='echo "job /job 9p trans=virtio,version=9p2000.L,msize=262144 0 0" >>"$1/etc/fstab"')
guest_limit_s=3600

prepare_guests() {
  [ "$(dpkg --print-architecture)" = amd64 ] || die "--vm works on amd64 only"
  make_guest_tree machine
  say "making the machine's disk"
  rm -f "$work/machine.disk"
  truncate -s 6G "$work/machine.disk"
  mke2fs -q -t ext4 -E lazy_itable_init=1 -d "$tree/root" "$work/machine.disk"
}

# The disk is shared: QEMU keeps each run's changes to itself.
make_guest() { :; }

# /dev/kvm alone proves nothing: in some virtual machines it is there and slower than emulation.
accelerator() {
  if [ -w /dev/kvm ] && grep -qwE 'vmx|svm' /proc/cpuinfo; then
    echo '-accel kvm -cpu host'
  else
    echo '-accel tcg -cpu Nehalem'
  fi
}

# boot MACHINE DIRECTORY: until it is switched off, or the time limit is reached.
boot() {
  local kernel=("$tree"/root/boot/vmlinuz-*) initrd=("$tree"/root/boot/initrd.img-*)
  # shellcheck disable=SC2046 # options
  timeout --kill-after=20 "$guest_limit_s" qemu-system-x86_64 -name "$1" -machine pc $(accelerator) -smp 2 -m 1024 \
    -nodefaults -nic none -display none -serial "file:$2/console" \
    -kernel "${kernel[0]}" -initrd "${initrd[0]}" \
    -append 'console=ttyS0 root=/dev/vda rw quiet mitigations=off random.trust_cpu=on no_timer_check panic=5' \
    -drive "file=$work/machine.disk,if=virtio,format=raw,snapshot=on,cache=unsafe" \
    -device virtio-rng-pci -virtfs "local,path=$2/job,mount_tag=job,security_model=none" </dev/null || true
}
