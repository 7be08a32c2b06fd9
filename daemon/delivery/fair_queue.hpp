// SPDX-License-Identifier: Apache-2.0
// What waits in memory for the broker. Messages of one flow keep their order; flows take turns, one
// message each, so a robot that sends much delays only itself. A flow is what a topic has in
// front of its last level: all types of one robot are one flow. Pure; part of the outbox.
#pragma once

#include <cstddef>
#include <deque>
#include <functional>
#include <list>
#include <string_view>
#include <unordered_map>
#include <utility>

#include "daemon/core/recycling_allocator.hpp"
#include "daemon/delivery/publish_window.hpp"

namespace slamgw {

class FairQueue {
 public:
  bool empty() const { return size_ == 0; }
  std::size_t size() const { return size_; }
  /// What waits in the flow of `topic`, in OutboxEntry::cost().
  std::size_t bytes_in_flow(std::string_view topic) const;

  void push(OutboxEntry entry);
  /// Whose turn it is. Only while not empty().
  const OutboxEntry& front() const { return flows_.find(turns_.front())->second.entries.front(); }
  OutboxEntry pop();
  /// Everything, in the order of submission.
  OutboxEntries take_all();

  /// `visit(entry)` for each, in no particular order.
  template <class Visit>
  void for_each(Visit visit) const {
    for (const auto& [key, flow] : flows_) {
      for (const OutboxEntry& entry : flow.entries) visit(entry);
    }
  }
  /// Drops those for which `is_dropped(entry)`.
  template <class Predicate>
  void erase_if(Predicate is_dropped) {
    for (auto& known : flows_) {
      Flow& flow = known.second;
      std::erase_if(flow.entries, [&](const OutboxEntry& entry) {
        if (!is_dropped(entry)) return false;
        flow.bytes -= entry.cost();
        --size_;
        return true;
      });
    }
    forget_empty_flows();
  }

 private:
  /// Of the flow's name. Two names with one hash share their turns, which harms neither's order.
  using Key = std::size_t;
  struct Flow {
    std::list<OutboxEntry, RecyclingAllocator<OutboxEntry>> entries;
    std::size_t bytes = 0;
  };

  static Key key_of(std::string_view topic);
  void forget_empty_flows();

  std::unordered_map<Key, Flow, std::hash<Key>, std::equal_to<>,
                     RecyclingAllocator<std::pair<const Key, Flow>>>
      flows_;                                       // none is empty
  std::deque<Key, RecyclingAllocator<Key>> turns_;  // each flow once
  std::size_t size_ = 0;
};

}  // namespace slamgw
