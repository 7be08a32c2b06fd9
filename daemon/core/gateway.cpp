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
          .is_rejected = normalized.is_rejected};
}

}  // namespace

Gateway::Gateway(TopicScheme scheme, Settings settings, const BrokerLink& broker,
                 PresenceQuery presence_on)
    : scheme_(std::move(scheme)),
      settings_(std::move(settings)),
      broker_(broker),
      leftovers_(scheme_.presence_topic("+")),
      rights_(scheme_),
      presence_on_(std::move(presence_on)),
      commands_(settings_.max_open_commands) {}

void Gateway::on_mesh_event(MeshEvent event, const Now& now) {
  std::visit([&](auto& what) { handle(std::move(what), now); }, event);
}

void Gateway::handle(Report report, const Now& now) {
  if (report.is_will && ownership_.is_shared()) {
    actions_.push(AskAboutRobot{std::move(report)});
    return;
  }
  pass_up(std::move(report), now);
}

void Gateway::pass_up(Report report, const Now& now) {
  const Robot* known = registry_.find(report.robot);
  const bool is_first_by_radio = report.radio && known && !known->radio;
  const bool retain = report.retain;
  Robot* robot = registry_.on_report(report, now);
  withdraw_evicted();
  if (robot && is_first_by_radio) announce(report.robot, *robot, now);  // its presence came before
  if (!report.is_will) on_heard(report.robot, robot, now);
  open_receipts_.add(report.receipt, report.robot, now);
  const auto own = scheme_.parse_robot_topic(report.topic);
  std::string type(own ? own->type : std::string_view{report.topic});

  Normalized normalized = normalize(own ? own->type : std::string_view{}, std::move(report.payload),
                                    settings_.update_mode);
  if (robot && !report.is_will) robot->last_type = type;
  TrafficEvent event = event_of(std::move(report), std::move(type), std::move(normalized), now);
  if (event.is_rejected) return reject(std::move(event), retain, robot, now);
  ++traffic_.up;
  actions_.push(PassUp{std::move(event), retain});
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
    actions_.push(Notice{
        Severity::warning,
        fmt::format("{} {}: {} bytes are no `update` (4 + 4n or 4 + 4n + 1, n = 0..4), published "
                    "under rejected/ as they came{}",
                    to_string(*event.mesh), event.robot, event.payload.size(),
                    *due > 1 ? fmt::format("; {} like it since the last line", *due) : ""),
        event.robot, Occasion::rejected_payload});
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
  if (robot) announce(change.robot, *robot, now);
  actions_.push(Notice{change.is_deaf ? Severity::warning : Severity::info,
                       fmt::format("{} {} is {} at {}{}", to_string(change.mesh), change.robot,
                                   to_string(change.presence), change.address,
                                   change.is_deaf ? ", but does not hear the gateway"
                                   : hears_again  ? ", and hears the gateway again"
                                                  : ""),
                       change.robot, Occasion::robot_presence});
}

void Gateway::handle(SignOfLife sign, const Now& now) {
  on_heard(sign.robot, registry_.on_sign_of_life(sign.robot, now), now);
}

/// Publishes the presence again when its `last_seen` is older than `presence_refresh`.
void Gateway::on_heard(const std::string& id, Robot* robot, TimePoint now) {
  if (robot && now - robot->announced >= presence_refresh && robot->presence().is_known)
    announce(id, *robot, now);
}

void Gateway::on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now) {
  const auto open = open_receipts_.take(receipt);
  Robot* robot = open && outcome == ReceiptOutcome::safe ? registry_.find(open->robot) : nullptr;
  if (!robot) return;
  robot->numbers.on_safe(std::chrono::duration_cast<std::chrono::microseconds>(now - open->since),
                         now);
}

void Gateway::handle(SubscribeRequest request, const Now&) {
  const auto& wanted =
      subscriptions_.add(request.mesh, request.filter, request.qos, request.wants_retained);
  subscriptions_.set_cover(request.filter, is_covered(request.filter, wanted));
  // While the broker is away it is taken now, and subscribed as soon as the broker is there.
  const bool is_asked = broker_.is_up && !wanted.is_covered;
  if (is_asked && !broker_.is_silent)
    subscriptions_.await(request.mesh, request.filter);
  else
    actions_.push(AnswerSubscribe{request.mesh, request.filter, true});
  if (is_asked) ask_broker(request.filter, wanted);
}

