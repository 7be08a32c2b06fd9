# SPDX-License-Identifier: Apache-2.0
# The Debian in which packages and tests are built for another architecture or release, and what this machine needs to run
# their programs. Sourced by packaging/build-deb, tests/emulated/run and tests/system/run, which have say and die.
# shellcheck shell=bash

# debian_of SUITE: prints the number of that Debian. Programs built for one do not run on another, whose libraries have other
# names, so the version of our packages ends with the number.
debian_of() {
  case $1 in
    bookworm) echo 12 ;;
    trixie) echo 13 ;;
    *) die "there is no Debian $1 here" ;;
  esac
}

# make_build_tree DIRECTORY SUITE ARCHITECTURE PROFILES: in DIRECTORY/root a Debian of this machine's architecture, with the
# compilers for ARCHITECTURE and the libraries that packaging/debian/control asks for with these build profiles. Becomes
# root by the command in as_root, an array.
make_build_tree() {
  local native tools=build-essential,ca-certificates,dpkg-dev,fakeroot,lintian architectures
  native=$(dpkg --print-architecture)
  architectures=$native
  if [ "$3" != "$native" ]; then
    tools+=,crossbuild-essential-$3
    architectures+=,$3
  fi
  # shellcheck disable=SC2016,SC2154 # "$1" is mmdebstrap's
  "${as_root[@]}" packaging/debian-tree "$1" "$2" "$architectures" "$(sha256sum <packaging/debian/control)" \
    --include="$tools" \
    --customize-hook='mkdir -p "$1/build/wanted/debian"' \
    --customize-hook='upload packaging/debian/control /build/wanted/debian/control' \
    --customize-hook="DEBIAN_FRONTEND=noninteractive chroot \"\$1\" \
      apt-get -y -qq build-dep --host-architecture $3 -P '$4' /build/wanted"
}

# run_programs_of ARCHITECTURE: has this machine's kernel run the programs of another architecture, through QEMU, as long
# as the machine is up.
run_programs_of() {
  local binfmt=/proc/sys/fs/binfmt_misc qemu
  case $1 in
    "$(dpkg --print-architecture)") return ;;
    arm64) qemu=qemu-aarch64 ;;
    armhf) qemu=qemu-arm ;;
    *) die "there is no machine of $1" ;;
  esac
  [ -e "$binfmt/register" ] || mount -t binfmt_misc binfmt_misc "$binfmt"
  [ -e "$binfmt/$qemu" ] || cat "/usr/lib/binfmt.d/$qemu.conf" >"$binfmt/register"
}
