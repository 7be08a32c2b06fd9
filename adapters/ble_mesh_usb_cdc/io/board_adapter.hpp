// SPDX-License-Identifier: Apache-2.0
// The I/O shell of the BLE mesh behind Nordic's serial board: BleMesh on a BoardRadio, and its
// serial port. Loop's thread only.
#pragma once

#include <random>

#include "adapters/ble_mesh_usb_cdc/io/ble_mesh_shell.hpp"
#include "adapters/ble_mesh_usb_cdc/io/serial_shell.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"

namespace slamgw::ble {

class BoardAdapter final : public SerialShell<BleMeshShell> {
 public:
  /// Arguments as for BleMeshShell; `open_port` as for SerialShell.
  BoardAdapter(boost::asio::io_context& io, const Settings& settings, TopicScheme topics,
               RobotNames names, const std::string& store_directory, SessionStore& sessions,
               MeshListener& listener, OpenPort open_port = {})
      : SerialShell(
            std::move(open_port), settings, io, settings, std::move(topics), std::move(names),
            store_directory, sessions, listener, [&settings](const auto& database) {
              return std::make_unique<BoardRadio>(settings, database, fill_random, random_seed());
            }) {}

 private:
  static std::uint64_t random_seed() {
    std::random_device device;
    return std::uint64_t{device()} << 32 | device();
  }
  void perform(MeshAction& action) override {
    perform_shared(action, [this](const auto& on_port) { perform_on_port(on_port); });
  }
};

}  // namespace slamgw::ble
