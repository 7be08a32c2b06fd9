// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/will.hpp"

namespace slamgw::ble {
namespace {

std::string with_id(std::string text, std::string_view id) {
  constexpr std::string_view mark = "{id}";
  for (std::size_t at = text.find(mark); at != std::string::npos;
       at = text.find(mark, at + id.size()))
    text.replace(at, mark.size(), id);
  return text;
}

}  // namespace

Report will_report(const WillSettings& will, std::string_view robot) {
  return {.mesh = Mesh::ble,
          .robot = std::string(robot),
          .topic = with_id(will.topic, robot),
          .payload = to_bytes(will.message),
          .qos = Qos::at_least_once,
          .retain = false,
          .receipt = {Mesh::ble, 0},
          .is_will = true};
}

}  // namespace slamgw::ble
