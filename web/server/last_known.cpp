// SPDX-License-Identifier: Apache-2.0
#include "web/server/last_known.hpp"

namespace slamgw::web {

bool LastKnown::keep(std::string_view topic, SharedText text) {
  forget(topic);
  const std::size_t cost = topic.size() + text->size();
  const std::size_t quarters = topic.starts_with(own_) ? 5 : 4;
  if (topics_.size() >= max_topics / 4 * quarters || bytes_ + cost > max_bytes / 4 * quarters)
    return false;
  bytes_ += cost;
  topics_.emplace(topic, std::move(text));
  return true;
}

bool LastKnown::forget(std::string_view topic) {
  const auto known = topics_.find(topic);
  if (known == topics_.end()) return false;
  bytes_ -= known->first.size() + known->second->size();
  topics_.erase(known);
  return true;
}

void LastKnown::forget_all() {
  topics_.clear();
  bytes_ = 0;
}

}  // namespace slamgw::web
