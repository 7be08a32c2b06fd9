// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/trace.hpp"

namespace slamgw {

namespace {

using std::chrono::duration_cast;
using std::chrono::microseconds;

}  // namespace

Trace::Key Trace::key_of(CommandId command) {
  return {all_meshes.size(), static_cast<std::uint64_t>(command)};
}

void Trace::turn(bool is_on) {
  is_on_ = is_on;
  followed_.clear();
  order_.clear();
}

void Trace::on_traffic(const TrafficEvent& event) {
  if (!is_on_) return;
  const bool is_up = event.direction == Direction::up;
  if (is_up && event.receipt.is_owed()) follow(key_of(event.receipt), event);
  if (!is_up && event.command != CommandId::none) follow(key_of(event.command), event);
  emit({{.kind = is_up ? StepKind::arrived : StepKind::command,
         .mesh = event.mesh,
         .robot = event.robot,
         .address = event.address,
         .topic = event.topic,
         .qos = event.qos,
         .wire = event.wire,
         .bytes = event.payload.size(),
         .radio = event.radio,
         .command = event.command,
         .why = event.is_rejected ? "not a valid update: published under rejected/" : ""},
        event.wall,
        event.type,
        /*latency=*/{},
        /*outcome=*/{},
        event.update,
        event.had_stray_octet,
        event.payload});
}

void Trace::on_step(const MessageStep& step, const Now& now) {
  if (!is_on_) return;
  const bool is_of_outbox = step.since.has_value();
  const Key key = is_down(step.kind) ? key_of(step.command) : key_of(step.receipt);
  TraceEvent event{step, now.wall};
  if (is_of_outbox) event.latency = duration_cast<microseconds>(now.mono - *step.since);
  complete(event, find(key), now.mono);
  const bool is_last =
      step.kind == StepKind::acknowledged || (step.kind == StepKind::refused && !is_of_outbox);
  if (is_last) followed_.erase(key);
  emit(std::move(event));
}

void Trace::on_outcome(const CommandOutcome& outcome, const Now& now) {
  if (!is_on_) return;
  const Key key = key_of(outcome.id);
  TraceEvent event{{.kind = StepKind::outcome,
                    .mesh = outcome.mesh,
                    .robot = outcome.robot,
                    .topic = scheme_.command_topic(outcome.robot, outcome.type),
                    .command = outcome.id,
                    .why = outcome.why},
                   now.wall,
                   outcome.type};
  event.outcome = outcome.result;
  complete(event, find(key), now.mono);
  if (!event.latency) event.latency = outcome.after;
  followed_.erase(key);
  emit(std::move(event));
}

void Trace::follow(const Key& key, const TrafficEvent& event) {
  if (order_.size() >= max_followed) {
    followed_.erase(order_.front());
    order_.pop_front();
  }
  order_.push_back(key);
  followed_.insert_or_assign(key, Followed{event.robot, event.topic, event.type, event.qos,
                                           event.wire, event.payload.size(), event.at});
}

const Trace::Followed* Trace::find(const Key& key) const {
  const auto found = followed_.find(key);
  return found == followed_.end() ? nullptr : &found->second;
}

void Trace::complete(TraceEvent& event, const Followed* followed, TimePoint now) const {
  if (followed) {
    if (event.robot.empty()) event.robot = followed->robot;
    // A payload that cannot be read is published under another topic than the one it came on.
    event.type = followed->type;
    if (event.topic.empty()) event.topic = followed->topic;
    if (!event.qos) event.qos = followed->qos;
    if (!event.wire.message_id) event.wire.message_id = followed->wire.message_id;
    if (!event.bytes) event.bytes = followed->bytes;
    event.latency = duration_cast<microseconds>(now - followed->at);
    return;
  }
  auto parsed = scheme_.parse_robot_topic(event.topic);  // also the topic of a relayed message
  if (!parsed) parsed = scheme_.parse_command_topic(event.topic);
  if (event.type.empty()) event.type = parsed ? std::string(parsed->type) : event.topic;
  if (event.robot.empty() && parsed) event.robot = parsed->robot;
}

void Trace::emit(TraceEvent event) {
  if (event.mesh && !event.robot.empty() && event.address.empty())
    event.address = address_of_(event.robot, *event.mesh);
  sink_(event);
}

}  // namespace slamgw
