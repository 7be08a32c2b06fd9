// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/gateway.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <utility>

#include "daemon/core/announcements.hpp"

namespace slamgw {
namespace {

/// How old `last_seen` of a retained presence may be while its robot is heard.
constexpr std::chrono::minutes presence_refresh{5};

using Json = nlohmann::ordered_json;  // keys in the order of docs/topics.md

/// The payload of our last will.
constexpr std::string_view last_will_state = R"({"state":"offline"})";

TrafficEvent event_of(Report report, std::string type, Normalized normalized, const Now& now) {
  return {.direction = Direction::up,
          .mesh = report.mesh,
          .robot = std::move(report.robot),
          .type = std::move(type),
          .topic = std::move(report.topic),
          .payload = std::move(normalized.payload),
          .qos = report.qos,
          .update = std::move(normalized.update),
          .wall = now.wall,
          .at = now.mono,
          .receipt = report.receipt,
          .wire = report.wire,
          .radio = report.radio,
          .is_rejected = normalized.is_rejected,
          .is_proven = report.is_proven};
}

}  // namespace

Gateway::Gateway(TopicScheme scheme, Settings settings, const BrokerLink& broker,
                 PresenceQuery presence_on)
    : scheme_(std::move(scheme)),
      settings_(std::move(settings)),
      broker_(broker),
      leftovers_(scheme_.presence_topic({})),
      rights_(scheme_),
      presence_on_(std::move(presence_on)),
      commands_(settings_.max_open_commands) {}

void Gateway::on_mesh_event(MeshEvent event, const Now& now) {
  std::visit([&](auto& what) { handle(std::move(what), now); }, event);
}

/// A will is published by the gateway that holds the robot's session. While that is not known, the
/// robot may be alive at another one.
void Gateway::handle(Report report, const Now& now) {
  const bool is_known_to_be_ours = !report.is_will || places_.is_alone() ||
                                   places_.is_held(report.robot) ||
                                   waiting_wills_.size() >= max_waiting_wills;
  if (is_known_to_be_ours) return pass_up(std::move(report), now);
  if (!wills_due_ && broker_.is_up) wills_due_ = now.mono + will_patience;
  const std::string robot = report.robot;
  waiting_wills_.insert_or_assign(robot, std::move(report));
}

void Gateway::publish_waiting_wills(const Now& now) {
  wills_due_.reset();
  for (auto& [robot, will] : std::exchange(waiting_wills_, {}))
    if (!places_.is_elsewhere(robot)) pass_up(std::move(will), now);
}

void Gateway::pass_up(Report report, const Now& now) {
  const Robot* known = registry_.find(report.robot);
  const bool is_first_by_radio = report.radio && known && !known->radio;
  const auto own = scheme_.parse_robot_topic(report.topic);
  std::string type(own ? own->type : std::string_view{report.topic});
  const bool retain = report.retain && may_retain(report, type, now);
  Robot* robot = registry_.on_report(report, now);
  withdraw_evicted();
  if (robot && is_first_by_radio) announce(report.robot, *robot, now);  // its presence came before
  if (!report.is_will) on_heard(report.robot, robot, now);
  open_receipts_.add(report.receipt, report.robot, now);

  Normalized normalized = normalize(own ? own->type : std::string_view{}, std::move(report.payload),
                                    settings_.update_mode);
  if (robot && !report.is_will) robot->last_type = type;
  TrafficEvent event = event_of(std::move(report), std::move(type), std::move(normalized), now);
  if (event.is_rejected) return reject(std::move(event), retain, robot, now);
  ++traffic_.up;
  actions_.push(PassUp{std::move(event), retain});
}

/// An empty message, which clears the topic, always may.
bool Gateway::may_retain(const Report& report, std::string_view type, const Now& now) {
  const bool is_named = report.payload.empty() ||
                        std::ranges::any_of(settings_.retain, [&](const std::string& named) {
                          return named == "*" || named == type;
                        });
  if (is_named && retained_.admit(report.robot, report.topic, report.payload.empty())) return true;
  ++traffic_.not_retained;
  const std::string why =
      is_named ? fmt::format("a robot may retain {} topics, all together {}",
                             RetainedTopics::max_per_robot, RetainedTopics::max_in_all)
               : "topics.retain does not name its type";
  if (const auto count = retained_throttles_[report.is_proven].on_event(now.mono))
    actions_.push(Notice{
        .severity = Severity::warning,
        .text =
            fmt::format("{} {}: '{}' is published without its retain flag: {}{}",
                        to_string(report.mesh), report.robot, report.topic, why,
                        *count > 1 ? fmt::format("; {} like it since the last line", *count) : ""),
        .robot = report.robot,
        .is_proven = report.is_proven});
  return false;
}

Upload PassUp::upload() {
  return {{std::move(event.topic), std::move(event.payload), event.qos, retain,
           Provenance{*event.mesh, event.wall}},
          event.receipt};
}

void Gateway::reject(TrafficEvent event, bool retain, Robot* robot, const Now& now) {
  ++traffic_.rejected;
  actions_.push(event);
  const auto due = robot ? robot->rejected_throttle.on_event(now.mono) : std::nullopt;
  if (due) {
    actions_.push(
        Notice{.severity = Severity::warning,
               .text = fmt::format(
                   "{} {}: {} bytes are no `update` (4 + 4n or 4 + 4n + 1, n = 0..4), published "
                   "under rejected/ as they came{}",
                   to_string(*event.mesh), event.robot, event.payload.size(),
                   *due > 1 ? fmt::format("; {} like it since the last line", *due) : ""),
               .robot = event.robot,
               .occasion = Occasion::rejected_payload,
               .is_proven = event.is_proven});
  }
  PassUp up{std::move(event), retain};
  up.event.topic = scheme_.rejected_topic(up.event.robot, up.event.type);
  actions_.push(up.upload());
}

void Gateway::handle(PresenceChange change, const Now& now) {
  const Robot* known = registry_.find(change.robot);
  const bool was_deaf = known != nullptr && known->on_mesh[change.mesh].is_deaf;
  const bool hears_again = was_deaf && !change.is_deaf && change.presence == Presence::online;
  Robot* robot = registry_.on_presence(change, now);
  withdraw_evicted();
  to_withdraw_.erase(change.robot);
  if (robot) announce(change.robot, *robot, now.mono);
  if (change.presence != Presence::offline) waiting_wills_.erase(change.robot);
  actions_.push(Notice{.severity = change.is_deaf ? Severity::warning : Severity::info,
                       .text = fmt::format("{} {} is {} at {}{}", to_string(change.mesh),
                                           change.robot, to_string(change.presence), change.address,
                                           change.is_deaf ? ", but does not hear the gateway"
                                           : hears_again  ? ", and hears the gateway again"
                                                          : ""),
                       .robot = change.robot,
                       .occasion = Occasion::robot_presence,
                       .is_proven = change.is_proven});
}

void Gateway::handle(SignOfLife sign, const Now& now) {
  on_heard(sign.robot, registry_.on_sign_of_life(sign.robot, now), now);
}

/// Publishes the presence again when its `last_seen` is older than `presence_refresh`.
void Gateway::on_heard(const std::string& id, Robot* robot, TimePoint now) {
  if (!waiting_wills_.empty()) waiting_wills_.erase(id);
  const bool is_due =
      robot && (robot->is_announcement_due || now - robot->announced >= presence_refresh);
  if (is_due && robot->presence().is_known) announce(id, *robot, now);
}

void Gateway::on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now) {
  const auto open = open_receipts_.take(receipt);
  Robot* robot = open && outcome == ReceiptOutcome::safe ? registry_.find(open->robot) : nullptr;
  if (!robot) return;
  robot->numbers.on_safe(std::chrono::duration_cast<std::chrono::microseconds>(now - open->since),
                         now);
}

