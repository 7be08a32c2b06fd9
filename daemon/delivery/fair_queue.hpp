// SPDX-License-Identifier: Apache-2.0
// Every message that is in memory, by its row, which rises in the order of submission. What waits
// for the broker stands in queues of its flow; each keeps its order. Flows take turns, one message
// each, so a robot that sends much delays only itself. A flow is what a topic has in front of its
// last level: all types of one robot are one flow. Pure; part of the outbox.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <list>
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
struct OutboxItem;
using OutboxItems = std::list<OutboxItem*, RecyclingAllocator<OutboxItem*>>;

struct OutboxItem {
  /// What one message in memory costs besides topic and payload.
  static constexpr std::size_t overhead_bytes = 160;
  enum class Disk : std::uint8_t { none, asked, writing, durable };
  enum class Wait : std::uint8_t {
    none,    ///< it is under way, or a dead letter that is being stored
    queued,  ///< it has turns
    aside,   ///< an earlier one of its topic is on disk, or the topic rests
  };

  std::uint64_t row = 0;       ///< the order of submission, and its number on disk
  std::uint64_t sequence = 0;  ///< of its present publication; 0: it is not under way
  BrokerMessage message;
  Receipt receipt = no_receipt;
  TimePoint submitted{};
  Disk disk = Disk::none;
  Wait wait = Wait::none;  ///< FairQueue sets it
  // Of FairQueue, while it is queued:
  OutboxFlow* flow = nullptr;
  OutboxItems::iterator place{};
  bool is_dead = false;  ///< a dead letter as soon as it is on disk
  /// QoS 0 of a topic that is tried, which is published at QoS 1: else there would be no answer.
  bool is_probe = false;
  bool was_stored = false;  ///< on disk at any time, so its sender has forgotten it

  /// QoS 0, also while it is under way as a probe.
  bool is_unacknowledged() const { return is_probe || message.qos == Qos::at_most_once; }
  bool is_durable() const { return disk == Disk::durable; }
  /// It can be lost with the process, and should not be.
  bool is_unsaved() const { return !is_unacknowledged() && disk == Disk::none; }
  std::size_t cost() const {
    return message.topic.size() + message.payload.size() + overhead_bytes;
  }
};

/// What is queued of one flow, by rising row.
struct OutboxFlow {
  OutboxItems items;
  std::size_t bytes = 0;
  std::size_t key = 0;
};

class FairQueue {
 public:
  using Item = OutboxItem;
  struct ByRow {
    bool operator()(const Item* a, const Item* b) const { return a->row < b->row; }
  };
  using Rows = std::set<Item*, ByRow, RecyclingAllocator<Item*>>;
  using Items = std::map<std::uint64_t, Item, std::less<>,
                         RecyclingAllocator<std::pair<const std::uint64_t, Item>>>;

  /// With a row that no other has. The item stays where it is until it is erased.
  Item& add(Item item);
  /// Null when no such row is in memory.
  Item* find(std::uint64_t row);
  void erase(Item& item);

  enum class NewFlow : std::uint8_t { last, first };
  /// Among the others of its flow by its row. `turn`: of the flow, when nothing of it is queued.
  void enqueue(Item& item, NewFlow turn = NewFlow::last);
  /// It has no turns until it is queued again.
  void set_aside(Item& item);
  /// Neither queued nor set aside any more.
  void withdraw(Item& item);
  /// Whose turn it is; null when nothing is queued.
  Item* front() const { return turns_.empty() ? nullptr : turns_.front()->items.front(); }
  /// Withdraws it; the next flow is in turn.
  void take_front();

  /// `visit(item)` for each by rising row, also when that erases it.
  template <class Visit>
  void for_each(Visit visit) {
    for (auto next = items_.begin(); next != items_.end();) visit((next++)->second);
  }
  template <class Visit>
  void for_each_aside(Visit visit) {
    for (auto next = aside_.begin(); next != aside_.end();) visit(**next++);
  }
  /// By row.
  const Items& items() const { return items_; }
  /// Adds `shift` to each row.
  void renumber(std::uint64_t shift);

  std::size_t size() const { return items_.size(); }
  std::size_t queued() const { return queued_; }
  /// Queued ones that are on disk.
  std::size_t durable_queued() const { return durable_queued_; }
  /// What is queued in the flow of `topic`, in OutboxItem::cost().
  std::size_t bytes_in_flow(std::string_view topic) const;

 private:
  /// Of the flow's name. Two names with one hash share their turns, which harms neither's order.
  using Key = std::size_t;
  using Flow = OutboxFlow;
  using Flows = std::unordered_map<Key, Flow, std::hash<Key>, std::equal_to<>,
                                   RecyclingAllocator<std::pair<const Key, Flow>>>;

  static Key key_of(std::string_view topic);

  Items items_;
  Flows flows_;  // none is empty
  Rows aside_;
  std::deque<Flow*, RecyclingAllocator<Flow*>> turns_;  // each flow once
  std::size_t queued_ = 0;
  std::size_t durable_queued_ = 0;
};

}  // namespace slamgw
