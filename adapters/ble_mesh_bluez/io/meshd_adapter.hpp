// SPDX-License-Identifier: Apache-2.0
// The I/O shell of the BLE mesh behind bluetooth-meshd: D-Bus with MeshdMesh behind it. Loop's
// thread only.
#pragma once

#include <cassert>
#include <string>
#include <utility>

#include "adapters/ble_mesh_bluez/io/meshd_bus.hpp"
#include "adapters/ble_mesh_bluez/meshd_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/io/ble_mesh_shell.hpp"

namespace slamgw::ble {

class MeshdAdapter final : public BleMeshShell<MeshdMesh> {
 public:
  /// Arguments as for BleMeshShell; `bus_address` as for MeshdBus.
  MeshdAdapter(boost::asio::io_context& io, const Settings& settings, TopicScheme topics,
               RobotNames names, const std::string& store_directory, SessionStore& sessions,
               MeshListener& listener, std::string bus_address = {})
      : BleMeshShell(io, settings, std::move(topics), std::move(names), store_directory, sessions,
                     listener, fill_random),
        bus_(io, std::move(bus_address),
             settings.provisioning.static_oob ? parse_uuid(*settings.provisioning.static_oob)
                                              : std::nullopt,
             [this](MeshdEvent event) { driver()->on_meshd(event, read_clocks()); }) {}

 private:
  void open() override { bus_.open(); }
  void close() override { bus_.close(); }
  void perform(MeshdAction& action) override {
    std::visit(overloaded{
                   [this](MeshdRequest& request) { bus_.perform(request); },
                   [this](MeshAction& shared) {
                     perform_shared(shared, [](const auto&) { assert(false); });  // no serial port
                   },
               },
               action);
  }

  MeshdBus bus_;
};

}  // namespace slamgw::ble
