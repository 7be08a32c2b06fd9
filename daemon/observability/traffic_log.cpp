// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/traffic_log.hpp"

#include <chrono>

#include "daemon/observability/log_fields.hpp"

namespace slamgw {

void TrafficLog::write_info(const std::string& text, const LogFields& fields) {
  log_event(Severity::info, text, fields);
}

void TrafficLog::on_traffic(const TrafficEvent& event) {
  if (event.is_rejected || !is_logged(Severity::info)) return;  // the core warns of rejected ones
  const auto picked = sampler_.on_traffic(event, event.at);
  if (!picked) return;
  Line line{event.at, traffic_text(event, *picked), traffic_fields(event)};
  if (event.receipt.is_owed() && awaiting_.size() < max_awaiting)
    awaiting_.insert_or_assign(key_of(event.receipt), std::move(line));
  else
    write_(line.text, line.fields);
}

void TrafficLog::on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now) {
  auto found = awaiting_.extract(key_of(receipt));
  if (!found) return;
  Line& line = found.mapped();
  if (outcome == ReceiptOutcome::safe) {
    const auto latency = std::chrono::duration_cast<std::chrono::microseconds>(now - line.since);
    line.fields.push_back({"LATENCY_US", std::to_string(latency.count())});
  }
  write_(line.text, line.fields);
}

void TrafficLog::write_overdue(TimePoint now) {
  std::erase_if(awaiting_, [&](const auto& entry) {
    const Line& line = entry.second;
    const bool is_overdue = now - line.since >= patience;
    if (is_overdue) write_(line.text, line.fields);
    return is_overdue;
  });
}

}  // namespace slamgw
