// SPDX-License-Identifier: Apache-2.0
// The I/O shell of the BLE mesh: one serial port, opened again and again until it is there, and
// BleMesh or CobsMesh behind it. A missing board is a state, not a failure. Loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/io/command_file.hpp"
#include "adapters/ble_mesh_usb_cdc/io/mesh_file.hpp"
#include "adapters/ble_mesh_usb_cdc/io/serial_line.hpp"
#include "adapters/ble_mesh_usb_cdc/mesh_machine.hpp"
#include "daemon/core/adapter.hpp"
#include "daemon/core/burst.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/topic_scheme.hpp"
#include "daemon/runtime/mesh_shell.hpp"

namespace slamgw::ble {

class BleMesh;

class BleMeshAdapter final : public MeshShell<MeshMachine> {
 public:
  static constexpr Duration first_open_delay = std::chrono::milliseconds{500};
  static constexpr Duration max_open_delay = std::chrono::seconds{5};

  /// `listener` outlives the adapter. Reads `mesh.json` and, at start, `ble-commands.json` in
  /// `store_directory`. `open_port` opens the serial port in place of open_serial_port; it is
  /// called on a thread of its own.
  BleMeshAdapter(boost::asio::io_context& io, Settings settings, TopicScheme topics,
                 RobotNames names, std::string store_directory, MeshListener& listener,
                 OpenPort open_port = {});

  void start() override;
  void stop() override;
  /// `robots` of the configuration, read again. Robots stay in the mesh.
  void reconfigure(RobotNames names);
  /// What operators order about the mesh and its robots; `done` is called once, now or later, and
  /// never after stop().
  void manage(MeshOrder order, OrderDone done);

 private:
  MachineDriver<MeshMachine>& driver() override { return driver_; }
  const MachineDriver<MeshMachine>& driver() const override { return driver_; }
  void perform(MeshAction& action);
  void generate_keys();
  void on_keys_stored(const std::optional<MeshKeys>& keys, const std::string& problem);
  void store(NodeDatabase database);
  /// `write` runs on the disk's thread; `done` gets the problem that it returns, on the loop.
  void write_file(std::function<std::string()> write,
                  std::function<void(const std::string& problem)> done);
  void end_order(OrderEnded& ended);
  /// Tells the outcome of commands that an earlier daemon had under way.
  void end_interrupted_commands();
  void keep_commands();

  void open_after(Duration delay);
  void on_port_open();
  void on_port_failed(const std::string& why);
  void on_port_closed(const std::string& why);
  void on_close_stuck(const std::string& why);

  Settings settings_;
  MeshFile file_;
  CommandFile command_file_;
  std::string kept_commands_;              ///< what the file was last given
  bool is_keeping_commands_ = false;       ///< the file is being written
  bool are_commands_changed_ = false;      ///< since then
  bool is_command_problem_known_ = false;  ///< to the operator
  std::string problem_;                    ///< why the mesh stays off; empty when it does not
  MeshListener& listener_;
  std::unique_ptr<MeshMachine> mesh_;
  const BleMesh* robots_ = nullptr;  ///< `mesh_`, with protocol nordic-serial
  MachineDriver<MeshMachine> driver_;
  SerialLine line_;
  boost::asio::steady_timer timer_;  ///< the next attempt to open
  Duration open_delay_ = first_open_delay;
  Burst stuck_burst_{std::chrono::minutes{10}};  ///< a hung board is closed again and again
  bool is_stopped_ = true;
  std::map<std::uint64_t, OrderDone> orders_;
  std::uint64_t last_order_ = 0;
  /// Gone with the adapter: a completion that was under way must not touch it.
  std::shared_ptr<const int> alive_ = std::make_shared<int>();
  boost::asio::thread_pool disk_{1};  ///< writes mesh.json; last, so that it ends first
};

}  // namespace slamgw::ble
