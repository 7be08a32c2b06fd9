// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/topic_table.hpp"

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

/// FNV-1a.
std::uint16_t topic_id_of(std::string_view name) {
  std::uint32_t hash = 2166136261U;
  for (const char c : name) hash = (hash ^ static_cast<unsigned char>(c)) * 16777619U;
  return static_cast<std::uint16_t>(hash % highest_new_topic_id + lowest_topic_id);
}

std::optional<std::uint16_t> TopicTable::assign(std::string_view name,
                                                std::span<const std::uint16_t> in_use) {
  if (const auto known = id_of(name)) return known;
  const bool has_room =
      topics_.size() < limits::max_topics_per_client && may_take(NameBudget::of_topic(name.size()));
  if (!has_room) {
    const Topic* unused = longest_unused(in_use);
    if (!unused) return std::nullopt;
    const std::size_t grows = name.size() - std::min(name.size(), unused->name.size());
    if (grows > 0 && !may_take(grows)) return std::nullopt;
    erase(unused->id);
  }
  const std::uint16_t id = free_id(name);
  restore({std::string(name), id, false, false, ++last_use_});
  return id;
}

/// Always finds an id: a table holds far fewer topics than there are ids.
std::uint16_t TopicTable::free_id(std::string_view name) const {
  static_assert(limits::max_topics_per_client < highest_new_topic_id);
  std::uint16_t id = wanted_id_(name);
  while (find(id)) id = id >= highest_new_topic_id ? lowest_topic_id : id + 1;
  return id;
}

const TopicTable::Topic* TopicTable::longest_unused(std::span<const std::uint16_t> in_use) const {
  const Topic* found = nullptr;
  for (const Topic& topic : topics_) {
    if (topic.is_own || std::ranges::find(in_use, topic.id) != in_use.end()) continue;
    if (!found || topic.used < found->used) found = &topic;
  }
  return found;
}

const std::string* TopicTable::name_of(std::uint16_t id) const {
  const Topic* topic = find(id);
  return topic ? &topic->name : nullptr;
}

std::optional<std::uint16_t> TopicTable::id_of(std::string_view name) const {
  const auto found = place_of(name);
  if (found == by_name_.end() || *name_of(*found) != name) return std::nullopt;
  return *found;
}

void TopicTable::forget_known() {
  for (Topic& topic : topics_) topic.is_known = false;
}

void TopicTable::touch(std::uint16_t id) {
  if (Topic* topic = find(id)) topic->used = ++last_use_;
}

void TopicTable::rename(const NewName& new_name) {
  std::vector<Topic> topics = std::exchange(topics_, {});
  clear();
  for (Topic& topic : topics) {
    if (auto name = new_name(topic.name)) topic.name = std::move(*name);
    restore(std::move(topic));
  }
}

void TopicTable::restore(Topic topic) {
  if (topics_.size() >= limits::max_topics_per_client) return;
  const std::uint16_t id = topic.id;
  const auto place = std::ranges::lower_bound(topics_, id, {}, &Topic::id);
  const bool is_taken = place != topics_.end() && place->id == id;
  if (is_taken || id < lowest_topic_id || id > highest_topic_id) return;
  charge_for(topic.name);
  topics_.insert(place, std::move(topic));
  by_name_.insert(place_of(*name_of(id)), id);
}

void TopicTable::erase(std::uint16_t id) {
  const auto topic = std::ranges::lower_bound(topics_, id, {}, &Topic::id);
  discharge_for(topic->name);
  topics_.erase(topic);
  std::erase(by_name_, id);
}

void TopicTable::clear() {
  if (budget_) budget_->give_back(std::exchange(octets_, 0));
  topics_.clear();
  by_name_.clear();
}

std::vector<std::uint16_t>::const_iterator TopicTable::place_of(std::string_view name) const {
  return std::ranges::lower_bound(by_name_, name, std::ranges::less(), [this](std::uint16_t id) {
    return std::string_view(*name_of(id));
  });
}

const TopicTable::Topic* TopicTable::find(std::uint16_t id) const {
  const auto found = std::ranges::lower_bound(topics_, id, {}, &Topic::id);
  return found != topics_.end() && found->id == id ? &*found : nullptr;
}

TopicTable::Topic* TopicTable::find(std::uint16_t id) {
  return const_cast<Topic*>(std::as_const(*this).find(id));
}

bool TopicTable::may_take(std::size_t octets) const {
  return !budget_ || budget_->may_take(octets_, octets);
}

void TopicTable::charge_for(const std::string& name) {
  if (!budget_) return;
  octets_ += NameBudget::of_topic(name.size());
  budget_->take(NameBudget::of_topic(name.size()));
}

void TopicTable::discharge_for(const std::string& name) {
  if (!budget_) return;
  octets_ -= NameBudget::of_topic(name.size());
  budget_->give_back(NameBudget::of_topic(name.size()));
}

}  // namespace slamgw::mqttsn
