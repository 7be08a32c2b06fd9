// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>

namespace slamgw::ble {
namespace {

/// Mesh Profile 1.0 section 3.10.6: a node recovers no larger jump of the IV index.
constexpr std::uint32_t max_iv_index_jump = 42;

bool is_unicast(std::uint16_t address) { return address != 0 && address <= last_unicast_address; }

}  // namespace

BleMesh::BleMesh(Settings settings, TopicScheme topics, RobotNames names,
                 std::optional<NodeDatabase> database, std::unique_ptr<Radio> radio,
                 RandomSource random)
    : settings_(std::move(settings)),
      topics_(std::move(topics)),
      radio_(std::move(radio)),
      provisioner_(settings_, *radio_, link_, actions_, topics_.gateway_id(), std::move(names),
                   std::move(database), std::move(random)),
      gate_(provisioner_.nodes(), settings_.gateway_group.has_value()),
      shared_{settings_, topics_, *radio_, link_, gate_, actions_, is_traced_},
      downlink_(shared_),
      robots_(shared_, provisioner_.nodes(), downlink_),
      uplink_(shared_, robots_, downlink_),
      relay_(shared_, robots_, provisioner_.nodes()) {}

void BleMesh::on_start() {
  robots_.on_start();
  provisioner_.on_start();
}

// --- The radio -----------------------------------------------------------------------------------

void BleMesh::on_port_open(TimePoint now) {
  radio_->on_port_open(now);
  settle(now);
}

void BleMesh::on_port_closed(const std::string& why, TimePoint now) {
  radio_->on_port_closed(why, now);
  settle(now);
}

void BleMesh::on_bytes(ByteView bytes, TimePoint now) {
  radio_->on_bytes(bytes, now);
  settle(now);
}

void BleMesh::settle(TimePoint now) {
  while (true) {
    if (provisioner_.take_change()) robots_.on_nodes_changed(now);
    auto from_radio = radio_->next_action(now);
    if (!from_radio) return;
    std::visit(overloaded{
                   [&](RadioEvent& event) { on_radio_event(event, now); },
                   [&](auto& for_shell) { actions_.push(std::move(for_shell)); },
               },
               *from_radio);
  }
}

void BleMesh::on_radio_event(RadioEvent& event, TimePoint now) {
  std::visit(overloaded{
                 [&](LinkIsUp& up) { on_link_up(up, now); },
                 [&](LinkIsDown& down) { on_link_down(down, now); },
                 [&](SendRefused& refused) { on_send_refused(refused, now); },
                 [&](MessageReceived& message) { on_message(message, now); },
                 [&](Heartbeat& heartbeat) {
                   if (is_unicast(heartbeat.source) && !is_banned(heartbeat.source) &&
                       !provisioner_.nodes().is_own(heartbeat.source))
                     hear(heartbeat.source, nullptr, now);
                 },
                 [&](IvUpdate& update) { on_iv_update(update, now); },
                 [&](ProvisionerEvent& which) { provisioner_.on_event(which, now); },
                 [&](Notice& notice) { emit(std::move(notice)); },
             },
             event);
}

void BleMesh::on_link_up(const LinkIsUp& up, TimePoint now) {
  link_ = {.is_up = true, .is_starting = false, .source = up.source};
  provisioner_.on_link_up(up, now);
  emit(LinkChange{Mesh::ble, true, up.detail + ", " + provisioner_.lives().description()});
  are_mostly_deaf_ = false;
  up_since_ = now;
  robots_.on_link_up(now);
}

void BleMesh::on_link_down(const LinkIsDown& down, TimePoint now) {
  emit(LinkChange{Mesh::ble, false, down.why});
  link_.down_reason = down.why;
  link_.is_starting = false;
  const bool was_up = std::exchange(link_.is_up, false);
  for (auto& [address, robot] : robots_)
    downlink_.end_all(robot, "the BLE link went down: " + down.why, now);
  relay_.on_link_down();
  if (was_up) provisioner_.on_link_down(down, now);
}

void BleMesh::on_send_refused(const SendRefused& refused, TimePoint now) {
  if (Robot* robot = robots_.find(refused.destination))
    robot->commands.on_send_refused(refused.why);
  provisioner_.on_send_refused(refused.destination, refused.why, now);
}

/// A serial line that has lost octets can report any index. A robot that joined with it would not
/// hear the others.
void BleMesh::on_iv_update(const IvUpdate& update, TimePoint now) {
  const NodeDatabase* database = provisioner_.nodes().database();
  if (database && update.iv_index > std::uint64_t{database->iv_index} + max_iv_index_jump)
    return shared_.warn(
        fmt::format("the radio reports the IV index {}, but no node can follow that "
                    "far from {}: it is ignored",
                    update.iv_index, database->iv_index));
  if (database && update.iv_index < database->iv_index &&
      std::exchange(lower_iv_index_, update.iv_index) != update.iv_index)
    return shared_.warn(
        fmt::format("the radio reports the IV index {}, which is lower than {}: it is ignored "
                    "until it is reported again",
                    update.iv_index, database->iv_index));
  lower_iv_index_.reset();
  emit(Notice{Severity::info, fmt::format("the mesh's IV index is {}", update.iv_index), {}});
  provisioner_.on_iv_index(update.iv_index, now);
}

bool BleMesh::is_banned(std::uint16_t source) const {
  const NodeTable& nodes = provisioner_.nodes();
  const Bans& bans = nodes.names().bans();
  return !bans.ids().empty() && bans.has(nodes.id_of(source));
}

void BleMesh::on_message(const MessageReceived& message, TimePoint now) {
  if (!is_unicast(message.source))
    return uplink_.reject(message.source, "its source is not a unicast address", now);
  if (provisioner_.nodes().is_own(message.source))
    return uplink_.reject(message.source, "its source is an address of this gateway", now);
  if (is_banned(message.source)) {
    provisioner_.on_message(message, now);  // an operator may still remove the robot
    return settle(now);
  }
  Robot* robot = hear(message.source, &message, now);
  if (robot == nullptr) return;
  if (provisioner_.on_message(message, now)) {
    robots_.on_hearing(*robot, false);
    return settle(now);
  }
  uplink_.on_message(*robot, message, now);
  judge_hearing(now);
}

/// If robots hear nothing from a radio that has just come up, they have heard its address before,
/// with higher sequence numbers.
void BleMesh::judge_hearing(TimePoint now) {
  const Robots::Hearing hearing = robots_.hearing();
  const bool were_mostly_deaf = std::exchange(are_mostly_deaf_, hearing.is_mostly_deaf());
  if (are_mostly_deaf_ == were_mostly_deaf) return;
  if (!are_mostly_deaf_) {
    if (hearing.asking > 0)
      emit(Notice{Severity::notice, "most robots hear the gateway again", {}});
    return;
  }
  shared_.warn(fmt::format(
      "{} of {} robots do not hear the gateway: they repeat what it has "
      "acknowledged; {}",
      hearing.deaf, hearing.asking,
      try_new_life(now) ? "the radio is restarted, to send from another address"
                        : "switch them off and on, or wait until the gateway's sequence "
                          "numbers have passed those that they remember"));
}

/// Restarts the radio with an address that no robot has heard, if that may help; the radio forgets
/// everything. Tries once for each life, and not in a life that it has begun itself.
bool BleMesh::try_new_life(TimePoint now) {
  const SourceLives& lives = provisioner_.lives();
  const bool is_suspected =
      now - up_since_ <= address_suspected_for && lives.number() != tried_life_;
  if (!is_suspected || lives.kind() == RadioKind::keeps || !radio_->restart(now)) return false;
  tried_life_ = lives.number() + 1;
  return true;
}

Robot* BleMesh::hear(std::uint16_t source, const MessageReceived* message, TimePoint now) {
  if (gate_.is_stranger(source)) {
    on_stranger(source, now);
    return nullptr;
  }
  Robot* robot = robots_.at(source, now);
  if (robot == nullptr) return nullptr;
  if (gate_.is_shared()) {
    HeardRobot heard{robot->id, {}};
    if (message != nullptr) heard.radio = robot->radio_facts(*message);
    actions_.push(std::move(heard));
  }
  provisioner_.on_heard(robot->address, now);
  robots_.on_heard(*robot, now);
  return robot;
}

void BleMesh::on_stranger(std::uint16_t source, TimePoint now) {
  if (const auto count = stranger_throttle_.on_event(now))
    shared_.warn(
        fmt::format("{} message(s) of robots that this gateway does not know were left to "
                    "the gateway that provisions this mesh, the last from 0x{:04x}: export "
                    "the mesh there again (ble export --address 0x{:04x}) and import it "
                    "here, then this gateway can serve them too",
                    *count, source, settings_.address));
}

// --- Which gateway serves a robot ----------------------------------------------------------------

void BleMesh::on_session_held(const std::string& id, TimePoint now) {
  Robot* robot = robots_.find(id);
  if (robot == nullptr) return;
  robots_.on_session_held(*robot, now);
  uplink_.on_session_held(*robot, now);
  settle(now);
}

/// In a mesh that is not shared, no other gateway can acknowledge the robot's messages, so this
/// gateway still does.
std::vector<WaitingMessage> BleMesh::give_up(const std::string& id, TimePoint now) {
  Robot* robot = robots_.find(id);
  if (robot == nullptr) return {};
  if (is_shared()) uplink_.on_given_up(*robot);
  std::vector<WaitingMessage> waiting = downlink_.give_up(*robot, now);
  robots_.on_given_up(*robot);
  settle(now);
  return waiting;
}

// --- The nodes -----------------------------------------------------------------------------------

void BleMesh::on_stored(const std::string& problem, TimePoint now) {
  provisioner_.on_stored(problem, now);
  settle(now);
}

void BleMesh::on_order(std::uint64_t id, const BleOrder& order, TimePoint now) {
  provisioner_.on_order(id, order, now);
  settle(now);
}

void BleMesh::on_names(RobotNames names, TimePoint now) {
  provisioner_.on_names(std::move(names));
  robots_.on_names(now);
  settle(now);
}

// --- The broker ----------------------------------------------------------------------------------

void BleMesh::on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now) {
  uplink_.on_receipt(receipt_id, outcome, now);
  settle(now);
}

