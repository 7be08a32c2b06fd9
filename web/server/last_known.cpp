// SPDX-License-Identifier: Apache-2.0
#include "web/server/last_known.hpp"

namespace slamgw::web {

bool LastKnown::keep(std::string_view topic, const SharedText& text) {
  const auto known = topics_.find(topic);
  const bool is_new = known == topics_.end();
  const std::size_t before = is_new ? 0 : topic.size() + known->second->size();
  const std::size_t bytes = bytes_ - before + topic.size() + text->size();
  const std::size_t count = topics_.size() + (is_new ? 1 : 0);
  const std::size_t quarters = topic.starts_with(own_) ? 5 : 4;
  if (count > max_topics / 4 * quarters || bytes > max_bytes / 4 * quarters) return false;
  bytes_ = bytes;
  topics_.insert_or_assign(std::string(topic), text);
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
