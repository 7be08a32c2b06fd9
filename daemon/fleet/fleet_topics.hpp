// SPDX-License-Identifier: Apache-2.0
// The topics and the few filters by which gateways hear each other. Pure functions on strings.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/topic_scheme.hpp"

namespace slamgw::fleet {

class FleetTopics {
 public:
  FleetTopics(const std::string& prefix, std::string gateway);

  const std::string& gateway() const { return gateway_; }
  std::string all() const { return root_ + "all/" + gateway_; }
  std::string to(const std::string& other) const { return root_ + "to/" + other + "/" + gateway_; }

  /// A robot's retained entry at another gateway.
  std::string presence(const std::string& other, const std::string& robot) const {
    return gateways_ + other + "/robots/" + robot;
  }

  /// Who sent a message of the fleet to us or to all; nothing when the topic is another one.
  std::optional<std::string_view> sender(std::string_view topic) const;
  /// Whose `state` it is.
  std::optional<std::string_view> gateway_of_state(std::string_view topic) const;
  struct Outcome {
    std::string_view gateway;
    std::string_view robot;
  };
  std::optional<Outcome> outcome(std::string_view topic) const;

  /// Other gateways' `state`: for this alone somebody listens who is alone.
  std::string state_filter() const { return gateways_ + "+/state"; }
  std::string all_filter() const { return root_ + "all/+"; }
  std::string own_filter() const { return root_ + "to/" + gateway_ + "/+"; }
  std::string outcome_filter() const { return gateways_ + "+/commands/+"; }
  /// The lines of Mosquitto's access control list that let this gateway take part.
  std::string rights() const;
  std::string command_filter() const { return commands_ + "+/+"; }

 private:
  std::string gateway_;
  std::string root_;
  std::string gateways_;
  std::string commands_;
};

}  // namespace slamgw::fleet
