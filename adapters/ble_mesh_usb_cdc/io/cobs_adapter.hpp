// SPDX-License-Identifier: Apache-2.0
// The I/O shell of a board that only streams COBS frames. Loop's thread only.
#pragma once

#include "adapters/ble_mesh_usb_cdc/cobs/cobs_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/io/serial_shell.hpp"

namespace slamgw::ble {

class CobsAdapter final : public SerialShell<BleShell<CobsMesh>> {
 public:
  /// Arguments as for BoardAdapter, without those for files.
  CobsAdapter(boost::asio::io_context& io, const Settings& settings, TopicScheme topics,
              RobotNames names, MeshListener& listener, OpenPort open_port = {})
      : SerialShell(std::move(open_port), settings, io,
                    Made{std::make_unique<CobsMesh>(settings, std::move(topics), std::move(names))},
                    listener) {}

 private:
  void perform(CobsAction& action) override {
    std::visit(overloaded{
                   [this](WriteSerial& serial) { perform_on_port(serial); },
                   [this](MeshEvent& event) { listener().on_mesh_event(std::move(event)); },
               },
               action);
  }
};

}  // namespace slamgw::ble