/// On a broker that keeps no session all commands come with QoS 0, and so do robots' own filters of
/// commands: a broker may bring copies of different QoS far apart, or where it sends one otherwise.
void Gateway::ask_broker(const std::string& filter, const SubscriptionTable::Wanted& wanted) {
  const bool is_live = hears_commands_live() && filter.starts_with(scheme_.command_root());
  actions_.push(SubscribeAtBroker{filter, is_live ? Qos::at_most_once : wanted.qos, wanted.id});
}

/// True for a filter of commands whose messages the subscription to all commands brings. One that
/// wants fresh commands only is covered from its beginning; one that the broker has stays there.
bool Gateway::is_covered(const std::string& filter, const SubscriptionTable::Wanted& wanted) const {
  if (filter == all_commands_ || !filter_matches(all_commands_, filter)) return false;
  if (!is_all_refused_ && ownership_.hears_all_commands()) return true;
  const auto all = subscriptions_.wanted().find(all_commands_);
  return wanted.is_covered && !wanted.wants_retained && !is_all_refused_ &&
         all != subscriptions_.wanted().end() &&
         wanted.qos <= (hears_commands_live() ? Qos::at_least_once : all->second.qos);
}

/// When the subscription to all commands starts, robots' own subscriptions to commands end; they
/// return when it ends. They end at once, because a broker may send two copies in any order while
/// both stand. Another gateway hears and refuses what comes before the new subscription stands.
void Gateway::cover_commands() {
  for (const std::string& filter :
       subscriptions_.set_cover(std::bind_front(&Gateway::is_covered, this))) {
    const auto& wanted = subscriptions_.wanted().at(filter);
    if (wanted.is_covered)
      actions_.push(UnsubscribeAtBroker{filter});
    else
      ask_broker(filter, wanted);
  }
}

void Gateway::subscribe_own(const std::string& filter) {
  const auto& wanted = subscriptions_.add_own(filter);
  has_asked_for_all_ = has_asked_for_all_ || filter == all_commands_;
  if (filter == all_commands_ && broker_.is_up) cover_commands();
  if (broker_.is_up) ask_broker(filter, wanted);
}

void Gateway::unsubscribe_own(const std::string& filter) {
  const bool was_last = subscriptions_.remove_own(filter);
  if (filter == all_commands_ && broker_.is_up) cover_commands();
  if (was_last) actions_.push(UnsubscribeAtBroker{filter});
}

