// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/filter_tree.hpp"

#include <algorithm>

namespace slamgw::mqttsn {
namespace {

struct Levels {
  std::string_view first;
  bool is_last;
  std::string_view rest;
};

Levels split(std::string_view topic) {
  const std::size_t slash = topic.find('/');
  if (slash == std::string_view::npos) return {topic, true, {}};
  return {topic.substr(0, slash), false, topic.substr(slash + 1)};
}

}  // namespace

void FilterTree::add(std::string_view filter, const Match& subscriber) {
  Node* node = &root_;
  for (bool is_last = false; !is_last;) {
    const Levels levels = split(filter);
    auto& next = node->children[std::string(levels.first)];
    if (!next) next = std::make_unique<Node>();
    node = next.get();
    filter = levels.rest;
    is_last = levels.is_last;
  }
  node->subscribers.push_back(subscriber);
}

bool FilterTree::remove(std::string_view filter, const ClientSession& session) {
  return remove_below(root_, filter, session);
}

bool FilterTree::remove_below(Node& node, std::string_view filter, const ClientSession& session) {
  const Levels levels = split(filter);
  const auto next = node.children.find(levels.first);
  if (next == node.children.end()) return false;
  bool was_last = false;
  if (levels.is_last) {
    auto& subscribers = next->second->subscribers;
    const auto is_it = [&](const Match& match) { return match.session == &session; };
    was_last = std::erase_if(subscribers, is_it) > 0 && subscribers.empty();
  } else {
    was_last = remove_below(*next->second, levels.rest, session);
  }
  if (next->second->is_empty()) node.children.erase(next);
  return was_last;
}

FilterTree::Matches FilterTree::match(std::string_view topic) const {
  Matches found;
  match_below(root_, topic, true, found);
  return found;
}

void FilterTree::match_below(const Node& node, std::string_view topic, bool is_first,
                             Matches& found) {
  const Levels levels = split(topic);
  const bool is_hidden = is_first && topic.starts_with('$');
  if (const Node* all = is_hidden ? nullptr : child(node, "#")) collect(*all, found);
  const Node* any = is_hidden ? nullptr : child(node, "+");
  for (const Node* next : {child(node, levels.first), any}) {
    if (!next) continue;
    if (!levels.is_last) {
      match_below(*next, levels.rest, false, found);
      continue;
    }
    collect(*next, found);
    if (const Node* parent_too = child(*next, "#")) collect(*parent_too, found);  // "a/#" and "a"
  }
}

void FilterTree::collect(const Node& node, Matches& found) {
  if (node.subscribers.empty()) return;
  ++found.filters;
  found.all.insert(found.all.end(), node.subscribers.begin(), node.subscribers.end());
}

const FilterTree::Node* FilterTree::child(const Node& node, std::string_view level) {
  const auto found = node.children.find(level);
  return found == node.children.end() ? nullptr : found->second.get();
}

}  // namespace slamgw::mqttsn
