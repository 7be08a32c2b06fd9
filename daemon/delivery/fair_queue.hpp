// SPDX-License-Identifier: Apache-2.0
// Every message that is in memory, by its row, which rises in the order of submission. Messages
// that wait for the broker stand in their flow's queue, which keeps their order. Flows take turns,
// one message each, so a robot that sends much delays only itself. A flow is the part of a topic
// before its last level: all types of one robot are one flow. Pure; part of the outbox.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <set>
#include <string_view>
#include <unordered_map>
#include <utility>

#include "daemon/core/messages.hpp"
#include "daemon/core/recycling_allocator.hpp"
#include "daemon/core/time.hpp"

namespace slamgw {

struct OutboxFlow;

struct OutboxItem {
  /// Memory that one message takes besides topic and payload.
  static constexpr std::size_t overhead_bytes = 160;
  enum class Disk : std::uint8_t { none, asked, writing, durable };
  enum class Wait : std::uint8_t {
    none,    ///< the message is under way, or a dead letter that is being stored
    queued,  ///< the message has turns
    aside,   ///< an earlier message of its topic is on disk, or the topic rests
  };

  std::uint64_t row = 0;       ///< the order of submission, and its number on disk
  std::uint64_t sequence = 0;  ///< of the publication that is under way; 0: none
  BrokerMessage message;
  Receipt receipt = no_receipt;
  TimePoint submitted{};
  Disk disk = Disk::none;
  Wait wait = Wait::none;      ///< FairQueue sets it
  OutboxFlow* flow = nullptr;  ///< FairQueue sets it while the message waits
  bool is_dead = false;        ///< becomes a dead letter as soon as it is on disk
  /// A QoS 0 message of a topic that is tried: published at QoS 1, because QoS 0 gets no answer.
  bool is_probe = false;
  bool is_trial = false;    ///< was published alone
  TimePoint handed_over{};  ///< PublishWindow sets it

  /// Returns true for QoS 0, also while it is under way as a probe.
  bool is_unacknowledged() const { return is_probe || message.qos == Qos::at_most_once; }
  bool is_durable() const { return disk == Disk::durable; }
  /// Returns true for a QoS 1 or 2 message that would be lost with the process.
  bool is_unsaved() const { return !is_unacknowledged() && disk == Disk::none; }
  std::size_t cost() const {
    return message.topic.size() + message.payload.size() + overhead_bytes;
  }

  struct ByRow {
    bool operator()(const OutboxItem* a, const OutboxItem* b) const { return a->row < b->row; }
  };
};
using OutboxRows = std::set<OutboxItem*, OutboxItem::ByRow, RecyclingAllocator<OutboxItem*>>;

/// The waiting messages of one flow.
struct OutboxFlow {
  OutboxRows items;       ///< those that are queued
  std::size_t bytes = 0;  ///< those set aside, too
  std::size_t key = 0;
};

class FairQueue {
 public:
  using Item = OutboxItem;
  using Items = std::map<std::uint64_t, Item, std::less<>,
                         RecyclingAllocator<std::pair<const std::uint64_t, Item>>>;

  /// Takes an item whose row is unique. The reference is valid until the item is erased.
  Item& add(Item item);
  /// Returns null when no such row is in memory.
  Item* find(std::uint64_t row);
  void erase(Item& item);

  enum class NewFlow : std::uint8_t { last, first };
  /// Inserts the item into its flow by its row. `turn` is the turn of a flow that had no items.
  void enqueue(Item& item, NewFlow turn = NewFlow::last);
  /// Keeps the item without turns until it is queued again.
  void set_aside(Item& item);
  /// Takes the item out of its flow or from the items set aside.
  void withdraw(Item& item);
  /// Returns the item whose turn it is; null when nothing is queued.
  Item* front() const { return turns_.empty() ? nullptr : *turns_.front()->items.begin(); }
  /// Withdraws the front item and gives the turn to the next flow.
  void take_front();
  /// Gives the turn of the front item to the next flow.
  void pass_turn();

  /// Calls `visit(item)` for each item by rising row. `visit` may erase the item.
  template <class Visit>
  void for_each(Visit visit) {
    for (auto next = items_.begin(); next != items_.end();) visit((next++)->second);
  }
  template <class Visit>
  void for_each_aside(Visit visit) {
    for (auto next = aside_.begin(); next != aside_.end();) visit(**next++);
  }
  const Items& items() const { return items_; }
  const OutboxRows& aside() const { return aside_; }
  /// Adds `shift` to each row.
  void renumber(std::uint64_t shift);

  /// Returns the number of flows with queued items.
  std::size_t flows() const { return turns_.size(); }
  /// Returns the number of queued items that are on disk.
  std::size_t durable_queued() const { return durable_queued_; }
  /// Returns the sum of OutboxItem::cost() that is queued or set aside in the flow of `topic`.
  std::size_t bytes_in_flow(std::string_view topic) const;

 private:
  /// Hash of the flow's name. Names with the same hash share their turns, and keep their order.
  using Key = std::size_t;
  using Flow = OutboxFlow;
  using Flows = std::unordered_map<Key, Flow, std::hash<Key>, std::equal_to<>,
                                   RecyclingAllocator<std::pair<const Key, Flow>>>;

  static Key key_of(std::string_view topic);
  Flow& join_flow(Item& item);

  Items items_;
  Flows flows_;  // none has 0 bytes
  OutboxRows aside_;
  std::deque<Flow*, RecyclingAllocator<Flow*>> turns_;  // each flow with queued items once
  std::size_t durable_queued_ = 0;
};

}  // namespace slamgw
