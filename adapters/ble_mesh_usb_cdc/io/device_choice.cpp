// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/device_choice.hpp"

#include <fmt/format.h>

#include <algorithm>

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

/// A board in the wrong role is taken for a missing one unless its id is shown.
std::string list_others(const std::vector<UsbPort>& ports) {
  std::string list;
  for (const UsbPort& port : ports) {
    const bool is_thread = port.vendor == nordic_vendor && port.product == thread_product;
    list += fmt::format("{} {} {:04x}:{:04x}{}", list.empty() ? "; there is" : ",", port.path,
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

}  // namespace slamgw::ble
