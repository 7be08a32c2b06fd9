// SPDX-License-Identifier: Apache-2.0
// Descriptors that outlive the process: systemd keeps duplicates of them (FileDescriptorStoreMax=
// in systemd.service(5)) and hands them to the process that it starts next, after a crash too. What
// comes to a socket meanwhile waits in the kernel. Without systemd nothing is kept. Loop's thread
// only.
#pragma once

#include <chrono>
#include <map>
#include <string>

namespace slamgw {

class DescriptorStore {
 public:
  /// Takes over what was kept of the process before (sd_listen_fds(3)), so once in a process.
  DescriptorStore();
  ~DescriptorStore();
  DescriptorStore(const DescriptorStore&) = delete;
  DescriptorStore& operator=(const DescriptorStore&) = delete;

  /// The descriptor that was kept under this name, from now on the caller's; -1 when there is none.
  int take(const std::string& name);
  /// Closes those that were not taken, for good. Waits until systemd has closed them too, so that
  /// their ports are free; at most for drop_patience.
  void drop_rest();
  static constexpr std::chrono::seconds drop_patience{5};

  /// From now on `descriptor` is kept under `name` (sd_pid_notify_with_fds(3) says which names can
  /// be), in place of any other. The caller may close it before drop(): with epoll only after
  /// removing it there, because its open file goes on.
  void keep(const std::string& name, int descriptor);
  void drop(const std::string& name);

 private:
  std::map<std::string, int> taken_over_;
};

}  // namespace slamgw
