// SPDX-License-Identifier: Apache-2.0
// Descriptors that outlive the process: systemd keeps duplicates of them (FileDescriptorStoreMax=
// in systemd.service(5)) and hands them to the process that it starts next, after a crash too.
// Packets that come to a socket in between wait in the kernel. Without systemd nothing is kept.
// Loop's thread only.
#pragma once

#include <chrono>
#include <map>
#include <string>

#include "daemon/runtime/owned_file.hpp"

namespace slamgw {

class DescriptorStore {
 public:
  /// Takes over the kept descriptors of the process before (sd_listen_fds(3)). Construct it once in
  /// a process.
  DescriptorStore();

  /// Returns the descriptor that was kept under this name, which the caller then owns; -1 when
  /// there is none.
  int take(const std::string& name);
  /// Closes the descriptors that were not taken, for good. Waits until systemd has closed them too,
  /// so that their ports are free; at most for drop_patience.
  void drop_rest();
  static constexpr std::chrono::seconds drop_patience{5};

  /// Keeps `descriptor` under `name` in place of any other (sd_pid_notify_with_fds(3) has the rules
  /// for names). The caller may close it before drop(), but must first remove it from epoll,
  /// because the open file lives on.
  void keep(const std::string& name, int descriptor);
  void drop(const std::string& name);

 private:
  std::map<std::string, OwnedFile> taken_over_;
};

}  // namespace slamgw
