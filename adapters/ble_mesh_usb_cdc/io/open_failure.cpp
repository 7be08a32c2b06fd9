// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/open_failure.hpp"

#include <fmt/format.h>

#include <cerrno>
#include <cstring>

namespace slamgw::ble {
namespace {

constexpr unsigned group_may = 0060;

/// As systemd's DeviceAllow= calls the kind of a node: /dev/ttyAMA0 is a char-ttyAMA.
std::string kind_of(const std::string& path) {
  const std::string name = path.substr(path.rfind('/') + 1);
  return "char-" + name.substr(0, name.find_last_not_of("0123456789") + 1);
}

std::string explain_denial(const std::string& path, const NodeAccess& access) {
  const bool is_for_group = (access.mode & group_may) == group_may && access.group != "root";
  if (!is_for_group)
    return fmt::format(
        "only its owner may use it (group {}, mode {:04o}): sudo chgrp dialout {} && "
        "sudo chmod g+rw {}",
        access.group, access.mode, path, path);
  return fmt::format("it is for the group {}: sudo adduser {} {}, then restart the daemon",
                     access.group, access.process, access.group);
}

}  // namespace

std::string explain_open_failure(const std::string& path, int error, const NodeAccess& access) {
  const auto explain = [&](const std::string& what_to_do) {
    return fmt::format("{} can't be opened: {}; {}", path, std::strerror(error), what_to_do);
  };
  switch (error) {
    case EACCES: return explain(explain_denial(path, access));
    case EPERM:
      return explain(
          fmt::format("the service's sandbox keeps it out: systemctl edit slam-gateway, "
                      "there [Service] and DeviceAllow={} rw, then restart",
                      kind_of(path)));
    case EBUSY:
    case EAGAIN:  // another program holds a flock()
      return fmt::format("{} is busy: another program has it open; sudo fuser -v {} shows which",
                         path, path);
    default: return explain("check its cable and ble_mesh.device");
  }
}

}  // namespace slamgw::ble