void Gateway::handle(UnsubscribeRequest request, const Now&) {
  const bool was_last = subscriptions_.remove(request.mesh, request.filter);
  if (was_last) actions_.push(UnsubscribeAtBroker{std::move(request.filter)});
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

void Gateway::on_broker_message(BrokerMessage message,
                                std::span<const SubscriptionId> subscriptions, const Now& now) {
  if (leftovers_.take(message, now.mono)) return;
  if (rights_.take(message)) return on_own_question();
  // Retained messages come for the subscription that asked for them only.
  if (!message.retain && !subscriptions_.is_copy_to_take(message, subscriptions)) return;
  if (ownership_.takes(message)) return;
  const auto target = scheme_.parse_command_topic(message.topic);
  if (hears_commands_live() && message.topic.starts_with(scheme_.command_root()))
    message.qos = std::max(message.qos, Qos::at_least_once);  // as the server may have sent it
  if (!target && message.topic == scheme_.state_topic()) return on_own_state(message);
  if (!target || !ownership_.is_shared()) return take_command(std::move(message), now);
  const std::string robot(target->robot);
  const std::string type(target->type);
  actions_.push(AwaitTurn{std::move(message), robot, type});
}

/// The probe's message also matches the subscription to all commands, so a broker that sends one
/// copy for each subscription has sent two.
void Gateway::on_own_question() {
  if (rights_.copies() && subscriptions_.is_standing(all_commands_))
    subscriptions_.set_sends_copies(*rights_.copies() > 1);
  probe_rights({});
}

/// Takes a command that this gateway carries out, or another message of the broker. Commands for
/// one robot keep their order.
void Gateway::take_command(BrokerMessage message, const Now& now) {
  const auto target = scheme_.parse_command_topic(message.topic);
  const std::string robot(target ? target->robot : std::string_view{});
  if (target && is_stray(message, robot)) {
    if (target->type == RightsProbe::level) return;  // the probe of a gateway
    strays_.add(std::move(message), robot, now.mono);
    return deliver_strays(strays_.take_overdue(now.mono), now);
  }
  if (target && !strays_.is_empty()) deliver_strays(strays_.take_for(robot), now);
  deliver(std::move(message), now);
}

/// True for a command that only the subscription to all commands brought, for a robot that no mesh
/// knows yet. Retained commands wait at the broker.
bool Gateway::is_stray(const BrokerMessage& message, const std::string& robot) const {
  return !message.retain && !is_stopping_ && !ownership_.is_shared() && !carrier_for(robot) &&
         subscriptions_.is_only_of(all_commands_, message.topic);
}

/// Other gateways may have appeared meanwhile; then the gateways agree on who answers.
void Gateway::deliver_strays(std::vector<StrayCommands::Stray> strays, const Now& now) {
  for (StrayCommands::Stray& stray : strays) {
    stray.message.waited = std::chrono::duration_cast<Waited>(now.mono - stray.came);
    if (!ownership_.is_shared()) {
      deliver(std::move(stray.message), now);
      continue;
    }
    const std::string type(scheme_.parse_command_topic(stray.message.topic)->type);
    actions_.push(AwaitTurn{std::move(stray.message), std::move(stray.robot), type});
  }
}

/// A last will that comes after our `online` belongs to an earlier connection, so `online` is
/// published again. One that comes before it is overwritten by it.
void Gateway::on_own_state(const BrokerMessage& message) {
  if (as_text(message.payload) != last_will_state) {
    is_state_heard_ = true;
  } else if (is_state_heard_ && !is_stopping_) {
    publish_state();
  }
}

CommandId Gateway::on_operator_command(const std::string& robot, const std::string& type,
                                       Bytes payload, const Now& now) {
  if (!ownership_.speaks_for(robot)) {
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
      {scheme_.command_topic(robot, type), std::move(payload), Qos::at_least_once, false}, now);
}

CommandId Gateway::deliver(BrokerMessage message, const Now& now) {
  ++traffic_.down;
  const auto target = scheme_.parse_command_topic(message.topic);
  if (!target) {
    actions_.push(DeliverToMeshes{std::move(message)});
    return CommandId::none;
  }
  const std::string robot(target->robot);
  Command command{commands_.next_id(), robot,          std::string(target->type),
                  carrier_for(robot),  message.retain, message.waited};
  if (Robot* known = registry_.find(robot)) known->numbers.on_down(message.payload.size());
  actions_.push(TrafficEvent{.direction = Direction::down,
                             .mesh = command.carrier,
                             .robot = robot,
                             .type = command.type,
                             .topic = message.topic,
                             .payload = message.payload,
                             .qos = message.qos,
                             .update = {},
                             .wall = now.wall,
                             .at = now.mono,
                             .command = command.id});
  deliver_command(command, std::move(message), now);
  return command.id;
}

/// The message goes to the meshes in any case: other robots may listen to it.
void Gateway::deliver_command(const Command& command, BrokerMessage message, const Now& now) {
  const bool is_open = command.carrier && commands_.open(command, now);
  const CommandId id = is_open ? command.id : CommandId::none;
  actions_.push(DeliverToMeshes{std::move(message), id, command.carrier});
  if (!is_open && !command.is_retained) refuse(command, now);  // a retained one waits at the broker
}

void Gateway::refuse(const Command& command, const Now& now) {
  CommandOutcome outcome{command.carrier,
                         command.id,
                         command.robot,
                         command.type,
                         CommandResult::refused,
                         command.waited,
                         "too many commands are on their way"};
  if (command.carrier) return conclude(std::move(outcome));
  outcome.why = registry_.find(command.robot) ? "the robot is not connected"
                                              : "no robot of this name is known here";
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
  subscribers_wait_until_.reset();
  subscriptions_.on_connection_changed(broker_.keeps_session);
  if (!broker_.is_up) {
    subscribers_wait_until_ = now.mono + subscribe_patience;
    return;
  }
  subscriptions_.set_cover(std::bind_front(&Gateway::is_covered, this));
  for (const auto& [filter, wanted] : subscriptions_.wanted())
    if (!wanted.is_covered) ask_broker(filter, wanted);
  leftovers_.on_broker_up(now.mono);
  if (leftovers_.is_collecting())
    actions_.push(SubscribeAtBroker{leftovers_.filter(), Qos::at_least_once, own_subscription});
  if (settings_.probes_rights)
    for (const std::string& filter : rights_.filters())
      actions_.push(SubscribeAtBroker{filter, Qos::at_most_once, own_subscription});
  publish_state();
  for (const std::string& robot : std::exchange(to_withdraw_, {})) withdraw(robot);
  for (auto& [id, robot] : registry_.robots()) announce(id, robot, now, /*has_just_come=*/false);
}

void Gateway::on_broker_silence(const Now&) {
  if (broker_.is_silent) answer_waiting_subscribers();
}

std::optional<TimePoint> Gateway::deadline() const {
  const auto of_broker = earlier(leftovers_.deadline(), rights_.deadline());
  return earlier(earlier(commands_.deadline(), strays_.deadline()),
                 broker_.is_up ? of_broker : subscribers_wait_until_);
}

void Gateway::on_deadline(const Now& now) {
  for (Command& command : commands_.take_overdue(now)) {
    if (command.is_retained) continue;
    conclude({command.carrier, command.id, std::move(command.robot), std::move(command.type),
              CommandResult::timeout, CommandLedger::patience,
              "the mesh has not reported its outcome"});
  }
  deliver_strays(strays_.take_overdue(now.mono), now);
  if (subscribers_wait_until_ && now.mono >= *subscribers_wait_until_) answer_waiting_subscribers();
  if (!broker_.is_up) return;
  end_leftovers(now);
  probe_rights(rights_.on_tick(now));
}

void Gateway::answer_waiting_subscribers() {
  subscribers_wait_until_.reset();
  for (auto& [mesh, filter] : subscriptions_.take_all_waiting())
    actions_.push(AnswerSubscribe{mesh, std::move(filter), true});
}

void Gateway::probe_rights(std::vector<BrokerMessage> messages) {
  for (BrokerMessage& message : messages) actions_.push(Upload{std::move(message), no_receipt});
  if (auto notice = rights_.next_notice()) actions_.push(std::move(*notice));
}

/// Marks leftovers that were not heard as offline; the time is unknown.
void Gateway::end_leftovers(const Now& now) {
  const auto leftovers = leftovers_.finish(now.mono);
  if (leftovers_.end_subscription(now.mono))
    actions_.push(UnsubscribeAtBroker{leftovers_.filter()});
  if (!leftovers) return;
  for (const auto& [id, text] : *leftovers) {
    if (registry_.find(id)) continue;
    if (!ownership_.speaks_for(id)) {
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

void Gateway::on_subscribe_result(const std::string& filter, SubscribeAnswer answer,
                                  const Now& now) {
  const bool granted = answer == SubscribeAnswer::granted;
  if (rights_.is_own(filter)) {
    if (auto question = rights_.on_subscribe_result(filter, granted, now))
      return probe_rights({std::move(*question)});
    return probe_rights({});
  }
  for (const Mesh mesh : subscriptions_.on_answer(filter, granted))
    actions_.push(AnswerSubscribe{mesh, filter, granted});
  if (filter == all_commands_) {
    is_all_refused_ = !granted;
    if (broker_.is_up) cover_commands();
    if (granted && !std::exchange(was_all_granted_, true) && broker_.keeps_session)
      for (std::string& covered : subscriptions_.covered())  // of an earlier process
        actions_.push(UnsubscribeAtBroker{std::move(covered)});
    if (auto question = rights_.ask_under_server(now)) probe_rights({std::move(*question)});
  }
  if (granted) return leftovers_.on_granted(filter, now.mono);
  actions_.push(Notice{Severity::warning, in_words(filter, answer), {}});
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
  deliver_strays(strays_.take_overdue(TimePoint::max()), now);
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

void Gateway::announce(const std::string& id, Robot& robot, TimePoint now, bool has_just_come) {
  robot.announced = now;
  // While the broker is away nothing is queued: everything is published again when it comes.
  if (broker_.is_up && ownership_.may_announce(id, robot.presence().presence, has_just_come))
    publish_retained(scheme_.presence_topic(id), presence_json(robot));
}

void Gateway::on_taken_over(const std::string& robot, const std::string& dead_owner,
                            const Now& now) {
  if (!broker_.is_up) return;
  if (!dead_owner.empty()) publish_retained(scheme_.presence_topic_at(dead_owner, robot), {});
  Robot* known = registry_.find(robot);
  if (known && known->presence().is_known) announce(robot, *known, now);
}

void Gateway::on_given_up(const std::string& robot) {
  registry_.forget(robot);
  withdraw(robot);
}

void Gateway::publish_retained(std::string topic, std::string payload) {
  actions_.push(
      Upload{{std::move(topic), to_bytes(payload), Qos::at_least_once, true}, no_receipt});
}

}  // namespace slamgw