void Gateway::subscribe_own(const std::string& filter) {
  if (own_filters_.insert(filter).second && broker_.is_up) actions_.push(SubscribeAtBroker{filter});
}

void Gateway::unsubscribe_own(const std::string& filter) {
  if (own_filters_.erase(filter) > 0 && broker_.is_up) actions_.push(UnsubscribeAtBroker{filter});
}

void Gateway::hear_all_commands(bool does_hear) {
  if (does_hear) return subscribe_own(all_commands_);
  unsubscribe_own(all_commands_);
  strays_.clear();
}

void Gateway::handle(CommandOutcome outcome, const Now&) {
  // A command without an id came before a restart.
  if (outcome.id != CommandId::none && !commands_.end(outcome.id)) {
    ++traffic_.late_outcomes;
    return;
  }
  conclude(std::move(outcome));
}

void Gateway::conclude(CommandOutcome outcome) {
  actions_.push(Notice{
      severity_of(outcome.result),
      fmt::format("{} {} {} {} after {} ms{}{}", outcome.mesh ? to_string(*outcome.mesh) : "-",
                  outcome.robot, outcome.type, to_string(outcome.result), outcome.after.count(),
                  outcome.why.empty() ? "" : ": ", outcome.why),
      outcome.robot, Occasion::command_outcome, outcome.after});
  publish_outcome(std::move(outcome));
}

