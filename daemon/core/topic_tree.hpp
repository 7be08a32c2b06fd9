// SPDX-License-Identifier: Apache-2.0
// Topic filters as a tree of levels, a value for each: finding what matches a topic costs by the
// levels of the topic and by what matches, never by how many filters there are.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

namespace slamgw {

/// Depth is bounded by the filters' levels, which their length bounds. Filters are valid
/// (is_valid_filter).
template <class Value>
class TopicTree {
 public:
  /// The filter's value; a new one when it has none.
  Value& operator[](std::string_view filter) {
    Node* node = &root_;
    for (std::optional<std::string_view> rest = filter; rest;) {
      auto& next = node->children[std::string(take_level(rest))];
      if (!next) next = std::make_unique<Node>();
      node = next.get();
    }
    if (!node->value) node->value.emplace();
    return *node->value;
  }

  /// Nothing when the filter has no value.
  Value* find(std::string_view filter) {
    Node* node = &root_;
    for (std::optional<std::string_view> rest = filter; rest;) {
      node = child(*node, take_level(rest));
      if (!node) return nullptr;
    }
    return node->value ? &*node->value : nullptr;
  }

  void erase(std::string_view filter) { erase_below(root_, filter); }
  void clear() { root_ = Node{}; }

  /// Calls `visit(const Value&)` for each filter that matches (MQTT 3.1.1 section 4.7, `$...`
  /// included).
  template <class Visit>
  void match(std::string_view topic, Visit&& visit) const {
    const bool is_hidden = topic.starts_with('$');  // from a leading wildcard
    match_below(root_, topic, is_hidden, visit);
  }

 private:
  struct Node {
    std::map<std::string, std::unique_ptr<Node>, std::less<>> children;
    std::optional<Value> value;
  };

  /// The first level of `rest`, which becomes what follows it, or nothing behind the last.
  static std::string_view take_level(std::optional<std::string_view>& rest) {
    const std::size_t slash = rest->find('/');
    const std::string_view level = rest->substr(0, slash);
    if (slash == std::string_view::npos) {
      rest.reset();
    } else {
      rest->remove_prefix(slash + 1);
    }
    return level;
  }

  static Node* child(const Node& node, std::string_view level) {
    const auto found = node.children.find(level);
    return found == node.children.end() ? nullptr : found->second.get();
  }

  static void erase_below(Node& node, std::optional<std::string_view> rest) {
    const auto next = node.children.find(take_level(rest));
    if (next == node.children.end()) return;
    if (rest) {
      erase_below(*next->second, rest);
    } else {
      next->second->value.reset();
    }
    if (!next->second->value && next->second->children.empty()) node.children.erase(next);
  }

  template <class Visit>
  static void visit_value(const Node* node, Visit& visit) {
    if (node && node->value) visit(*node->value);
  }

  template <class Visit>
  static void match_below(const Node& node, std::optional<std::string_view> rest, bool is_hidden,
                          Visit& visit) {
    const std::string_view level = take_level(rest);
    if (!is_hidden) visit_value(child(node, "#"), visit);
    for (const Node* next : {child(node, level), is_hidden ? nullptr : child(node, "+")}) {
      if (!next) continue;
      if (rest) {
        match_below(*next, rest, false, visit);
      } else {
        visit_value(next, visit);
        visit_value(child(*next, "#"), visit);  // "a/#" also matches "a"
      }
    }
  }

  Node root_;
};

}  // namespace slamgw