void BleMesh::on_broker_message(const RobotMessage& what, TimePoint now) {
  const auto target = topics_.parse_command_topic(what.message.topic);
  if (!target || what.command == CommandId::none) return;
  if (Robot* robot = robots_.find(what.robot))
    downlink_.on_command(*robot, target->type, what.message, what.command, now);
  settle(now);
}

void BleMesh::on_robot_message(const BrokerMessage& message, TimePoint now) {
  relay_.on_robot_message(message, now);
  settle(now);
}

void BleMesh::on_subscribe_result(const std::string& robot, const std::string&, bool granted,
                                  TimePoint) {
  robots_.on_subscribe_result(robot, granted);
}

void BleMesh::on_broker_link(bool is_up, TimePoint) {
  if (is_up) robots_.on_broker_up();
}

void BleMesh::on_stop(TimePoint now) {
  downlink_.on_stop();
  for (auto& [address, robot] : robots_) downlink_.end_all(robot, Downlink::gateway_ends, now);
  provisioner_.on_stop();
  settle(now);
}

// --- Time ----------------------------------------------------------------------------------------

std::optional<TimePoint> BleMesh::deadline() const {
  std::optional<TimePoint> next = earlier(radio_->deadline(), provisioner_.deadline());
  next = earlier(next, relay_.deadline());
  for (const auto& [address, robot] : robots_) {
    next = earlier(next, downlink_.deadline(robot));
    if (robot.is_expected()) next = earlier(next, robot.last_heard + settings_.offline_after);
  }
  return next;
}

