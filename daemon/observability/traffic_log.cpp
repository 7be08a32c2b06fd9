// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/traffic_log.hpp"

#include <chrono>
#include <iterator>

#include "daemon/observability/log_fields.hpp"

namespace slamgw {

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

void TrafficLog::on_traffic(const TrafficEvent& event) {
  if (event.is_rejected || !is_logged(Severity::info)) return;  // the core warns of rejected ones
  const auto line = sampler_.on_traffic(event, event.at);
  if (!line) return;
  const auto entry = awaited_.add(event, {traffic_text(event, *line), traffic_fields(event)});
  if (entry) log_event(Severity::info, entry->text, entry->fields);
}

void TrafficLog::on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now) {
  if (!awaited_.has(receipt)) return;
  const auto entry = awaited_.on_receipt(receipt, outcome, now);
  log_event(Severity::info, entry.text, entry.fields);
}

void TrafficLog::write_overdue(TimePoint now) {
  for (const TrafficEntry& entry : awaited_.take_overdue(now))
    log_event(Severity::info, entry.text, entry.fields);
}

}  // namespace slamgw
