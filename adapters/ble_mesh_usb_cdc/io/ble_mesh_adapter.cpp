// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/ble_mesh_adapter.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <random>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/cobs/cobs_mesh.hpp"

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

/// The machine for `settings.protocol`; `problem` says why it must stay off.
std::unique_ptr<MeshMachine> make_machine(const Settings& settings, TopicScheme topics,
                                          RobotNames names, const MeshFile& file,
                                          std::string& problem) {
  if (settings.protocol == Protocol::cobs) {
    if (settings.cobs_content == CobsContent::positions && !settings.robot_id)
      problem = "ble_mesh.robot_id is not set: positions do not say whose they are";
    return std::make_unique<CobsMesh>(settings, std::move(topics), std::move(names));
  }
  std::optional<NodeDatabase> database;
  if (const auto loaded = file.load(); !loaded.has_value()) {
    problem = loaded.error().why;
  } else {
    database = *loaded;
  }
  if (database) check_address(*database, settings.address, problem);
  return std::make_unique<BleMesh>(settings, std::move(topics), std::move(names),
                                   std::move(database), fill_random, random_seed());
}

}  // namespace

BleMeshAdapter::BleMeshAdapter(asio::io_context& io, Settings settings, TopicScheme topics,
                               RobotNames names, std::string store_directory,
                               MeshListener& listener, OpenPort open_port)
    : settings_(std::move(settings)),
      file_(store_directory),
      command_file_(store_directory),
      listener_(listener),
      mesh_(make_machine(settings_, std::move(topics), std::move(names), file_, problem_)),
      robots_(dynamic_cast<const BleMesh*>(mesh_.get())),
      driver_(io, *mesh_, [this](MeshAction& action) { perform(action); }),
      line_(io,
            open_port ? std::move(open_port)
                      : [settings = settings_] { return open_serial_port(settings); },
            {.on_open = [this] { on_port_open(); },
             .on_bytes =
                 [this](ByteView bytes) {
                   driver_.input(
                       [bytes](MeshMachine& mesh, TimePoint now) { mesh.on_bytes(bytes, now); });
                 },
             .on_failed = [this](const std::string& why) { on_port_failed(why); },
             .on_open_stuck = [this](const std::string& why) { on_port_closed(why); },
             .on_close_stuck = [this](const std::string& why) { on_close_stuck(why); }}),
      timer_(io) {}

void BleMeshAdapter::start() {
  is_stopped_ = false;
  end_interrupted_commands();
  if (!problem_.empty()) {
    listener_.on_mesh_event(Notice{Severity::error, problem_, {}});
    listener_.on_mesh_event(LinkChange{Mesh::ble, false, problem_});
    return;
  }
  driver_.input([](MeshMachine& mesh, TimePoint) { mesh.on_start(); });
  open_after(Duration::zero());
}

void BleMeshAdapter::stop() {
  is_stopped_ = true;
  driver_.stop();
  timer_.cancel();
  line_.stop();
  orders_.clear();
  disk_.join();
  // What changed while the last write was under way, such as the key of a robot that just joined.
  if (const NodeDatabase* unsaved = robots_ ? robots_->unsaved() : nullptr) file_.replace(*unsaved);
  if (robots_ != nullptr && are_commands_changed_)
    command_file_.write(encode_open_commands(robots_->open_commands(), read_clocks()));
}

void BleMeshAdapter::reconfigure(RobotNames names) {
  if (is_stopped_ || !problem_.empty()) return;
  driver_.input([&](MeshMachine& mesh, TimePoint now) { mesh.on_names(std::move(names), now); });
}

void BleMeshAdapter::manage(MeshOrder order, OrderDone done) {
  if (is_stopped_) return done({{}, "slam-gatewayd ends"});
  if (!problem_.empty()) return done({{}, problem_});
  const std::uint64_t id = ++last_order_;
  orders_.emplace(id, std::move(done));
  driver_.input(
      [&](MeshMachine& mesh, TimePoint now) { mesh.on_order(id, std::move(order), now); });
}

void BleMeshAdapter::end_order(OrderEnded& ended) {
  const auto waiting = orders_.find(ended.id);
  if (waiting == orders_.end()) return;
  const OrderDone done = std::move(waiting->second);
  orders_.erase(waiting);
  done(std::move(ended.answer));
}

