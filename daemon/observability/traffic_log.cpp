// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/traffic_log.hpp"

#include "daemon/observability/traffic_text.hpp"

namespace slamgw {

void TrafficLog::on_traffic(const TrafficEvent& event) {
  if (event.is_rejected || !is_logged(Severity::info)) return;  // the core warns of those
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
