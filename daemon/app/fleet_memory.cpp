// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/fleet_memory.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <boost/asio/post.hpp>

namespace slamgw {

bool FleetMemory::were_others_about() const { return ::access(path_.c_str(), F_OK) == 0; }

void FleetMemory::remember(bool are_others_about) {
  if (!disk_) disk_.emplace(1);
  boost::asio::post(*disk_, [path = path_, are_others_about] {
    if (!are_others_about) {
      ::unlink(path.c_str());
      return;
    }
    const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    if (file >= 0) ::close(file);
  });
}

void FleetMemory::stop() {
  if (disk_) disk_->join();
}

}  // namespace slamgw