void BleMeshAdapter::perform(MeshAction& action) {
  if (is_stopped_) return;
  std::visit(overloaded{
                 [this](WriteSerial& serial) { line_.write(serial.bytes); },
                 [this](ReopenPort& reopen) {
                   line_.close();
                   open_after(reopen.after);
                 },
                 [this](GenerateKeys&) { generate_keys(); },
                 [this](StoreMesh& mesh) { store(std::move(mesh.database)); },
                 [this](CommandsChanged&) { keep_commands(); },
                 [this](OrderEnded& ended) { end_order(ended); },
                 [this](MeshEvent& event) { listener_.on_mesh_event(std::move(event)); },
             },
             action);
}

void BleMeshAdapter::generate_keys() {
  const auto keys = generate_random_keys();
  write_file(
      [this, keys] { return keys ? file_.create({*keys}) : "no randomness for the mesh's keys"; },
      [this, keys](const std::string& problem) { on_keys_stored(keys, problem); });
}

void BleMeshAdapter::on_keys_stored(const std::optional<MeshKeys>& keys,
                                    const std::string& problem) {
  if (problem.empty()) {
    listener_.on_mesh_event(
        Notice{Severity::notice,
               "a new BLE mesh begins: " + file_.path() +
                   " holds its keys; keep a backup, without them every robot must join anew",
               {}});
  }
  driver_.input([&](MeshMachine& mesh, TimePoint now) {
    problem.empty() ? mesh.on_keys(*keys, now) : mesh.on_keys_failed(problem, now);
  });
}

void BleMeshAdapter::store(NodeDatabase database) {
  write_file(
      [this, database = std::move(database)] { return file_.replace(database); },
      [this](const std::string& problem) {
        driver_.input([&](MeshMachine& mesh, TimePoint now) { mesh.on_stored(problem, now); });
      });
}

void BleMeshAdapter::end_interrupted_commands() {
  const Now now = read_clocks();
  const auto interrupted = command_file_.load(now);
  if (!interrupted)
    listener_.on_mesh_event(
        Notice{Severity::warning,
               command_file_.path() +
                   " is damaged: commands that were under way over BLE before the restart have no "
                   "outcome",
               {}});
  if (interrupted && interrupted->empty()) return;
  for (const OpenCommand& command : interrupted.value_or(std::vector<OpenCommand>{}))
    listener_.on_mesh_event(outcome_after_restart(command, now));
  kept_commands_ = "unknown";
  keep_commands();
}

/// One write at a time; what changes meanwhile is in the next one.
void BleMeshAdapter::keep_commands() {
  are_commands_changed_ = true;
  if (is_keeping_commands_ || robots_ == nullptr) return;
  are_commands_changed_ = false;
  std::string text = encode_open_commands(robots_->open_commands(), read_clocks());
  if (text == kept_commands_) return;
  kept_commands_ = text;
  is_keeping_commands_ = true;
  write_file([this, text = std::move(text)] { return command_file_.write(text); },
             [this](const std::string& problem) {
               is_keeping_commands_ = false;
               const bool is_news = !problem.empty() && !is_command_problem_known_;
               is_command_problem_known_ = !problem.empty();
               if (is_news) listener_.on_mesh_event(Notice{Severity::warning, problem, {}});
               if (!problem.empty()) kept_commands_ = "unknown";
               if (are_commands_changed_) keep_commands();
             });
}

void BleMeshAdapter::write_file(std::function<std::string()> write,
                                std::function<void(const std::string&)> done) {
  asio::post(disk_, [this, write = std::move(write), done = std::move(done),
                     loop = timer_.get_executor()] {
    asio::post(loop, [this, problem = write(), done, alive = std::weak_ptr(alive_)] {
      if (!alive.expired() && !is_stopped_) done(problem);
    });
  });
}

// --- The port ------------------------------------------------------------------------------------

void BleMeshAdapter::open_after(Duration delay) {
  timer_.expires_after(delay);
  timer_.async_wait([this](boost::system::error_code error) {
    if (!error && !is_stopped_) line_.open();
  });
}

void BleMeshAdapter::on_port_open() {
  open_delay_ = first_open_delay;
  driver_.input([](MeshMachine& mesh, TimePoint now) { mesh.on_port_open(now); });
}

void BleMeshAdapter::on_port_failed(const std::string& why) {
  open_after(open_delay_);
  open_delay_ = std::min(open_delay_ * 2, max_open_delay);
  on_port_closed(why);
}

void BleMeshAdapter::on_close_stuck(const std::string& why) {
  if (stuck_burst_.on_event(std::chrono::steady_clock::now()))
    listener_.on_mesh_event(Notice{Severity::warning, why, {}});
}

void BleMeshAdapter::on_port_closed(const std::string& why) {
  driver_.input([&](MeshMachine& mesh, TimePoint now) { mesh.on_port_closed(why, now); });
}

}  // namespace slamgw::ble
