// SPDX-License-Identifier: Apache-2.0
// The I/O shell of the BLE mesh behind bluetooth-meshd: BleMesh on a MeshdRadio, which it
// connects to D-Bus. Loop's thread only.
#pragma once

#include <cassert>
#include <string>
#include <utility>

#include "adapters/ble_mesh_bluez/io/meshd_bus.hpp"
#include "adapters/ble_mesh_bluez/meshd_radio.hpp"
#include "adapters/ble_mesh_usb_cdc/io/ble_mesh_shell.hpp"

namespace slamgw::ble {

class MeshdAdapter final : public BleMeshShell {
 public:
  /// Arguments as for BleMeshShell; `bus_address` as for MeshdBus.
  MeshdAdapter(boost::asio::io_context& io, const Settings& settings, TopicScheme topics,
               RobotNames names, const std::string& store_directory, SessionStore& sessions,
               MeshListener& listener, std::string bus_address = {})
      : BleMeshShell(io, settings, std::move(topics), std::move(names), store_directory, sessions,
                     listener,
                     [&settings](const auto& database) {
                       return std::make_unique<MeshdRadio>(settings, database, fill_random);
                     }),
        bus_(io, std::move(bus_address),
             settings.provisioning.static_oob ? parse_uuid(*settings.provisioning.static_oob)
                                              : std::nullopt,
             [this](MeshdEvent event) { on_event(event, read_clocks()); }) {}

 private:
  void open() override { bus_.open(); }
  void close() override { bus_.close(); }
  void perform(MeshAction& action) override {
    perform_shared(action, [](const auto&) { assert(false); });  // no serial port
  }
  void on_event(MeshdEvent& event, TimePoint now) {
    radio().on_event(event, now);
    driver()->settle(now);
  }
  void on_drained() override {
    while (const auto request = radio().next_request()) bus_.perform(*request);
    BleMeshShell::on_drained();
  }
  MeshdRadio& radio() const { return static_cast<MeshdRadio&>(machine().radio()); }

  MeshdBus bus_;
};

}  // namespace slamgw::ble
