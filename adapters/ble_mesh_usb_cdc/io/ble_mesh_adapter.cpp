// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/ble_mesh_adapter.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <random>
#include <utility>

namespace slamgw::ble {
namespace {

namespace asio = boost::asio;

std::uint64_t random_seed() {
  std::random_device device;
  return std::uint64_t{device()} << 32 | device();
}

/// No two in one mesh may send from the same address: robots would drop the messages of one.
void check_address(const NodeDatabase& database, std::uint16_t address, std::string& problem) {
  if (const Node* const taken = database.find_address(address))
    problem = fmt::format(
        "ble_mesh.address 0x{:04x} is a robot's (UUID {} in mesh.json): choose one that none has",
        address, to_hex(taken->uuid));
  if (database.guest_address && *database.guest_address != address)
    problem = fmt::format(
        "ble_mesh.address must be 0x{:04x}, which the gateway that provisions this mesh has given "
        "this one",
        *database.guest_address);
  if (std::ranges::find(database.gateways, address) != database.gateways.end())
    problem = fmt::format(
        "ble_mesh.address 0x{:04x} was given to another gateway of this mesh: choose one that none "
        "has",
        address);
}

}  // namespace

BleMeshAdapter::Made BleMeshAdapter::make(const Settings& settings, TopicScheme topics,
                                          RobotNames names, const MeshFile& file) {
  std::string problem;
  std::optional<NodeDatabase> database;
  if (const auto loaded = file.load(); !loaded.has_value()) {
    problem = loaded.error().why;
  } else {
    database = *loaded;
  }
  if (database) check_address(*database, settings.address, problem);
  return {std::make_unique<BoardMesh>(settings, std::move(topics), std::move(names), database,
                                      fill_random, random_seed()),
          std::move(problem)};
}

BleMeshAdapter::BleMeshAdapter(asio::io_context& io, const Settings& settings, TopicScheme topics,
                               RobotNames names, const std::string& store_directory,
                               SessionStore& sessions, MeshListener& listener, OpenPort open_port)
    : SerialShell(io, settings,
                  make(settings, std::move(topics), std::move(names), MeshFile(store_directory)),
                  listener, std::move(open_port)),
      file_(store_directory),
      sessions_(sessions) {}

void BleMeshAdapter::start() {
  end_interrupted_commands();
  SerialShell::start();
}

void BleMeshAdapter::stop() {
  SerialShell::stop();
  orders_.clear();
  disk_.join();
  // What changed while the last write was under way, such as the key of a robot that just joined.
  if (const NodeDatabase* unsaved = machine().unsaved()) file_.replace(*unsaved);
  keep_commands();
}

void BleMeshAdapter::manage(BleOrder order, OrderDone done) {
  if (is_stopped()) return done({{}, "slam-gatewayd ends"});
  if (!problem().empty()) return done({{}, problem()});
  const std::uint64_t id = ++last_order_;
  orders_.emplace(id, std::move(done));
  driver()->on_order(id, std::move(order), read_clocks());
}

void BleMeshAdapter::share_with(ServiceGate::MayServe may_serve, OnHeard on_heard) {
  on_heard_ = std::move(on_heard);
  driver()->ask_who_serves(std::move(may_serve));
}

void BleMeshAdapter::on_session_held(const std::string& robot) {
  driver()->on_session_held(robot, read_clocks());
}

void BleMeshAdapter::on_robot_message(const BrokerMessage& message) {
  if (!is_stopped()) driver()->on_robot_message(message, read_clocks());
}

void BleMeshAdapter::end_order(OrderEnded& ended) {
  const auto waiting = orders_.find(ended.id);
  if (waiting == orders_.end()) return;
  const OrderDone done = std::move(waiting->second);
  orders_.erase(waiting);
  done(std::move(ended.answer));
}

void BleMeshAdapter::perform(MeshAction& action) {
  std::visit(overloaded{
                 [this](WriteSerial& serial) { write(serial); },
                 [this](ReopenPort& port) { reopen(port); },
                 [this](GenerateKeys& wanted) { generate_keys(wanted); },
                 [this](StoreMesh& mesh) { store(std::move(mesh.database)); },
                 [this](CommandsChanged&) { keep_commands(); },
                 [this](HeardRobot& heard) { on_heard_(heard); },
                 [this](OrderEnded& ended) { end_order(ended); },
                 [this](MeshEvent& event) { listener().on_mesh_event(std::move(event)); },
             },
             action);
}

void BleMeshAdapter::generate_keys(const GenerateKeys& wanted) {
  const auto keys = generate_random_keys();
  write_file(
      [this, keys, wanted]() -> std::string {
        if (!keys) return "no randomness for the mesh's keys";
        return wanted.is_refresh ? std::string() : file_.create({*keys});
      },
      [this, keys, wanted](const std::string& problem) { on_keys_made(wanted, keys, problem); });
}

void BleMeshAdapter::on_keys_made(const GenerateKeys& wanted, const std::optional<MeshKeys>& keys,
                                  const std::string& problem) {
  if (!problem.empty() && wanted.is_refresh) return notify(Severity::error, problem);
  if (problem.empty() && !wanted.is_refresh)
    notify(Severity::notice,
           "a new BLE mesh begins: " + file_.path() +
               " holds its keys; keep a backup, without them every robot must join anew");
  problem.empty() ? driver()->on_keys(*keys, read_clocks())
                  : driver()->on_keys_failed(problem, read_clocks());
}

void BleMeshAdapter::store(NodeDatabase database) {
  write_file([this, database = std::move(database)] { return file_.replace(database); },
             [this](const std::string& problem) { driver()->on_stored(problem, read_clocks()); });
}

void BleMeshAdapter::end_interrupted_commands() {
  const Now now = read_clocks();
  for (const auto& [robot, content] : sessions_.load()) {
    kept_commands_[robot] = decode_open_commands(robot, content, now);
    for (const OpenCommand& command : kept_commands_[robot])
      listener().on_mesh_event(outcome_after_restart(command, now.mono));
  }
  keep_commands();
}

void BleMeshAdapter::keep_commands() {
  std::map<std::string, OpenCommands> open;
  for (const OpenCommand& command : machine().open_commands())
    open[command.robot].push_back(command);
  std::vector<SessionStore::Change> changes;
  for (const auto& [robot, commands] : open)
    if (kept_commands_[robot] != commands)
      changes.push_back({robot, encode_open_commands(commands, read_clocks())});
  for (const auto& [robot, commands] : kept_commands_)
    if (!open.contains(robot)) changes.push_back({robot, std::nullopt});
  kept_commands_ = std::move(open);
  if (!changes.empty()) sessions_.save(std::move(changes));
}

void BleMeshAdapter::write_file(std::function<std::string()> write,
                                std::function<void(const std::string&)> done) {
  asio::post(disk_, [this, write = std::move(write), done = std::move(done), executor = loop()] {
    asio::post(executor, [this, problem = write(), done, alive = std::weak_ptr(alive_)] {
      if (!alive.expired() && !is_stopped()) done(problem);
    });
  });
}

}  // namespace slamgw::ble
