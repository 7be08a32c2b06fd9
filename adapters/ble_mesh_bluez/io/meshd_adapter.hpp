// SPDX-License-Identifier: Apache-2.0
// The I/O shell of the BLE mesh behind bluetooth-meshd: D-Bus with MeshdMesh behind it. Loop's
// thread only.
#pragma once

#include <cassert>
#include <memory>
#include <string>
#include <utility>

#include "adapters/ble_mesh_bluez/io/meshd_bus.hpp"
#include "adapters/ble_mesh_bluez/meshd_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/io/ble_mesh_shell.hpp"
#include "adapters/ble_mesh_usb_cdc/io/ble_shell.hpp"

namespace slamgw::ble {

class MeshdShell : public BleShell<MeshdMesh> {
 protected:
  MeshdShell(boost::asio::io_context& io, const Settings& settings, Made made,
             MeshListener& listener, std::string bus_address)
      : BleShell(io, std::move(made), listener),
        bus_(io, std::move(bus_address),
             settings.provisioning.static_oob ? parse_uuid(*settings.provisioning.static_oob)
                                              : std::nullopt,
             [this](MeshdEvent event) { driver()->on_meshd(event, read_clocks()); }) {}

  MeshdBus& bus() { return bus_; }
  /// MeshdRadio has no serial port.
  void perform_on_link(const auto&) { assert(false); }

 private:
  void open() override { bus_.open(); }
  void close() override { bus_.close(); }

  MeshdBus bus_;
};

class MeshdAdapter final : public BleMeshShell<MeshdShell> {
 public:
  /// As BleMeshShell; `bus_address` as for MeshdBus.
  MeshdAdapter(boost::asio::io_context& io, const Settings& settings, TopicScheme topics,
               RobotNames names, const std::string& store_directory, SessionStore& sessions,
               MeshListener& listener, std::string bus_address = {})
      : BleMeshShell(store_directory, sessions, io, settings,
                     make(settings, std::move(topics), std::move(names), store_directory), listener,
                     std::move(bus_address)) {}

 private:
  static Made make(const Settings& settings, TopicScheme topics, RobotNames names,
                   const std::string& store_directory) {
    LoadedMesh loaded = load_mesh(store_directory, settings);
    return {std::make_unique<MeshdMesh>(settings, std::move(topics), std::move(names),
                                        loaded.database, fill_random),
            std::move(loaded.problem)};
  }
  void perform(MeshdAction& action) override {
    std::visit(overloaded{
                   [this](MeshdRequest& request) { bus().perform(request); },
                   [this](MeshAction& shared) { perform_shared(shared); },
               },
               action);
  }
};

}  // namespace slamgw::ble
