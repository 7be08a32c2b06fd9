// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/publish_window.hpp"

#include <algorithm>
#include <utility>

namespace slamgw {

void PublishWindow::on_link_up(std::uint16_t receive_maximum, TimePoint now) {
  const std::size_t broker_window = receive_maximum > 1 ? receive_maximum - 1u : 1u;
  effective_size_ = std::min(size_, broker_window);
  progress_ = now;
  is_silent_ = false;
}

bool PublishWindow::has_room_for(const OutboxEntry& entry) const {
  if (entry.is_unacknowledged()) return !is_unacknowledged_paused_ && !is_silent_;
  return acknowledged_ < effective_size_;
}

bool PublishWindow::is_backlogs_turn() const {
  const std::size_t fresh = acknowledged_ - from_backlog_;
  return from_backlog_ != fresh ? from_backlog_ < fresh : !was_backlog_last_;
}

void PublishWindow::add(OutboxEntry entry, TimePoint now) {
  was_backlog_last_ = entry.is_from_backlog;
  if (entry.is_unacknowledged()) {
    is_unacknowledged_paused_ = ++unacknowledged_ == max_unacknowledged;
  } else if (acknowledged_++ == 0) {
    progress_ = now;
  }
  if (entry.is_from_backlog && !entry.is_unacknowledged()) ++from_backlog_;
  entries_.push_back(std::move(entry));
}

OutboxEntries::iterator PublishWindow::position_of(std::uint64_t sequence) {
  const auto found = std::lower_bound(
      entries_.begin(), entries_.end(), sequence,
      [](const OutboxEntry& e, std::uint64_t wanted) { return e.sequence < wanted; });
  return found != entries_.end() && found->sequence == sequence ? found : entries_.end();
}

const OutboxEntry* PublishWindow::find(std::uint64_t sequence) {
  const auto found = position_of(sequence);
  return found == entries_.end() ? nullptr : &*found;
}

std::optional<OutboxEntry> PublishWindow::take(std::uint64_t sequence, TimePoint now) {
  const auto found = position_of(sequence);
  if (found == entries_.end()) return std::nullopt;
  OutboxEntry entry = std::move(*found);
  entries_.erase(found);
  if (entry.is_unacknowledged()) {
    if (--unacknowledged_ <= max_unacknowledged / 2) is_unacknowledged_paused_ = false;
    return entry;
  }
  progress_ = now;
  --acknowledged_;
  if (entry.is_from_backlog) --from_backlog_;
  return entry;
}

OutboxEntries PublishWindow::take_all() {
  acknowledged_ = from_backlog_ = unacknowledged_ = 0;
  is_unacknowledged_paused_ = false;
  return std::exchange(entries_, {});
}

}  // namespace slamgw
