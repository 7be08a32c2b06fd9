// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/topic_table.hpp"

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

std::optional<std::uint16_t> TopicTable::assign(std::string_view name,
                                                std::span<const std::uint16_t> in_use) {
  if (const auto known = id_of(name)) return known;
  const bool has_room =
      topics_.size() < limits::max_topics_per_client && may_take(NameBudget::of_topic(name.size()));
  if (has_room) {
    restore({std::string(name), false, false, ++last_use_});
    return static_cast<std::uint16_t>(topics_.size());
  }
  const auto id = longest_unused(in_use);
  if (!id) return std::nullopt;
  Topic& topic = topics_[*id - 1U];
  const std::size_t grows = name.size() - std::min(name.size(), topic.name.size());
  if (grows > 0 && !may_take(grows)) return std::nullopt;
  discharge_for(topic.name);
  remove_name(*id);
  topic = {std::string(name), false, false, ++last_use_};
  add_name(*id);
  charge_for(topic.name);
  return id;
}

std::optional<std::uint16_t> TopicTable::longest_unused(
    std::span<const std::uint16_t> in_use) const {
  std::optional<std::uint16_t> found;
  for (std::size_t i = 0; i < topics_.size(); ++i) {
    const auto id = static_cast<std::uint16_t>(i + 1);
    if (topics_[i].is_own || std::ranges::find(in_use, id) != in_use.end()) continue;
    if (!found || topics_[i].used < topics_[*found - 1U].used) found = id;
  }
  return found;
}

const std::string* TopicTable::name_of(std::uint16_t id) const {
  return id == 0 || id > topics_.size() ? nullptr : &topics_[id - 1U].name;
}

std::optional<std::uint16_t> TopicTable::id_of(std::string_view name) const {
  const auto found = place_of(name);
  if (found == by_name_.end() || topics_[*found - 1U].name != name) return std::nullopt;
  return *found;
}

bool TopicTable::is_known(std::uint16_t id) const {
  return id != 0 && id <= topics_.size() && topics_[id - 1U].is_known;
}

void TopicTable::set_known(std::uint16_t id, bool known) {
  if (Topic* topic = find(id)) topic->is_known = known;
}

void TopicTable::forget_known() {
  for (Topic& topic : topics_) topic.is_known = false;
}

void TopicTable::set_own(std::uint16_t id) {
  if (Topic* topic = find(id)) topic->is_own = true;
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
  charge_for(topic.name);
  topics_.push_back(std::move(topic));
  add_name(static_cast<std::uint16_t>(topics_.size()));
}

void TopicTable::clear() {
  if (budget_) budget_->give_back(std::exchange(octets_, 0));
  topics_.clear();
  by_name_.clear();
}

std::vector<std::uint16_t>::const_iterator TopicTable::place_of(std::string_view name) const {
  return std::ranges::lower_bound(by_name_, name, std::ranges::less(), [this](std::uint16_t id) {
    return std::string_view(topics_[id - 1U].name);
  });
}

/// Unless another id has this name already.
void TopicTable::add_name(std::uint16_t id) {
  const std::string& name = topics_[id - 1U].name;
  if (!id_of(name)) by_name_.insert(place_of(name), id);
}

void TopicTable::remove_name(std::uint16_t id) {
  const std::string& name = topics_[id - 1U].name;
  if (id_of(name) == id) by_name_.erase(place_of(name));
}

TopicTable::Topic* TopicTable::find(std::uint16_t id) {
  return id == 0 || id > topics_.size() ? nullptr : &topics_[id - 1U];
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
