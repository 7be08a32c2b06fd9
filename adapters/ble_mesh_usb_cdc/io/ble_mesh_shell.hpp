// SPDX-License-Identifier: Apache-2.0
// The part of the BLE mesh's I/O shell that all radios share: the file with the nodes, the open
// commands of robots, and the operators' orders. Loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/io/ble_shell.hpp"
#include "adapters/ble_mesh_usb_cdc/io/mesh_file.hpp"
#include "daemon/core/session_store.hpp"
#include "daemon/runtime/machine_driver.hpp"

namespace slamgw::ble {

class BleMeshShell : public BleShell<BleMesh> {
 public:
  void start() override {
    end_interrupted_commands();
    driver()->begin_tids_after(static_cast<std::uint8_t>(std::random_device{}()));
    BleShell::start();
  }
  void stop() override {
    BleShell::stop();
    orders_.clear();
    disk_.join();
    // Writes changes since the last write began, such as the key of a robot that just joined.
    if (const NodeDatabase* unsaved = machine().unsaved()) file_.write(*unsaved);
  }
  bool is_settled() const override { return machine().is_settled(); }
  /// Carries out an operator's order about the mesh or its robots. `done` is called at most once,
  /// now or later, and never after stop().
  void manage(const BleOrder& order, OrderDone done) {
    if (is_stopped()) return done({{}, "slam-gatewayd is stopping"});
    if (!problem().empty()) return done({{}, problem()});
    const std::uint64_t id = ++last_order_;
    orders_.emplace(id, std::move(done));
    driver()->on_order(id, order, read_clocks());
  }
  using OnHeard = std::function<void(const HeardRobot& heard)>;
  /// Call before start(). In a mesh that several gateways share, `may_serve` and `on_heard` are
  /// called for each message.
  void share_with(ServiceGate::MayServe may_serve, OnHeard on_heard) {
    on_heard_ = std::move(on_heard);
    driver()->ask_who_serves(std::move(may_serve));
  }
  bool is_shared() const { return machine().is_shared(); }
  void on_session_held(const std::string& robot) override {
    driver()->on_session_held(robot, read_clocks());
  }
  /// Takes a robot's message for `ble_mesh.relay`.
  void on_robot_message(const BrokerMessage& message) {
    if (!is_stopped()) driver()->on_robot_message(message, read_clocks());
  }

 protected:
  /// Makes the radio of the mesh with this database.
  using MakeRadio = std::function<std::unique_ptr<Radio>(const std::optional<NodeDatabase>&)>;

  /// `sessions` and `listener` must outlive the shell. Keeps `mesh.json` in `store_directory` and,
  /// at start, reads the open commands of robots in `sessions`.
  BleMeshShell(boost::asio::io_context& io, const Settings& settings, TopicScheme topics,
               RobotNames names, const std::string& store_directory, SessionStore& sessions,
               MeshListener& listener, const MakeRadio& make_radio)
      : BleShell(io,
                 make(MeshFile(store_directory), settings, std::move(topics), std::move(names),
                      make_radio),
                 listener),
        loop_(io),
        file_(store_directory),
        sessions_(sessions) {}

  /// Performs the actions that are the same for every radio, and passes the others to
  /// `perform_on_port`.
  void perform_shared(MeshAction& action, const auto& perform_on_port) {
    std::visit(overloaded{
                   [&](WriteSerial& serial) { perform_on_port(serial); },
                   [&](ReopenPort& port) { perform_on_port(port); },
                   [this](StoreMesh& mesh) { store(std::move(mesh)); },
                   [this](HeardRobot& heard) { on_heard_(heard); },
                   [this](OrderEnded& ended) { end_order(ended); },
                   [this](MeshEvent& event) { listener().on_mesh_event(std::move(event)); },
               },
               action);
  }
  /// Writes the open commands down if they have changed: they must survive a crash.
  void on_drained() override {
    std::map<std::string, OpenCommands> open = machine().open_commands();
    std::vector<SessionStore::Change> changes;
    for (const auto& [robot, commands] : open)
      if (kept_commands_[robot] != commands)
        changes.push_back({robot, encode_open_commands(commands, read_clocks())});
    for (const auto& [robot, commands] : kept_commands_)
      if (!open.contains(robot)) changes.push_back({robot, std::nullopt});
    kept_commands_ = std::move(open);
    if (!changes.empty()) sessions_.save(std::move(changes));
  }

 private:
  static Made make(const MeshFile& file, const Settings& settings, TopicScheme topics,
                   RobotNames names, const MakeRadio& make_radio) {
    const auto loaded = file.load(settings.address);
    const auto database = loaded.has_value() ? *loaded : std::nullopt;
    return {std::make_unique<BleMesh>(settings, std::move(topics), std::move(names), database,
                                      make_radio(database), fill_random),
            loaded.has_value() ? std::string() : loaded.error().why};
  }
  /// Writes on the disk's thread, then reports to the machine on the loop.
  void store(StoreMesh mesh) {
    boost::asio::post(disk_, [this, mesh = std::move(mesh), executor = loop_.get_executor()] {
      const std::string problem = file_.write(mesh.database, mesh.is_new);
      boost::asio::post(executor,
                        [this, problem, is_new = mesh.is_new, alive = std::weak_ptr(alive_)] {
                          if (!alive.expired() && !is_stopped()) on_stored(problem, is_new);
                        });
    });
  }
  void on_stored(const std::string& problem, bool is_new) {
    if (is_new && problem.empty())
      notify(Severity::notice,
             "a new BLE mesh begins: " + file_.path() +
                 " holds its keys; keep a backup, without them every robot must join again");
    driver()->on_stored(problem, read_clocks());
  }
  void end_order(OrderEnded& ended) {
    const auto waiting = orders_.find(ended.id);
    if (waiting == orders_.end()) return;
    const OrderDone done = std::move(waiting->second);
    orders_.erase(waiting);
    done(std::move(ended.answer));
  }
  /// Reports the outcome of commands that an earlier daemon had under way. The listener may call an
  /// input of the machine, which then replaces `kept_commands_`.
  void end_interrupted_commands() {
    const Now now = read_clocks();
    for (const auto& [robot, content] : sessions_.load()) {
      const OpenCommands commands = decode_open_commands(content, now);
      kept_commands_[robot] = commands;
      for (const OpenCommand& command : commands)
        listener().on_mesh_event(outcome_after_restart(robot, command, now.mono));
    }
  }

  boost::asio::io_context& loop_;
  OnHeard on_heard_ = [](const HeardRobot&) {};
  MeshFile file_;
  SessionStore& sessions_;
  std::map<std::string, OpenCommands> kept_commands_;  ///< by robot, as given to `sessions_`
  std::map<std::uint64_t, OrderDone> orders_;
  std::uint64_t last_order_ = 0;
  /// Expires with the shell, so that a completion that comes later does not touch it.
  std::shared_ptr<const int> alive_ = std::make_shared<int>();
  boost::asio::thread_pool disk_{1};  ///< writes mesh.json; last member, so that it ends first
};

}  // namespace slamgw::ble
