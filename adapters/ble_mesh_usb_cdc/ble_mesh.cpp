// SPDX-License-Identifier: Apache-2.0
// Inputs, presence and the way down; the way up is in ble_mesh_uplink.cpp.
#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"

#include <fmt/format.h>

#include "adapters/ble_mesh_usb_cdc/robots/will.hpp"

namespace slamgw::ble {
namespace {

constexpr const char* gateway_ends = "the gateway ends";
constexpr std::chrono::seconds sign_of_life_interval{1};

std::optional<MeshKeys> keys_of(const std::optional<NodeDatabase>& database) {
  return database ? std::optional(database->keys) : std::nullopt;
}

}  // namespace

BleMesh::BleMesh(Settings settings, TopicScheme topics, RobotNames names,
                 std::optional<NodeDatabase> database, RandomSource random, std::uint64_t seed)
    : settings_(std::move(settings)),
      topics_(std::move(topics)),
      names_(std::move(names)),
      link_({{settings_.address, settings_.groups}, settings_.ttl}, keys_of(database), seed),
      provisioner_(settings_, names_, std::move(database), std::move(random)) {}

void BleMesh::on_start() {
  add_configured();
  follow_nodes(TimePoint{});
}

void BleMesh::on_port_open(TimePoint now) {
  link_.on_port_open(now);
  settle(now);
}

void BleMesh::on_port_closed(const std::string& why, TimePoint now) {
  link_.on_port_closed(why, now);
  settle(now);
}

void BleMesh::on_bytes(ByteView bytes, TimePoint now) {
  link_.on_bytes(bytes, now);
  settle(now);
}

void BleMesh::on_keys(const MeshKeys& keys, TimePoint now) {
  provisioner_.on_new_mesh(keys);
  link_.on_keys(keys, now);
  settle(now);
}

void BleMesh::on_keys_failed(const std::string& why, TimePoint now) {
  link_.on_keys_failed(why, now);
  settle(now);
}

// --- The link ------------------------------------------------------------------------------------

void BleMesh::settle(TimePoint now) {
  while (true) {
    if (auto from_link = link_.next_action()) {
      on_link_action(std::move(*from_link), now);
    } else if (auto from_provisioner = provisioner_.next_action()) {
      on_provisioner_action(std::move(*from_provisioner), now);
    } else {
      return;
    }
  }
}

void BleMesh::on_link_action(LinkAction action, TimePoint now) {
  std::visit(
      overloaded{
          [&](WriteSerial& write) { actions_.push(std::move(write)); },
          [&](ReopenPort& reopen) { actions_.push(reopen); },
          [&](GenerateKeys& generate) { actions_.push(generate); },
          [&](LinkIsUp& up) { on_link_up(std::move(up.detail), now); },
          [&](LinkIsDown& down) { on_link_down(down.why, now); },
          [&](SendRefused& refused) {
            const auto robot = robots_.find(refused.destination);
            if (robot != robots_.end()) robot->second.commands.on_send_refused(refused.why);
            provisioner_.on_send_refused(refused.destination, refused.why, now);
          },
          [&](MessageReceived& message) { on_message(message, now); },
          [&](Heartbeat& heartbeat) {
            if (Robot* robot = robot_at(heartbeat.source, now)) on_heard(*robot, now);
          },
          [&](IvUpdate& update) {
            emit(Notice{
                Severity::info, fmt::format("the mesh's IV index is {}", update.iv_index), {}});
            provisioner_.on_iv_index(update.iv_index, now);
          },
          [&](ProvisioningEvent& event) { provisioner_.on_event(event, now); },
          [&](CommandEnded& ended) { provisioner_.on_command_ended(ended, now); },
          [&](BoardCleared& cleared) {
            provisioner_.on_board_cleared(cleared.status == Status::success,
                                          std::string(to_string(cleared.status)), now);
          },
          [&](Notice& notice) { emit(std::move(notice)); },
      },
      action);
}

void BleMesh::on_link_up(std::string detail, TimePoint now) {
  emit(LinkChange{Mesh::ble, true, std::move(detail)});
  for (auto& [address, robot] : robots_) {
    if (robot.is_online) subscribe(robot);  // for retained messages that came while it was down
    if (robot.is_node) robot.await(now);
  }
  provisioner_.on_link_up(link_.subnet_handle(), link_.version(), now);
}

void BleMesh::on_link_down(const std::string& why, TimePoint now) {
  down_reason_ = why;
  emit(LinkChange{Mesh::ble, false, why});
  for (auto& [address, robot] : robots_)
    conclude(robot, robot.commands.refuse_all("the BLE link went down: " + why, now));
  provisioner_.on_link_down(why, now);
}

void BleMesh::send(const Robot& robot, std::uint16_t element, Bytes access, bool is_urgent,
                   TimePoint now) {
  if (!link_.send({element, robot.appkey_handle, std::move(access), is_urgent}, now))
    ++counters_.sends_dropped;  // repeated by us (a command) or asked for again (a STATUS)
}

// --- Who is there --------------------------------------------------------------------------------

Robot* BleMesh::robot_at(std::uint16_t source, TimePoint now) {
  const std::uint16_t address = primary_of(source);
  const auto known = robots_.find(address);
  if (known != robots_.end()) return &known->second;
  if (robots_.size() >= max_robots) {
    if (const auto count = full_burst_.on_event(now))
      emit(Notice{Severity::warning,
                  fmt::format("{} message(s) from robots beyond the {} that the BLE mesh has room "
                              "for were ignored",
                              *count, max_robots),
                  {}});
    return nullptr;
  }
  return &robots_.try_emplace(address, address, provisioner_.nodes().id_of(address), settings_.ttl)
              .first->second;
}

Robot* BleMesh::robot_called(std::string_view id) {
  for (auto& [address, robot] : robots_)
    if (robot.id == id) return &robot;
  return nullptr;
}

std::optional<Presence> BleMesh::presence_of(std::string_view id) const {
  for (const auto& [address, robot] : robots_)
    if (robot.id == id)
      return robot.is_online && link_.is_up() ? Presence::online : Presence::offline;
  return std::nullopt;
}

std::size_t BleMesh::queued_for(std::string_view id) const {
  for (const auto& [address, robot] : robots_)
    if (robot.id == id) return robot.commands.size();
  return 0;
}

std::vector<OpenCommand> BleMesh::open_commands() const {
  std::vector<OpenCommand> open;
  for (const auto& [address, robot] : robots_) robot.commands.list(robot.id, open);
  return open;
}

void BleMesh::on_heard(Robot& robot, TimePoint now) {
  provisioner_.on_heard(robot.address, now);
  robot.last_heard = now;
  robot.is_awaited = false;
  if (std::exchange(robot.is_online, true)) return tell_heard(robot, now);
  robot.retained_given.clear();
  announce(robot, Presence::online);
  subscribe(robot);  // makes the broker send what is retained for it again
}

void BleMesh::tell_heard(Robot& robot, TimePoint now) {
  if (now - robot.told_heard < sign_of_life_interval) return;
  robot.told_heard = now;
  emit(SignOfLife{Mesh::ble, robot.id});
}

void BleMesh::announce(Robot& robot, Presence presence) {
  robot.is_announced = true;
  emit(PresenceChange{Mesh::ble, robot.id, presence, fmt::format("0x{:04x}", robot.address)});
}

void BleMesh::on_silent(Robot& robot) {
  robot.is_awaited = false;
  const bool was_online = std::exchange(robot.is_online, false);
  announce(robot, Presence::offline);
  if (settings_.will && was_online) emit(will_report(*settings_.will, robot.id));
}

void BleMesh::subscribe(const Robot& robot) {
  emit(SubscribeRequest{Mesh::ble, topics_.command_filter(robot.id), Qos::at_least_once});
}

void BleMesh::on_subscribe_result(const std::string& filter, bool granted, TimePoint) {
  for (auto& [address, robot] : robots_) {
    if (topics_.command_filter(robot.id) == filter) robot.is_subscribed = granted;
  }
}

void BleMesh::on_broker_link(bool is_up, TimePoint) {
  if (!is_up) return;
  for (auto& [address, robot] : robots_) {
    if (!std::exchange(robot.is_subscribed, true)) subscribe(robot);
  }
}

// --- Down ----------------------------------------------------------------------------------------

void BleMesh::on_broker_message(const BrokerMessage& message, CommandId id, TimePoint now) {
  const auto target = topics_.parse_command_topic(message.topic);
  if (!target || id == CommandId::none) return;  // another mesh's
  Robot* const found = robot_called(target->robot);
  if (found == nullptr) return;
  Robot& robot = *found;
  if (message.retain && !may_take_retained(robot, message)) return;

  const auto refuse = [&](std::string why) {
    conclude(robot,
             {{id, std::string(target->type), CommandResult::refused, {}, std::move(why), {}}});
  };
  if (is_stopping_) return refuse(gateway_ends);
  if (!link_.is_up()) return refuse("the BLE link is down: " + down_reason_);
  auto command = make_command(settings_, target->type, message.payload, ++last_tid_);
  if (!command.has_value()) return refuse(command.error().why);
  command->id = id;
  conclude(robot, robot.commands.add(std::move(*command), now));
  actions_.push(CommandsChanged{});
  transmit_due(robot, now);
  settle(now);
}

bool BleMesh::may_take_retained(Robot& robot, const BrokerMessage& message) {
  if (!robot.is_online || !link_.is_up() || robot.retained_given.size() >= max_retained)
    return false;
  return robot.retained_given.insert(message.topic).second;
}

void BleMesh::on_stop(TimePoint now) {
  is_stopping_ = true;
  for (auto& [address, robot] : robots_)
    conclude(robot, robot.commands.refuse_all(gateway_ends, now));
}

void BleMesh::transmit_due(Robot& robot, TimePoint now) {
  auto access = robot.commands.next_transmission(now);
  if (!access) return;
  actions_.push(CommandsChanged{});
  if (is_traced_) {
    const CommandQueue::UnderWay sent = robot.commands.under_way();
    emit(MeshStep{.kind = MeshStep::Kind::sent,
                  .mesh = Mesh::ble,
                  .robot = robot.id,
                  .topic = topics_.command_topic(robot.id, sent.command.type),
                  .wire = {std::nullopt, sent.copies > 1},
                  .bytes = sent.command.access.size(),
                  .command = sent.command.id});
  }
  send(robot, robot.address, std::move(*access), false, now);
}

void BleMesh::conclude(const Robot& robot, EndedCommands ended) {
  if (!ended.empty()) actions_.push(CommandsChanged{});
  for (EndedCommand& command : ended) {
    ++counters_.commands[static_cast<std::size_t>(command.result)];
    if (!command.access.empty()) link_.withdraw(robot.address, command.access);
    emit(CommandOutcome{Mesh::ble, command.id, robot.id, std::move(command.type), command.result,
                        command.after, std::move(command.why)});
  }
}

// --- Time ----------------------------------------------------------------------------------------

std::optional<TimePoint> BleMesh::deadline() const {
  std::optional<TimePoint> next = earlier(link_.deadline(), provisioner_.deadline());
  for (const auto& [address, robot] : robots_) {
    next = earlier(next, robot.commands.deadline());
    if (robot.is_expected()) next = earlier(next, robot.last_heard + settings_.offline_after);
  }
  return next;
}

void BleMesh::on_deadline(TimePoint now) {
  link_.on_deadline(now);
  provisioner_.on_deadline(now);
  for (auto& [address, robot] : robots_) {
    conclude(robot, robot.commands.on_deadline(now));
    transmit_due(robot, now);
    if (robot.is_expected() && now >= robot.last_heard + settings_.offline_after) on_silent(robot);
  }
  settle(now);
}

Counters BleMesh::counters() const {
  const LinkCounters& link = link_.counters();
  std::uint64_t online = 0;
  for (const auto& [address, robot] : robots_) online += robot.is_online ? 1 : 0;
  const auto commands = [&](CommandResult result) {
    return counters_.commands[static_cast<std::size_t>(result)];
  };
  return {{"robots_online", online},
          {"reports", counters_.reports},
          {"repeats", counters_.repeats},
          {"rejected", counters_.rejected},
          {"unknown_opcodes", counters_.unknown_opcodes},
          {"statuses_sent", counters_.statuses_sent},
          {"commands_delivered", commands(CommandResult::delivered)},
          {"commands_timeout", commands(CommandResult::timeout)},
          {"commands_refused", commands(CommandResult::refused)},
          {"commands_superseded", commands(CommandResult::superseded)},
          {"sends_dropped", counters_.sends_dropped},
          {"sent", link.sent},
          {"send_refused", link.send_refused},
          {"tx_complete", link.tx_complete},
          {"board_drops", link.board_drops},
          {"board_restarts", link.restarts},
          {"resyncs", link.resyncs},
          {"command_timeouts", link.command_timeouts},
          {"malformed_events", link.malformed_events},
          {"other_events", link.other_events}};
}

}  // namespace slamgw::ble
