// SPDX-License-Identifier: Apache-2.0
// The I/O shell of the BLE mesh: the serial port with BoardMesh behind it, the file with its nodes,
// the open commands of its robots, and what operators order. Loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/io/mesh_file.hpp"
#include "adapters/ble_mesh_usb_cdc/io/serial_shell.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/board_mesh.hpp"
#include "daemon/core/session_store.hpp"

namespace slamgw::ble {

class BleMeshAdapter final : public SerialShell<BoardMesh> {
 public:
  /// `sessions` and `listener` outlive the adapter. Reads `mesh.json` in `store_directory` and, at
  /// start, the open commands of robots in `sessions`. `open_port` as for SerialShell.
  BleMeshAdapter(boost::asio::io_context& io, const Settings& settings, TopicScheme topics,
                 RobotNames names, const std::string& store_directory, SessionStore& sessions,
                 MeshListener& listener, OpenPort open_port = {});

  void start() override;
  void stop() override;
  /// What operators order about the mesh and its robots; `done` is called once, now or later, and
  /// never after stop().
  void manage(BleOrder order, OrderDone done);
  /// In a mesh that several gateways share: `may_serve` and `on_heard` are called for each message.
  /// Before start().
  using OnHeard = std::function<void(const HeardRobot& heard)>;
  void share_with(ServiceGate::MayServe may_serve, OnHeard on_heard);
  bool is_shared() const { return machine().is_shared(); }
  void on_session_held(const std::string& robot) override;
  /// Of `ble_mesh.relay`.
  void on_robot_message(const BrokerMessage& message);

 private:
  static Made make(const Settings& settings, TopicScheme topics, RobotNames names,
                   const MeshFile& file);
  void perform(MeshAction& action) override;
  void generate_keys(const GenerateKeys& wanted);
  void on_keys_made(const GenerateKeys& wanted, const std::optional<MeshKeys>& keys,
                    const std::string& problem);
  void store(NodeDatabase database);
  /// `write` runs on the disk's thread; `done` gets the problem that it returns, on the loop.
  void write_file(std::function<std::string()> write,
                  std::function<void(const std::string& problem)> done);
  void end_order(OrderEnded& ended);
  /// Reports the outcome of commands that an earlier daemon had under way.
  void end_interrupted_commands();
  void keep_commands();

  OnHeard on_heard_ = [](const HeardRobot&) {};
  MeshFile file_;
  SessionStore& sessions_;
  std::map<std::string, OpenCommands> kept_commands_;  ///< by robot, as given to `sessions_`
  std::map<std::uint64_t, OrderDone> orders_;
  std::uint64_t last_order_ = 0;
  /// Expires with the adapter, so that a completion that comes later does not touch it.
  std::shared_ptr<const int> alive_ = std::make_shared<int>();
  boost::asio::thread_pool disk_{1};  ///< writes mesh.json; last, so that it ends first
};

}  // namespace slamgw::ble