/// One log line for a burst: a server can invent names without end.
void Gateway::refuse_unknown(CommandOutcome outcome, const Now& now) {
  if (const auto count = unknown_throttle_.on_event(now.mono)) {
    actions_.push(Notice{
        Severity::warning,
        fmt::format("- {} {} refused: {}{}", outcome.robot, outcome.type, outcome.why,
                    *count > 1 ? fmt::format(" ({} like it since the last line)", *count) : ""),
        outcome.robot, Occasion::command_outcome});
  }
  publish_outcome(std::move(outcome));
}

void Gateway::publish_outcome(CommandOutcome outcome) {
  actions_.push(Upload{{scheme_.outcome_topic(outcome.robot), to_bytes(outcome_json(outcome)),
                        Qos::at_least_once, false},
                       no_receipt,
                       outcome.after});
  actions_.push(std::move(outcome));
}

void Gateway::handle(LinkChange change, const Now&) {
  LinkState& link = mesh_links_[change.mesh];
  const bool is_news = link.is_up != change.is_up || link.detail != change.detail;
  link = {change.is_up, change.detail};
  if (!is_news) return;
  actions_.push(Notice{change.is_up ? Severity::notice : Severity::warning,
                       fmt::format("{} link {}: {}", to_string(change.mesh),
                                   change.is_up ? "up" : "down", change.detail),
                       {},
                       Occasion::mesh_link});
}

void Gateway::handle(MeshStep step, const Now&) {
  Robot* robot = step.kind == MeshStep::Kind::repeat ? registry_.find(step.robot) : nullptr;
  if (robot) robot->numbers.on_repeat();
  actions_.push(std::move(step));
}

void Gateway::handle(Notice notice, const Now&) { actions_.push(std::move(notice)); }

void Gateway::on_broker_message(BrokerMessage message, const Now& now) {
  if (leftovers_.take(message)) return;
  if (rights_.take(message)) return probe_rights({});
  if (message.topic == scheme_.state_topic()) return on_own_state(message, now);
  const auto target = scheme_.parse_command_topic(message.topic);
  if (!target || message.retain || target->type == RightsProbe::level) return;
  const std::string robot(target->robot);
  if (places_.is_shown(robot)) return;  // its session brings it
  if (names_.is_banned(robot)) {
    deliver({robot, std::move(message)}, now);
    return;
  }
  if (registry_.find(robot)) actions_.push(WantSession{robot});
  strays_.add(std::move(message), robot, now.mono);
  refuse_strays(now);
}

/// Before the other gateways' robots are known, only those that there is no room for.
void Gateway::refuse_strays(const Now& now) {
  const bool is_settled = up_since_ && now.mono - *up_since_ >= settling;
  const TimePoint overdue_at = is_settled ? now.mono : TimePoint{};
  for (StrayCommands::Stray& stray : strays_.take_overdue(overdue_at)) refuse_stray(stray, now);
}

/// A robot that has come meanwhile has a session, which brings it the next command.
void Gateway::refuse_stray(const StrayCommands::Stray& stray, const Now& now) {
  const bool is_known = places_.is_shown(stray.robot) || registry_.find(stray.robot);
  if (is_known && !places_.is_refused(stray.robot)) return;
  const auto waited = std::chrono::duration_cast<std::chrono::milliseconds>(now.mono - stray.came);
  const std::string type(scheme_.parse_command_topic(stray.message.topic)->type);
  ++traffic_.down;
  refuse_unknown(
      {std::nullopt, commands_.next_id(), stray.robot, type, CommandResult::refused, waited,
       is_known ? "the broker does not give the robot's session to this gateway"
                : "no robot of this name is known here"},
      now);
}

