// SPDX-License-Identifier: Apache-2.0
// The messages that were handed to the broker's client and are not answered yet. Limits their
// number. One flow takes half of the QoS 1 and 2 messages under way at most, so that a robot whose
// messages the broker does not answer leaves room for the others. Pure; part of the outbox.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <deque>
#include <string_view>
#include <utility>

#include "daemon/delivery/fair_queue.hpp"
#include "daemon/delivery/message_store.hpp"

namespace slamgw {

class PublishWindow {
 public:
  using Item = OutboxItem;
  using Items = std::deque<Item*, RecyclingAllocator<Item*>>;
  /// Limit of QoS 0 messages that the client has not written yet. They are past the robots' turns,
  /// so the limit is just enough to keep the client busy. At the limit, publishing pauses until
  /// half of it is written, because each message that is handed over wakes a thread.
  static constexpr std::size_t max_unacknowledged = 32;

  /// `size`: QoS 1 and 2 messages under way at once.
  explicit PublishWindow(std::size_t size) : size_(size) {}

  /// `receive_maximum` is the broker's (MQTT 5 flow control); one slot of it stays free.
  void on_link_up(std::uint16_t receive_maximum, TimePoint now) {
    const std::size_t broker_window = receive_maximum > 1 ? receive_maximum - 1u : 1u;
    effective_size_ = std::min(size_, broker_window);
    progress_ = now;
    is_silent_ = false;
  }
  /// Call when the broker becomes silent (UpstreamListener::on_silence) or answers again. QoS 0
  /// waits during the silence, and is dropped when it grows too old. A new connection ends it.
  void on_silence(bool is_silent) { is_silent_ = is_silent; }

  bool has_room_for(const Item& item) const {
    if (item.is_unacknowledged()) return !is_unacknowledged_paused_ && !is_silent_;
    return acknowledged_ < effective_size_;
  }
  /// Returns false when the flow of `item` has its share of the window under way.
  bool has_share_for(const Item& item) const {
    const std::size_t share = std::max<std::size_t>(1, effective_size_ / 2);
    if (item.is_unacknowledged() || acknowledged_ < share) return true;
    const std::string_view flow = flow_of(item.message.topic);
    const auto is_of_flow = [&](const Item* other) {
      return !other->is_unacknowledged() && flow_of(other->message.topic) == flow;
    };
    return static_cast<std::size_t>(std::ranges::count_if(items_, is_of_flow)) < share;
  }
  /// `item.sequence` rises from call to call.
  void add(Item& item, TimePoint now) {
    item.handed_over = now;
    if (item.is_unacknowledged()) {
      is_unacknowledged_paused_ = ++unacknowledged_ == max_unacknowledged;
    } else if (acknowledged_++ == 0) {
      progress_ = now;
    }
    if (item.message.qos == Qos::exactly_once) ++exactly_once_;
    items_.push_back(&item);
  }
  /// Returns null for a message that was handed over before a reconnect, as take() does.
  Item* find(std::uint64_t sequence) {
    const auto found = position_of(sequence);
    return found == items_.end() ? nullptr : *found;
  }
  Item* take(std::uint64_t sequence, TimePoint now) {
    const auto found = position_of(sequence);
    if (found == items_.end()) return nullptr;
    Item* const item = *found;
    items_.erase(found);
    item->sequence = 0;
    if (item->message.qos == Qos::exactly_once) --exactly_once_;
    if (item->is_unacknowledged()) {
      if (--unacknowledged_ <= max_unacknowledged / 2) is_unacknowledged_paused_ = false;
    } else {
      progress_ = now;
      --acknowledged_;
    }
    return item;
  }
  Items take_all() {
    acknowledged_ = unacknowledged_ = exactly_once_ = 0;
    is_unacknowledged_paused_ = false;
    for (Item* const item : items_) item->sequence = 0;
    return std::exchange(items_, {});
  }
  /// The messages, by rising sequence.
  const Items& items() const { return items_; }
  bool empty() const { return items_.empty(); }
  /// Returns true for a message of QoS 0 or 1 while one of QoS 2 on its topic is under way: the
  /// broker may take that one only when PUBREL comes. Brokers keep the order of each QoS only (MQTT
  /// 5, section 4.6).
  bool would_be_overtaken_by(const Item& later) const {
    if (exactly_once_ == 0 || later.message.qos == Qos::exactly_once) return false;
    return std::ranges::any_of(items_, [&](const Item* item) {
      return item->message.qos == Qos::exactly_once && item->message.topic == later.message.topic;
    });
  }
  /// Call when the broker has answered the message, before take().
  void on_answered(std::uint64_t sequence) {
    const auto found = position_of(sequence);
    if (found == items_.end()) return;
    std::uint64_t& last = last_answered_[static_cast<std::size_t>((*found)->message.qos)];
    last = std::max(last, sequence);
  }
  /// Returns true when the broker owes the answer to `item` for `patience`, though it has answered
  /// a later message of the same QoS, or nothing was under way before `item`; or for twice that
  /// time, while no other answer is due and the broker is not silent. Brokers answer the messages
  /// of each QoS in order (MQTT 5, section 4.6).
  bool is_forgotten(const Item& item, Duration patience, TimePoint now) const {
    return item.message.qos != Qos::at_most_once && now - item.handed_over >= patience &&
           (item.is_trial || is_alone_unanswered(2 * patience, now) ||
            item.sequence < last_answered_[static_cast<std::size_t>(item.message.qos)]);
  }
  /// Returns true when the broker owes an acknowledgement and has sent none for `patience`.
  bool is_stalled(Duration patience, TimePoint now) const {
    return acknowledged_ > 0 && now - progress_ >= patience;
  }

 private:
  bool is_alone_unanswered(Duration patience, TimePoint now) const {
    return acknowledged_ == 1 && !is_silent_ && is_stalled(patience, now);
  }
  Items::iterator position_of(std::uint64_t sequence) {
    const auto found = std::lower_bound(
        items_.begin(), items_.end(), sequence,
        [](const Item* item, std::uint64_t wanted) { return item->sequence < wanted; });
    return found != items_.end() && (*found)->sequence == sequence ? found : items_.end();
  }

  std::size_t size_;
  std::size_t effective_size_ = 0;
  Items items_;
  std::size_t acknowledged_ = 0;           // QoS 1 and 2
  std::size_t unacknowledged_ = 0;         // QoS 0
  std::size_t exactly_once_ = 0;           // QoS 2
  bool is_unacknowledged_paused_ = false;  // until half of it is written
  bool is_silent_ = false;
  std::array<std::uint64_t, 3>
      last_answered_{};   // the highest of each QoS; that of QoS 0 is unused
  TimePoint progress_{};  // the last acknowledgement, or when the first message came to wait
};

}  // namespace slamgw
