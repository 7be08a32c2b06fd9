// SPDX-License-Identifier: Apache-2.0
#include "daemon/runtime/descriptor_store.hpp"

#include <systemd/sd-daemon.h>

#include <cstdlib>

namespace slamgw {

DescriptorStore::DescriptorStore() {
  char** names = nullptr;
  const int count = sd_listen_fds_with_names(1 /* unset the environment */, &names);
  for (int i = 0; i < count; ++i) {
    taken_over_.emplace(names[i], OwnedFile(SD_LISTEN_FDS_START + i));  // closes a second of a name
    free(names[i]);
  }
  free(names);
}

int DescriptorStore::take(const std::string& name) {
  auto kept = taken_over_.extract(name);
  return kept ? kept.mapped().release() : -1;
}

void DescriptorStore::drop_rest() {
  if (taken_over_.empty()) return;
  for (const auto& [name, descriptor] : taken_over_) drop(name);
  taken_over_.clear();
  sd_notify_barrier(0, std::chrono::microseconds(drop_patience).count());
}

void DescriptorStore::keep(const std::string& name, int descriptor) {
  drop(name);
  // FDPOLL=0: systemd keeps the socket in spite of an error on it.
  const std::string message = "FDSTORE=1\nFDPOLL=0\nFDNAME=" + name;
  sd_pid_notify_with_fds(0, 0, message.c_str(), &descriptor, 1);
}

void DescriptorStore::drop(const std::string& name) {
  sd_notify(0, ("FDSTOREREMOVE=1\nFDNAME=" + name).c_str());
}

}  // namespace slamgw