/// A last will that comes after our `online` belongs to an earlier connection, so `online` is
/// published again. One that comes before it is overwritten by it.
void Gateway::on_own_state(const BrokerMessage& message, const Now& now) {
  sends_retained_ = sends_retained_ || message.retain;
  if (as_text(message.payload) != last_will_state) {
    if (!message.retain) is_state_heard_ = true;
    if (knows_others(now)) announce_unheld(now);
  } else if (is_state_heard_ && !is_stopping_) {
    publish_state();
  }
}

CommandId Gateway::on_operator_command(const std::string& robot, const std::string& type,
                                       Bytes payload, const Now& now) {
  if (places_.is_elsewhere(robot) && !places_.is_held(robot)) {
    const CommandId id = commands_.next_id();
    conclude({std::nullopt,
              id,
              robot,
              type,
              CommandResult::refused,
              {},
              "another gateway serves this robot"});
    return id;
  }
  return deliver(
      {robot, {scheme_.command_topic(robot, type), std::move(payload), Qos::at_least_once}}, now);
}

void Gateway::on_robot_message(RobotMessage message, const Now& now) {
  const auto target = scheme_.parse_command_topic(message.message.topic);
  if (target && target->type == RightsProbe::level) return;
  if (target && target->robot == message.robot) {
    deliver(std::move(message), now);
    return;
  }
  ++traffic_.down;
  actions_.push(DeliverToMesh{std::nullopt, std::move(message)});
}

/// The mesh that carries a command owes its outcome. A retained one waits at the broker.
CommandId Gateway::deliver(RobotMessage message, const Now& now) {
  ++traffic_.down;
  const std::string type(scheme_.parse_command_topic(message.message.topic)->type);
  const BrokerMessage& what = message.message;
  Command command{commands_.next_id(),        message.robot, type,
                  carrier_for(message.robot), what.retain,   what.waited};
  if (Robot* known = registry_.find(message.robot)) known->numbers.on_down(what.payload.size());
  actions_.push(TrafficEvent{.direction = Direction::down,
                             .mesh = command.carrier,
                             .robot = message.robot,
                             .type = type,
                             .topic = what.topic,
                             .payload = what.payload,
                             .qos = what.qos,
                             .update = {},
                             .wall = now.wall,
                             .at = now.mono,
                             .command = command.id});
  const bool is_banned = names_.is_banned(message.robot);
  if (is_banned || !command.carrier || !commands_.open(command, now.mono)) {
    if (!command.is_retained) refuse(command, now);
    return command.id;
  }
  message.command = command.id;
  actions_.push(DeliverToMesh{command.carrier, std::move(message)});
  return command.id;
}

void Gateway::on_stale_command(const std::string& robot, BrokerMessage message, bool has_begun_anew,
                               const Now&) {
  const auto target = scheme_.parse_command_topic(message.topic);
  if (!target || target->robot != robot) return;
  ++traffic_.down;
  conclude({std::nullopt, commands_.next_id(), robot, std::string(target->type),
            CommandResult::refused, message.waited,
            has_begun_anew
                ? "it waited at the broker, and the robot has begun a clean session since"
                : "it waited at the broker for too long while no gateway served the robot"});
}

void Gateway::refuse(const Command& command, const Now& now) {
  CommandOutcome outcome{command.carrier,
                         command.id,
                         command.robot,
                         command.type,
                         CommandResult::refused,
                         command.waited,
                         "too many commands are on their way"};
  if (names_.is_banned(command.robot)) {
    outcome.why = "the robot is banned (slam-gatewayctl unban)";
    return refuse_unknown(std::move(outcome), now);
  }
  if (command.carrier) return conclude(std::move(outcome));
  const bool is_known = registry_.find(command.robot) || places_.is_shown(command.robot);
  outcome.why = is_known ? "the robot is not connected" : "no robot of this name is known here";
  refuse_unknown(std::move(outcome), now);
}

/// A robot with addresses on several meshes gets a command once: where it can be reached.
std::optional<Mesh> Gateway::carrier_for(const std::string& robot) const {
  std::optional<Mesh> carrier;
  for (const Mesh mesh : all_meshes) {
    const auto presence = presence_on_(mesh, robot);
    if (presence && *presence != Presence::offline) return mesh;
    if (presence && !carrier) carrier = mesh;
  }
  return carrier;
}

