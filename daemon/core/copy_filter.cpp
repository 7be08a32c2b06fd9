// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/copy_filter.hpp"

#include <algorithm>
#include <functional>
#include <string_view>

namespace slamgw {
namespace {

std::size_t content_of(const Report& report) {
  return std::hash<std::string_view>{}(report.topic) * 31 +
         std::hash<std::string_view>{}(as_text(report.payload));
}

}  // namespace

CopyFilter::Copy CopyFilter::on_report(const Report& report, TimePoint now) {
  std::deque<First>& kept = robots_[report.robot];
  expire(kept, now);
  const std::size_t content = content_of(report);
  const auto first = std::ranges::find_if(kept, [&](const First& each) {
    return !each.has_copy && each.mesh != report.mesh && each.content == content &&
           now - each.came <= window && (each.receipt.is_owed() || !report.receipt.is_owed());
  });
  if (first == kept.end()) {
    if (kept.size() < max_kept)
      kept.push_back({report.mesh, content, now, report.receipt, report.receipt.is_owed()});
    return Copy::none;
  }
  first->has_copy = true;
  first->copy = report.receipt;
  return first->is_open ? Copy::waits : Copy::safe;
}

/// Forgets a refused message: the robot sends it again, over either mesh.
std::optional<Receipt> CopyFilter::on_receipt(const Receipt& receipt, ReceiptOutcome outcome) {
  for (auto& [robot, kept] : robots_) {
    const auto first = std::ranges::find_if(
        kept, [&](const First& each) { return each.is_open && each.receipt == receipt; });
    if (first == kept.end()) continue;
    const Receipt copy = first->copy;
    first->is_open = false;
    if (outcome == ReceiptOutcome::refused) kept.erase(first);
    return copy.is_owed() ? std::optional(copy) : std::nullopt;
  }
  return std::nullopt;
}

/// Keeps a message while its receipt is open, because a copy may wait for that receipt.
void CopyFilter::expire(std::deque<First>& kept, TimePoint now) {
  std::erase_if(kept, [&](const First& each) { return !each.is_open && now - each.came > window; });
}

}  // namespace slamgw