void BleMesh::on_deadline(TimePoint now) {
  radio_->on_deadline(now);
  provisioner_.on_deadline(now);
  for (auto& [address, robot] : robots_) {
    downlink_.on_deadline(robot, now);
    robots_.on_deadline(robot, now);
  }
  relay_.on_deadline(now);
  judge_hearing(now);
  settle(now);
}

// --- Questions -----------------------------------------------------------------------------------

std::optional<Presence> BleMesh::presence_of(std::string_view id) const {
  const Robot* robot = robots_.find(id);
  if (robot == nullptr) return std::nullopt;
  return robot->is_shown() && link_.is_up ? Presence::online : Presence::offline;
}

std::size_t BleMesh::queued_for(std::string_view id) const {
  const Robot* robot = robots_.find(id);
  return robot ? robot->commands.size() : 0;
}

std::map<std::string, OpenCommands> BleMesh::open_commands() const {
  std::map<std::string, OpenCommands> open;
  for (const auto& [address, robot] : robots_)
    if (robot.commands.size() > 0) open.emplace(robot.id, robot.commands.open_commands());
  return open;
}

const NodeDatabase* BleMesh::unsaved() const {
  const NodeTable& nodes = provisioner_.nodes();
  return nodes.is_saved() ? nullptr : nodes.database();
}

Counters BleMesh::counters() const {
  const UplinkCounters& up = uplink_.counters();
  const RelayCounters& relay = relay_.counters();
  Counters counters{{"robots_online", robots_.online()},
                    {"robots_deaf", robots_.deaf()},
                    {"mostly_deaf", are_mostly_deaf_ ? 1U : 0U},
                    {"reports", up.reports},
                    {"repeats", up.repeats},
                    {"rejected", up.rejected},
                    {"unknown_opcodes", up.unknown_opcodes},
                    {"left_to_others", up.left_to_others},
                    {"statuses_sent", up.statuses_sent},
                    {"commands_delivered", downlink_.ended(CommandResult::delivered)},
                    {"commands_timeout", downlink_.ended(CommandResult::timeout)},
                    {"commands_refused", downlink_.ended(CommandResult::refused)},
                    {"commands_superseded", downlink_.ended(CommandResult::superseded)},
                    {"retained_dropped", downlink_.retained_dropped()},
                    {"relayed", relay.relayed},
                    {"relays_superseded", relay.superseded},
                    {"relays_dropped", relay.dropped},
                    {"board_lives", provisioner_.lives().number()},
                    {"source_address", link_.source},
                    {"source_reused", provisioner_.lives().is_reused() ? 1U : 0U},
                    {"key_refresh_step", static_cast<std::uint64_t>(provisioner_.refresh().step())},
                    {"key_refresh_missing", provisioner_.refresh().missing()}};
  std::ranges::move(radio_->counters(), std::back_inserter(counters));
  return counters;
}

}  // namespace slamgw::ble
