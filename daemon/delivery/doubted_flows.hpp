// SPDX-License-Identifier: Apache-2.0
// Robots of which the broker has refused a topic and then closed the connection, as Debian 12's
// Mosquitto does after each refusal. Every refusal costs all robots the connection; so a robot's
// other topics, but for those that the broker took last time, are held as if refused and tried one
// by one. Else a robot with a hundred forbidden topics would cost a hundred connections. A flow is
// as in FairQueue: what a topic has in front of its last level. Pure; part of the outbox.
#pragma once

#include <bitset>
#include <cstddef>
#include <string_view>
#include <unordered_map>

#include "daemon/core/messages.hpp"
#include "daemon/delivery/topic_counts.hpp"

namespace slamgw {

class DoubtedFlows {
 public:
  void on_accepted(std::string_view topic) { accepted_.set(TopicCounts::slot(topic)); }
  /// The broker has refused a message on `topic` and closed the connection.
  void add(std::string_view topic, const Refusal& refusal) {
    accepted_.reset(TopicCounts::slot(topic));
    flows_[flow_of(topic)] = {refusal.code, "another topic of this robot is: " + refusal.why};
  }
  /// Why the broker is taken to refuse `topic`; null: there is no reason to.
  const Refusal* reason(std::string_view topic) const {
    if (flows_.empty() || accepted_.test(TopicCounts::slot(topic))) return nullptr;
    const auto doubted = flows_.find(flow_of(topic));
    return doubted == flows_.end() ? nullptr : &doubted->second;
  }
  /// No topic is refused any more.
  void clear() { flows_.clear(); }

 private:
  /// Two flows may share a number; so there are no more than TopicCounts::slots.
  static std::size_t flow_of(std::string_view topic) {
    return TopicCounts::slot(topic.substr(0, topic.rfind('/')));
  }

  std::unordered_map<std::size_t, Refusal> flows_;
  std::bitset<TopicCounts::slots> accepted_;  // the broker's last answer for these topics
};

}  // namespace slamgw
