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
    for (Level level = Level::first_of(filter);; level = level.next()) {
      if (auto* place = node->place_at(level)) return value_in(*place);
      auto& next = node->children[std::string(level.text)];
      if (!next) next = std::make_unique<Node>();
      node = next.get();
      if (level.is_last) return value_in(node->value);
    }
  }

  /// Nothing when the filter has no value.
  Value* find(std::string_view filter) {
    Node* node = &root_;
    for (Level level = Level::first_of(filter);; level = level.next()) {
      if (auto* place = node->place_at(level)) return *place ? &**place : nullptr;
      node = child(*node, level.text);
      if (!node) return nullptr;
      if (level.is_last) return node->value ? &*node->value : nullptr;
    }
  }

  void erase(std::string_view filter) { erase_below(root_, Level::first_of(filter)); }
  void clear() { root_ = Node{}; }

  /// Calls `visit(const Value&)` for each filter that matches (MQTT 3.1.1 section 4.7, `$...`
  /// included).
  template <class Visit>
  void match(std::string_view topic, Visit&& visit) const {
    const bool is_hidden = topic.starts_with('$');  // from a leading wildcard
    match_below(root_, Level::first_of(topic), is_hidden, visit);
  }

 private:
  /// One level of a topic or filter, and what follows it.
  struct Level {
    std::string_view text;
    std::string_view rest;
    bool is_last = true;

    static Level first_of(std::string_view topic) {
      const std::size_t slash = topic.find('/');
      if (slash == std::string_view::npos) return {topic, {}, true};
      return {topic.substr(0, slash), topic.substr(slash + 1), false};
    }
    Level next() const { return first_of(rest); }
  };

  struct Node {
    std::map<std::string, std::unique_ptr<Node>, std::less<>> children;
    std::optional<Value> value;
    /// Values of filters that end in `+` or `#` below this. Most filters do: so they need no node.
    std::optional<Value> any;
    std::optional<Value> rest;

    bool is_empty() const { return !value && !any && !rest && children.empty(); }
    /// Null: a filter that goes on at `level` has a child there.
    std::optional<Value>* place_at(const Level& level) {
      if (!level.is_last) return nullptr;
      if (level.text == "#") return &rest;
      return level.text == "+" ? &any : nullptr;
    }
  };

  static Value& value_in(std::optional<Value>& place) { return place ? *place : place.emplace(); }

  static Node* child(const Node& node, std::string_view level) {
    const auto found = node.children.find(level);
    return found == node.children.end() ? nullptr : found->second.get();
  }

  static void erase_below(Node& node, const Level& level) {
    if (auto* place = node.place_at(level)) return place->reset();
    const auto next = node.children.find(level.text);
    if (next == node.children.end()) return;
    if (level.is_last) {
      next->second->value.reset();
    } else {
      erase_below(*next->second, level.next());
    }
    if (next->second->is_empty()) node.children.erase(next);
  }

  template <class Visit>
  static void match_below(const Node& node, const Level& level, bool is_hidden, Visit& visit) {
    if (!is_hidden && node.rest) visit(*node.rest);
    if (!is_hidden && level.is_last && node.any) visit(*node.any);
    for (const Node* next : {child(node, level.text), is_hidden ? nullptr : child(node, "+")}) {
      if (!next) continue;
      if (!level.is_last) {
        match_below(*next, level.next(), false, visit);
        continue;
      }
      if (next->value) visit(*next->value);
      if (next->rest) visit(*next->rest);  // "a/#" also matches "a"
    }
  }

  Node root_;
};

}  // namespace slamgw
