// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/gateway.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw {
namespace {

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
          .address = std::move(report.address),
          .radio = report.radio,
          .had_stray_octet = normalized.had_stray_octet,
          .is_rejected = normalized.is_rejected,
          .is_proven = report.is_proven};
}

}  // namespace

Gateway::Gateway(TopicScheme scheme, Settings settings, const BrokerLink& broker,
                 PresenceQuery presence_on)
    : scheme_(std::move(scheme)),
      settings_(std::move(settings)),
      broker_(broker),
      directory_{RobotRegistry(), RobotNames(), {}, std::move(presence_on), {}},
      presence_(scheme_, settings_, broker_, directory_, actions_),
      commands_(scheme_, directory_, actions_, settings_.max_open_commands),
      rights_(scheme_, broker_, actions_) {}

void Gateway::on_mesh_event(MeshEvent event, const Now& now) {
  std::visit([&](auto& what) { handle(std::move(what), now); }, event);
}

void Gateway::handle(Report report, const Now& now) {
  if (report.is_will && presence_.keep_will(report, now)) return;
  if (!report.is_will && directory_.names.is_on_both(report.robot) && is_copy(report, now)) return;
  pass_up(std::move(report), now);
}

/// Returns true for a copy of a message that went up already. Notes the sign of life, and
/// acknowledges the copy at once if that message is safe.
bool Gateway::is_copy(const Report& report, const Now& now) {
  const CopyFilter::Copy copy = copies_.on_report(report, now.mono);
  if (copy == CopyFilter::Copy::none) return false;
  handle(SignOfLife{report.mesh, report.robot}, now);
  handle(MessageStep{.kind = StepKind::repeat,
                     .mesh = report.mesh,
                     .robot = report.robot,
                     .topic = report.topic,
                     .qos = report.qos,
                     .wire = report.wire,
                     .bytes = report.payload.size(),
                     .radio = report.radio},
         now);
  if (copy == CopyFilter::Copy::safe && report.receipt.is_owed())
    actions_.push(FireReceipt{report.receipt, ReceiptOutcome::safe});
  return true;
}

void Gateway::pass_up(Report report, const Now& now) {
  const Robot* known = directory_.registry.find(report.robot);
  const bool is_first_by_radio = report.radio && known && !known->on_mesh[report.mesh].radio;
  const auto own = scheme_.parse_robot_topic(report.topic);
  // Where no robot's topic is, the last level is what an operator calls the type.
  std::string type(own ? own->type
                       : std::string_view(report.topic).substr(report.topic.rfind('/') + 1));
  const bool is_clearing = report.retain && report.payload.empty();
  Robot* robot = directory_.registry.on_report(report, now);
  presence_.withdraw_evicted();
  if (robot && is_first_by_radio)
    presence_.announce(report.robot, *robot, now.mono);  // announced before without radio facts
  if (!report.is_will) presence_.on_heard(report.robot, robot, now.mono);
  if (report.receipt.is_owed() && open_receipts_.size() < max_open_receipts)
    open_receipts_.insert_or_assign({report.receipt.mesh, report.receipt.id},
                                    Arrival{report.robot, now});

  // An empty message that clears a retained `update` is no update.
  const bool is_update = own && !is_clearing;
  Normalized normalized = normalize(is_update ? own->type : std::string_view{},
                                    std::move(report.payload), settings_.update_mode);
  if (robot && !report.is_will) robot->last_type = type;
  const bool retain =
      report.retain && !normalized.is_rejected && may_retain(report, type, is_clearing, now);
  TrafficEvent event = event_of(std::move(report), std::move(type), std::move(normalized), now);
  ++traffic_.up;
  if (event.mesh) ++traffic_.up_on[*event.mesh];
  if (event.is_rejected) return reject(std::move(event), robot, now);
  actions_.push(PassUp{std::move(event), retain});
}

/// An empty message clears the topic, so it may always be retained.
bool Gateway::may_retain(const Report& report, std::string_view type, bool is_clearing,
                         const Now& now) {
  const bool is_named =
      is_clearing || std::ranges::any_of(settings_.retain, [&](const std::string& named) {
        return named == "*" || named == type;
      });
  if (is_named && retained_.admit(report.robot, report.topic, is_clearing)) return true;
  ++traffic_.not_retained;
  const std::string why =
      is_named ? fmt::format("limit reached: {} retained topics per robot, {} in total",
                             RetainedTopics::max_per_robot, RetainedTopics::max_in_all)
               : "topics.retain does not name its type";
  if (const auto count = retained_throttles_[report.is_proven].on_event(now.mono))
    actions_.push(
        Notice{.severity = Severity::warning,
               .text = fmt::format(
                   "{} {}: '{}' is published without its retain flag: {}{}", to_string(report.mesh),
                   report.robot, report.topic, why,
                   *count > 1 ? fmt::format("; {} such messages since the last line", *count) : ""),
               .robot = report.robot,
               .is_proven = report.is_proven});
  return false;
}

Upload PassUp::upload() {
  return {{std::move(event.topic), std::move(event.payload), event.qos, retain,
           Provenance{*event.mesh, event.wall}},
          event.receipt};
}