void Gateway::on_broker_link(const Now& now) {
  is_state_heard_ = false;
  rights_.on_broker_link(broker_.is_up && settings_.probes_rights);
  up_since_.reset();
  wills_due_.reset();
  announce_at_.reset();
  if (!broker_.is_up) return;
  up_since_ = now.mono;
  if (!waiting_wills_.empty()) wills_due_ = now.mono + will_patience;
  for (const std::string& filter : own_filters_) actions_.push(SubscribeAtBroker{filter});
  leftovers_.on_broker_up(now.mono);
  if (settings_.probes_rights)
    for (const std::string& filter : rights_.filters()) actions_.push(SubscribeAtBroker{filter});
  publish_state();
  for (const std::string& robot : std::exchange(to_withdraw_, {})) withdraw(robot);
  announce_at_ = now.mono + settling;
}

void Gateway::announce_unheld(const Now& now) {
  announce_at_.reset();
  for (auto& [id, robot] : registry_.robots())
    if (robot.is_announcement_due || !places_.is_held(id)) announce(id, robot, now.mono);
}

void Gateway::announce_all(const Now& now) {
  for (auto& [id, robot] : registry_.robots()) announce(id, robot, now.mono);
}

std::optional<TimePoint> Gateway::deadline() const {
  if (!broker_.is_up) return commands_.deadline();
  auto next = earlier(earlier(leftovers_.deadline(), rights_.deadline()),
                      earlier(wills_due_, announce_at_));
  if (const auto strays = strays_.deadline(); strays && up_since_)
    next = earlier(next, std::max(*strays, *up_since_ + settling));
  return earlier(next, commands_.deadline());
}

void Gateway::on_deadline(const Now& now) {
  for (Command& command : commands_.take_overdue(now.mono)) {
    if (command.is_retained) continue;
    conclude({command.carrier, command.id, std::move(command.robot), std::move(command.type),
              CommandResult::timeout, CommandLedger::patience,
              "the mesh has not reported its outcome"});
  }
  if (!broker_.is_up) return;
  refuse_strays(now);
  if (wills_due_ && now.mono >= *wills_due_) publish_waiting_wills(now);
  if (announce_at_ && now.mono >= *announce_at_) announce_unheld(now);
  end_leftovers(now);
  probe_rights(rights_.on_tick(now));
}

void Gateway::probe_rights(std::vector<BrokerMessage> messages) {
  for (BrokerMessage& message : messages) actions_.push(Upload{std::move(message), no_receipt});
  if (auto notice = rights_.next_notice()) actions_.push(std::move(*notice));
}

/// Marks leftovers that were not heard as offline; the time is unknown.
void Gateway::end_leftovers(const Now& now) {
  const auto leftovers = leftovers_.finish(now.mono);
  if (!leftovers) return;
  for (const auto& [id, text] : *leftovers) {
    if (registry_.find(id)) continue;
    if (places_.is_elsewhere(id)) {
      publish_retained(scheme_.presence_topic(id), {});
      continue;
    }
    Json presence = Json::parse(text, nullptr, false);
    if (!presence.is_object() || presence.value("state", Json{}) == "offline") continue;
    presence["state"] = "offline";
    presence["since"] = to_iso8601(now.wall);
    publish_retained(scheme_.presence_topic(id), presence.dump());
  }
}

void Gateway::on_subscribe_result(const std::string& filter, bool is_granted, const Now& now) {
  if (rights_.is_own(filter)) {
    if (auto question = rights_.on_subscribe_result(filter, is_granted, now))
      return probe_rights({std::move(*question)});
    return probe_rights({});
  }
  if (is_granted) return;
  actions_.push(
      Notice{Severity::warning,
             fmt::format("the broker refused the subscription to '{}': its access control list "
                         "must let this gateway read it",
                         filter),
             {}});
}

void Gateway::on_store(bool is_full) {
  if (std::exchange(is_store_full_, is_full) != is_full && broker_.is_up) publish_state();
}

void Gateway::on_configured(std::set<std::string> robots, const Now&) {
  const std::set<std::string> before = registry_.configured();
  registry_.set_configured(std::move(robots));
  for (const std::string& robot : before) {
    const Robot* known = registry_.find(robot);
    const bool is_there = known && known->presence().presence != Presence::offline;
    if (!registry_.is_configured(robot) && !is_there) forget(robot);
  }
}

