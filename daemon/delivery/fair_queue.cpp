// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/fair_queue.hpp"

#include <algorithm>
#include <string>

#include "daemon/core/spare_buffers.hpp"
#include "daemon/delivery/message_store.hpp"

namespace slamgw {

FairQueue::Key FairQueue::key_of(std::string_view topic) {
  return std::hash<std::string_view>{}(flow_of(topic));
}

std::size_t FairQueue::bytes_in_flow(std::string_view topic) const {
  const auto flow = flows_.find(key_of(topic));
  return flow == flows_.end() ? 0 : flow->second.bytes;
}

FairQueue::Item& FairQueue::add(Item item) {
  const std::uint64_t row = item.row;
  return items_.emplace_hint(items_.end(), row, std::move(item))->second;
}

FairQueue::Item* FairQueue::find(std::uint64_t row) {
  const auto found = items_.find(row);
  return found == items_.end() ? nullptr : &found->second;
}

/// Keeps the memory of topic and payload for later messages.
void FairQueue::erase(Item& item) {
  withdraw(item);
  SpareBuffers<std::string>::give_back(std::move(item.message.topic));
  SpareBuffers<Bytes>::give_back(std::move(item.message.payload));
  items_.erase(items_.find(item.row));
}

void FairQueue::enqueue(Item& item, NewFlow turn) {
  if (item.wait == Item::Wait::queued) return;
  withdraw(item);
  Flow& flow = join_flow(item);
  if (flow.items.empty())
    turn == NewFlow::last ? turns_.push_back(&flow) : turns_.push_front(&flow);
  flow.items.insert(flow.items.end(), &item);
  if (item.is_durable()) ++durable_queued_;
  item.wait = Item::Wait::queued;
}

FairQueue::Flow& FairQueue::join_flow(Item& item) {
  const Key key = key_of(item.message.topic);
  Flow& flow = flows_[key];
  flow.key = key;
  flow.bytes += item.cost();
  item.flow = &flow;
  return flow;
}

void FairQueue::set_aside(Item& item) {
  withdraw(item);
  join_flow(item);
  aside_.insert(&item);
  item.wait = Item::Wait::aside;
}

void FairQueue::withdraw(Item& item) {
  const Item::Wait wait = std::exchange(item.wait, Item::Wait::none);
  if (wait == Item::Wait::none) return;
  Flow& flow = *std::exchange(item.flow, nullptr);
  if (wait == Item::Wait::queued) {
    if (item.is_durable()) --durable_queued_;
    flow.items.erase(&item);
    if (flow.items.empty()) turns_.erase(std::find(turns_.begin(), turns_.end(), &flow));
  } else {
    aside_.erase(&item);
  }
  if ((flow.bytes -= item.cost()) == 0) flows_.erase(flow.key);
}

void FairQueue::take_front() {
  Flow* const flow = turns_.front();
  withdraw(*front());
  if (!turns_.empty() && turns_.front() == flow) pass_turn();
}

void FairQueue::pass_turn() {
  turns_.push_back(turns_.front());
  turns_.pop_front();
}

void FairQueue::renumber(std::uint64_t shift) {
  auto old = std::exchange(items_, {});
  while (!old.empty()) {
    auto item = old.extract(old.begin());
    item.key() += shift;
    item.mapped().row += shift;
    items_.insert(items_.end(), std::move(item));
  }
}

}  // namespace slamgw
