// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/traffic_log.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "daemon/observability/notice_fields.hpp"

namespace slamgw {
namespace {

std::string_view mesh_name(const TrafficEvent& event) {
  return event.mesh ? to_string(*event.mesh) : "-";
}

std::string content(const TrafficEvent& event) {
  if (!event.update) return fmt::format("{} bytes", event.payload.size());
  return fmt::format("x={} y={} obstacles={}", event.update->robot.x_cm, event.update->robot.y_cm,
                     event.update->obstacles.size());
}

}  // namespace

bool LineBudget::take(TimePoint now) {
  const TimePoint earliest = now - at_once * interval;
  const TimePoint spent_until = std::max(spent_until_.value_or(earliest), earliest);
  if (spent_until + interval > now) return false;
  spent_until_ = spent_until + interval;
  return true;
}

std::optional<TrafficLine> TrafficSampler::on_traffic(const TrafficEvent& event, TimePoint now) {
  const auto of_stream = sample(event, now);
  if (!of_stream) return std::nullopt;
  if (!budget_.take(now)) {
    without_line_ += *of_stream;
    return std::nullopt;
  }
  return TrafficLine{*of_stream, std::exchange(without_line_, 0)};
}

std::optional<std::uint64_t> TrafficSampler::sample(const TrafficEvent& event, TimePoint now) {
  switch (mode_) {
    case TrafficLog::off: return std::nullopt;
    case TrafficLog::all: return 1;
    case TrafficLog::sampled: break;
  }
  std::string stream = event.robot + '/' + event.type;
  if (event.direction == Direction::down) stream += '/';
  if (streams_.size() >= max_streams && !streams_.contains(stream)) stream.clear();
  return streams_.try_emplace(std::move(stream), std::chrono::seconds{1})
      .first->second.on_event(now);
}

std::string traffic_text(const TrafficEvent& event, const TrafficLine& line) {
  std::string text = fmt::format("{}{} {} {} {}", event.direction == Direction::down ? "to " : "",
                                 mesh_name(event), event.robot, event.type, content(event));
  if (line.of_stream > 1) text += fmt::format(" ({} messages)", line.of_stream);
  if (line.of_others > 0)
    text += fmt::format(" (and {} of any robot: too many for lines of their own)", line.of_others);
  return text;
}

LogFields traffic_fields(const TrafficEvent& event) {
  LogFields fields{{"MESSAGE_ID", std::string(message_id_of(Occasion::robot_message))},
                   {"ROBOT_ID", event.robot},
                   {"MESSAGE_TYPE", event.type},
                   {"TOPIC", event.topic},
                   {"PAYLOAD_BYTES", std::to_string(event.payload.size())},
                   {"DIRECTION", event.direction == Direction::up ? "up" : "down"},
                   {"QOS", std::to_string(static_cast<int>(event.qos))}};
  if (event.mesh) fields.push_back({"MESH", std::string(to_string(*event.mesh))});
  if (event.update) {
    fields.push_back({"X_CM", std::to_string(event.update->robot.x_cm)});
    fields.push_back({"Y_CM", std::to_string(event.update->robot.y_cm)});
  }
  return fields;
}

std::optional<TrafficEntry> AwaitedLines::add(const TrafficEvent& event, TrafficEntry entry) {
  if (!event.receipt.is_owed() || lines_.size() >= max_lines) return entry;
  lines_.insert_or_assign(key_of(event.receipt), Line{event.at, std::move(entry)});
  return std::nullopt;
}

TrafficEntry AwaitedLines::on_receipt(const Receipt& receipt, ReceiptOutcome outcome,
                                      TimePoint now) {
  Line line = std::move(lines_.extract(key_of(receipt)).mapped());
  if (outcome == ReceiptOutcome::safe) {
    const auto latency = std::chrono::duration_cast<std::chrono::microseconds>(now - line.since);
    line.entry.fields.push_back({"LATENCY_US", std::to_string(latency.count())});
  }
  return std::move(line.entry);
}

std::vector<TrafficEntry> AwaitedLines::take_overdue(TimePoint now) {
  std::vector<TrafficEntry> overdue;
  for (auto line = lines_.begin(); line != lines_.end();) {
    const bool is_overdue = now - line->second.since >= patience;
    if (is_overdue) overdue.push_back(std::move(line->second.entry));
    line = is_overdue ? lines_.erase(line) : std::next(line);
  }
  return overdue;
}

}  // namespace slamgw
