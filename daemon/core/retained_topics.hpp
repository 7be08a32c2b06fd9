// SPDX-License-Identifier: Apache-2.0
// Bounds how many retained messages robots may leave at the broker, where each one stays until it
// is cleared. Pure; part of Gateway.
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

namespace slamgw {

class RetainedTopics {
 public:
  /// Robots of the thesis retain nothing; a robot that keeps its last state does so on a few
  /// topics.
  static constexpr std::size_t max_per_robot = 16;
  /// With payloads of 1 KiB, the broker keeps 4 MiB of retained messages.
  static constexpr std::size_t max_in_all = 4096;

  /// Counts a message that `robot` wants to retain on `topic`. Returns false when the robot has its
  /// share already, or all places are taken. An empty message, which clears the topic, is always
  /// admitted.
  bool admit(const std::string& robot, std::string_view topic, bool is_empty) {
    std::vector<std::size_t>& topics = topics_[robot];
    const std::size_t mark = std::hash<std::string_view>{}(topic);
    const auto found = std::find(topics.begin(), topics.end(), mark);
    const bool is_known = found != topics.end();
    const bool has_room = topics.size() < max_per_robot && count_ < max_in_all;
    if (is_empty && is_known) {
      topics.erase(found);
      --count_;
    } else if (!is_empty && !is_known && has_room) {
      topics.push_back(mark);
      ++count_;
    }
    if (topics.empty()) topics_.erase(robot);
    return is_empty || is_known || has_room;
  }

  /// Forgets the robot's topics, because they are cleared or of no interest any more.
  void forget(const std::string& robot) {
    const auto topics = topics_.find(robot);
    if (topics == topics_.end()) return;
    count_ -= topics->second.size();
    topics_.erase(topics);
  }

  std::size_t count() const { return count_; }
  /// Returns the largest number of topics that one robot retains, and this robot; 0 when no robot
  /// retains any. Looks at all robots.
  std::pair<std::size_t, std::string> largest() const {
    std::pair<std::size_t, std::string> largest;
    for (const auto& [robot, topics] : topics_)
      if (topics.size() > largest.first) largest = {topics.size(), robot};
    return largest;
  }

 private:
  std::unordered_map<std::string, std::vector<std::size_t>> topics_;  // hashes; no vector is empty
  std::size_t count_ = 0;
};

}  // namespace slamgw
