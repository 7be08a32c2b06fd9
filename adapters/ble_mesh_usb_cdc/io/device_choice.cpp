// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/device_choice.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace slamgw::ble {

namespace {

constexpr std::uint16_t nordic_vendor = 0x1915;
constexpr std::uint16_t application_product = 0x520f;  // CDC ACM of Nordic's SDK
constexpr std::uint16_t boot_loader_product = 0x521f;
constexpr std::uint16_t thread_product = 0xcafe;  // OpenThread's co-processor

bool is_candidate(const UsbPort& port) {
  return port.vendor == jlink_vendor ||
         (port.vendor == nordic_vendor && port.product == application_product);
}

bool is_boot_loader(const UsbPort& port) {
  return port.vendor == nordic_vendor && port.product == boot_loader_product;
}

/// Lists the ports with their ids: without its id, a board in the wrong role seems missing.
std::string list_others(const std::vector<UsbPort>& ports) {
  std::string list;
  for (const UsbPort& port : ports) {
    const bool is_thread = port.vendor == nordic_vendor && port.product == thread_product;
    list += fmt::format("{} {} {:04x}:{:04x}{}", list.empty() ? "; attached:" : ",", port.path,
                        port.vendor, port.product, is_thread ? " (a Thread radio)" : "");
  }
  return list;
}

}  // namespace

Result<UsbPort, Refusal> choose_device(const std::vector<UsbPort>& ports) {
  std::vector<UsbPort> candidates;
  std::ranges::copy_if(ports, std::back_inserter(candidates), is_candidate);
  if (candidates.size() == 1) return candidates.front();
  if (candidates.size() > 1) {
    std::string list;
    for (const UsbPort& port : candidates)
      list += fmt::format("{}{} ({:04x}:{:04x}, serial number {})", list.empty() ? "" : ", ",
                          port.path, port.vendor, port.product, port.serial_number);
    return Refusal{fmt::format(
        "several serial boards are attached, set ble_mesh.device to one of them (best by its path "
        "under /dev/serial/by-id/): {}",
        list)};
  }
  const auto boot_loader = std::ranges::find_if(ports, is_boot_loader);
  if (boot_loader != ports.end())
    return Refusal{fmt::format("the board at {} waits in its boot loader: program it or reset it",
                               boot_loader->path)};
  return Refusal{
      fmt::format("no serial board is attached (looked for USB ids 1366:* and 1915:520f{}): plug "
                  "one in, or set "
                  "ble_mesh.device to its path",
                  list_others(ports))};
}

namespace {

constexpr unsigned group_may = 0060;

/// Returns the kind of a node as in systemd's DeviceAllow=: char-ttyAMA for /dev/ttyAMA0.
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
  return fmt::format("only group {} may use it: sudo adduser {} {}, then restart the daemon",
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