/// Never retains the message: its robot could not clear it.
void Gateway::reject(TrafficEvent event, Robot* robot, const Now& now) {
  ++traffic_.rejected;
  actions_.push(event);
  const auto due = robot ? robot->rejected_throttle.on_event(now.mono) : std::nullopt;
  if (due) {
    actions_.push(Notice{
        .severity = Severity::warning,
        .text = fmt::format(
            "{} {}: {} bytes are not a valid `update` (4 + 4n or 4 + 4n + 1, n = 0..4), published "
            "under rejected/ as they came{}",
            to_string(*event.mesh), event.robot, event.payload.size(),
            *due > 1 ? fmt::format("; {} such messages since the last line", *due) : ""),
        .robot = event.robot,
        .occasion = Occasion::rejected_payload,
        .is_proven = event.is_proven,
        .mesh = event.mesh,
        .type = event.type});
  }
  PassUp up{std::move(event), /*retain=*/false};
  up.event.topic = scheme_.rejected_topic(up.event.robot, up.event.type);
  actions_.push(up.upload());
}

void Gateway::handle(SignOfLife sign, const Now& now) {
  presence_.on_heard(sign.robot, directory_.registry.on_sign_of_life(sign.robot, sign.mesh, now),
                     now.mono);
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

void Gateway::handle(MessageStep step, const Now&) {
  Robot* robot = step.kind == StepKind::repeat ? directory_.registry.find(step.robot) : nullptr;
  if (robot && step.mesh) {
    robot->numbers.on_repeat();
    ++robot->on_mesh[*step.mesh].repeats;
  }
  actions_.push(std::move(step));
}

void Gateway::on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now) {
  if (const auto copy = copies_.on_receipt(receipt, outcome))
    actions_.push(FireReceipt{*copy, outcome});
  const auto open = open_receipts_.extract({receipt.mesh, receipt.id});
  if (!open || outcome != ReceiptOutcome::safe) return;
  const Arrival& arrival = open.mapped();
  const auto latency = std::chrono::duration_cast<std::chrono::microseconds>(now - arrival.at);
  latencies_[receipt.mesh].add(latency);
  if (Robot* robot = directory_.registry.find(arrival.robot)) robot->numbers.on_safe(latency, now);
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
  commands_.forget_strays();
}

void Gateway::on_broker_link(const Now& now) {
  if (broker_.is_up)
    for (const std::string& filter : own_filters_) actions_.push(SubscribeAtBroker{filter});
  rights_.on_broker_link();
  presence_.on_broker_link(now);
  commands_.on_broker_link(presence_.settled_at());
}

void Gateway::on_subscribe_result(const std::string& filter, bool is_granted, const Now& now) {
  if (rights_.on_subscribe_result(filter, is_granted, now) || is_granted) return;
  actions_.push(
      Notice{Severity::warning,
             fmt::format("the broker refuses the subscription to '{}': its access control list may "
                         "lack it, or its log says why",
                         filter),
             {}});
}

void Gateway::on_broker_message(BrokerMessage message, const Now& now) {
  if (presence_.take(message, now) || rights_.take(message)) return;
  const auto target = scheme_.parse_command_topic(message.topic);
  if (!target || message.retain || RightsProbe::is_of_any_gateway(target->type, message)) return;
  commands_.on_stray_command(std::move(message), now);
}

/// If the session has just begun, delivers the stray commands, which the session does not bring.
void Gateway::on_session_held(const std::string& robot, bool was_present,
                              const std::string& dead_owner, const Now& now) {
  presence_.on_session_held(robot, dead_owner, now);
  on_session_proven(robot, now);
  commands_.on_session_held(robot, was_present, now);
}

void Gateway::on_session_proven(const std::string& robot, const Now& now) {
  if (auto will = presence_.take_will(robot)) pass_up(std::move(*will), now);
}

void Gateway::on_configured(std::set<std::string> robots) {
  const std::set<std::string> before = directory_.registry.configured();
  directory_.registry.set_configured(std::move(robots));
  for (const std::string& robot : before) {
    const Robot* known = directory_.registry.find(robot);
    const bool is_there = known && known->presence().presence != Presence::offline;
    if (!directory_.registry.is_configured(robot) && !is_there) forget(robot);
  }
}

std::string Gateway::forget(const std::string& robot) {
  std::string refusal = presence_.drop(robot);
  if (!refusal.empty()) return refusal;
  retained_.forget(robot);
  copies_.forget(robot);
  directory_.choice.forget(robot);
  return refusal;
}

void Gateway::on_stop(const Now& now) {
  commands_.on_stop(now);
  presence_.on_stop();
}

std::optional<TimePoint> Gateway::deadline() const {
  return earlier(commands_.deadline(), earlier(presence_.deadline(), rights_.deadline()));
}

void Gateway::on_deadline(const Now& now) {
  commands_.on_deadline(now);
  for (Report& will : presence_.take_due_wills(now)) pass_up(std::move(will), now);
  presence_.on_deadline(now);
  rights_.on_deadline(now);
}

}  // namespace slamgw
