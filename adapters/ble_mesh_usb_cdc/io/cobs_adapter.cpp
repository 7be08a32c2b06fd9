// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/cobs_adapter.hpp"

#include <utility>

namespace slamgw::ble {
namespace {

std::string problem_of(const Settings& settings) {
  return settings.cobs_content == CobsContent::positions && !settings.robot_id
             ? "ble_mesh.robot_id is not set: positions do not say whose they are"
             : "";
}

}  // namespace

CobsAdapter::CobsAdapter(boost::asio::io_context& io, const Settings& settings, TopicScheme topics,
                         RobotNames names, MeshListener& listener, OpenPort open_port)
    : SerialShell(io, settings,
                  {std::make_unique<CobsMesh>(settings, std::move(topics), std::move(names)),
                   problem_of(settings)},
                  listener, std::move(open_port)) {}

void CobsAdapter::perform(CobsAction& action) {
  std::visit(overloaded{
                 [this](WriteSerial& serial) { write(serial); },
                 [this](MeshEvent& event) { listener().on_mesh_event(std::move(event)); },
             },
             action);
}

}  // namespace slamgw::ble
