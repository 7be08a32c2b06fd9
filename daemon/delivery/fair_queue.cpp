// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/fair_queue.hpp"

#include <algorithm>
#include <iterator>
#include <vector>

namespace slamgw {

FairQueue::Key FairQueue::key_of(std::string_view topic) {
  return std::hash<std::string_view>{}(flow_of(topic));
}

std::size_t FairQueue::bytes_in_flow(std::string_view topic) const {
  const auto flow = flows_.find(key_of(topic));
  return flow == flows_.end() ? 0 : flow->second.bytes;
}

void FairQueue::push(OutboxEntry entry) {
  const Key key = key_of(entry.message.topic);
  Flow& flow = flows_[key];
  if (flow.entries.empty()) turns_.push_back(key);
  flow.bytes += entry.cost();
  flow.entries.push_back(std::move(entry));
  ++size_;
}

OutboxEntry FairQueue::pop() {
  const Key key = turns_.front();
  turns_.pop_front();
  const auto position = flows_.find(key);
  Flow& flow = position->second;
  OutboxEntry entry = std::move(flow.entries.front());
  flow.entries.pop_front();
  flow.bytes -= entry.cost();
  --size_;
  if (flow.entries.empty()) {
    flows_.erase(position);
  } else {
    turns_.push_back(key);
  }
  return entry;
}

OutboxEntries FairQueue::take_all() {
  std::vector<OutboxEntry*> all;  // entries are large: each is moved once
  all.reserve(size_);
  for (auto& [key, flow] : flows_) {
    for (OutboxEntry& entry : flow.entries) all.push_back(&entry);
  }
  std::stable_sort(all.begin(), all.end(),
                   [](const OutboxEntry* a, const OutboxEntry* b) { return a->order < b->order; });
  OutboxEntries taken;
  for (OutboxEntry* entry : all) taken.push_back(std::move(*entry));
  *this = {};
  return taken;
}

void FairQueue::forget_empty_flows() {
  std::erase_if(flows_, [](const auto& flow) { return flow.second.entries.empty(); });
  std::erase_if(turns_, [&](Key key) { return !flows_.contains(key); });
}

}  // namespace slamgw
