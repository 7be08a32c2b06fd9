// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/topic_table.hpp"

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

std::optional<std::uint16_t> TopicTable::assign(std::string_view name) {
  if (const auto known = id_of(name)) return known;
  if (topics_.size() >= limits::max_topics_per_client) return std::nullopt;
  topics_.push_back({std::string(name), false});
  const auto id = static_cast<std::uint16_t>(topics_.size());
  ids_.emplace(name, id);
  return id;
}

const std::string* TopicTable::name_of(std::uint16_t id) const {
  return id == 0 || id > topics_.size() ? nullptr : &topics_[id - 1U].name;
}

std::optional<std::uint16_t> TopicTable::id_of(std::string_view name) const {
  const auto found = ids_.find(name);
  if (found == ids_.end()) return std::nullopt;
  return found->second;
}

bool TopicTable::is_told(std::uint16_t id) const {
  return id != 0 && id <= topics_.size() && topics_[id - 1U].is_told;
}

void TopicTable::set_told(std::uint16_t id, bool told) {
  if (id != 0 && id <= topics_.size()) topics_[id - 1U].is_told = told;
}

void TopicTable::set_all_untold() {
  for (Topic& topic : topics_) topic.is_told = false;
}

void TopicTable::clear() {
  topics_.clear();
  ids_.clear();
}

}  // namespace slamgw::mqttsn