std::string Gateway::forget(const std::string& robot) {
  std::string refusal = drop(robot);
  if (refusal.empty()) retained_.forget(robot);
  return refusal;
}

std::string Gateway::drop(const std::string& robot) {
  if (!is_valid_level(robot)) return "a robot's id is one topic level";
  const Robot* known = registry_.find(robot);
  if (known && known->presence().presence != Presence::offline)
    return fmt::format("{} is {}: switch it off first, or it would be back at once", robot,
                       to_string(known->presence().presence));
  registry_.forget(robot);
  withdraw(robot);
  actions_.push(RobotForgotten{robot});
  return {};
}

/// An empty retained message deletes the retained one at the broker.
void Gateway::withdraw(const std::string& robot) {
  if (broker_.is_up) {
    publish_retained(scheme_.presence_topic(robot), "");
  } else if (to_withdraw_.size() < RobotRegistry::max_robots) {
    to_withdraw_.insert(robot);
  }
}

void Gateway::withdraw_evicted() {
  for (const std::string& robot : registry_.take_evicted()) {
    withdraw(robot);
    actions_.push(RobotForgotten{robot});
  }
}

void Gateway::on_stop(const Now& now) {
  is_stopping_ = true;
  for (const StrayCommands::Stray& stray : strays_.take_overdue(TimePoint::max()))
    refuse_stray(stray, now);
  if (broker_.is_up) publish_state();  // else its last will has said the same
}

/// Publishes `offline` even if the broker comes only now: after a clean shutdown there is no last
/// will.
void Gateway::publish_state() {
  if (is_stopping_)
    return publish_retained(scheme_.state_topic(), Json{{"state", "offline"}}.dump());
  Json state{{"state", "online"},
             {"version", settings_.version},
             {"since", to_iso8601(settings_.started)}};
  if (is_store_full_) state["store"] = "full";
  publish_retained(scheme_.state_topic(), state.dump());
}

/// While the broker is away nothing is queued: everything is published again when it comes. A robot
/// whose session this gateway does not hold is announced when no other gateway shows it, which the
/// broker has told by then.
void Gateway::announce(const std::string& id, Robot& robot, TimePoint now) {
  robot.announced = now;
  if (!broker_.is_up) return;
  robot.is_announcement_due =
      !places_.is_held(id) && (!knows_others(now) || places_.is_elsewhere(id));
  if (!robot.is_announcement_due)
    publish_retained(scheme_.presence_topic(id), presence_json(robot));
}

/// A broker that sends what it retains does so before our own new state comes back.
bool Gateway::knows_others(TimePoint now) const {
  return (sends_retained_ && is_state_heard_ && places_.is_alone()) ||
         (up_since_ && now - *up_since_ >= settling);
}

void Gateway::on_session_held(const std::string& robot, bool was_present,
                              const std::string& dead_owner, const Now& now) {
  if (!dead_owner.empty()) publish_retained(scheme_.presence_topic_at(dead_owner, robot), {});
  Robot* known = registry_.find(robot);
  if (known && known->presence().is_known) announce(robot, *known, now.mono);
  if (auto will = waiting_wills_.extract(robot)) pass_up(std::move(will.mapped()), now);
  if (was_present) return;
  for (StrayCommands::Stray& stray : strays_.take_for(robot)) {  // the session came behind them
    stray.message.waited = std::chrono::duration_cast<Waited>(now.mono - stray.came);
    deliver({robot, std::move(stray.message)}, now);
  }
}

void Gateway::on_given_up(const std::string& robot) {
  waiting_wills_.erase(robot);
  registry_.forget(robot);
  withdraw(robot);
}

void Gateway::on_handed_on(CommandId command) {
  if (commands_.end(command)) actions_.push(CommandHandedOn{command});
}

void Gateway::on_contested(const std::string& robot, bool is_contested, const Now& now) {
  Robot* known = registry_.find(robot);
  if (!known || std::exchange(known->is_session_contested, is_contested) == is_contested) return;
  announce(robot, *known, now.mono);
}

void Gateway::publish_retained(std::string topic, std::string payload) {
  actions_.push(
      Upload{{std::move(topic), to_bytes(payload), Qos::at_least_once, true}, no_receipt});
}

}  // namespace slamgw
