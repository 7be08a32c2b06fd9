// SPDX-License-Identifier: Apache-2.0
// The topic tree of docs/topics.md, both directions, and the access rules. Pure functions on
// strings.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace slamgw {

/// One topic level that can stand for a robot id or a message type: 1-64 octets that every broker
/// takes (is_mqtt_text), without `+ # /`.
bool is_valid_level(std::string_view level);
/// An MQTT topic name (MQTT 5 section 4.7): not empty, at most 200 levels, without wildcards, and
/// text that every broker takes (is_mqtt_text).
bool is_valid_topic_name(std::string_view topic);
/// An MQTT topic filter: like a topic name, with wildcards only where MQTT allows them.
bool is_valid_filter(std::string_view filter);
bool has_wildcard(std::string_view filter);
/// MQTT matching, including that a leading wildcard does not match `$…`.
bool filter_matches(std::string_view filter, std::string_view topic);

/// `<prefix>/robot/<id>/<type>` and the other topics of the gateway. Immutable.
class TopicScheme {
 public:
  TopicScheme(std::string prefix, std::string gateway_id);

  struct RobotAndType {
    std::string_view robot;
    std::string_view type;
  };

  std::string robot_topic(std::string_view robot, std::string_view type) const;
  std::string command_topic(std::string_view robot, std::string_view type) const;
  /// Every command for one robot: `<prefix>/server/<robot>/+`.
  std::string command_filter(std::string_view robot) const;
  /// Return views into `topic`; nothing for another topic, or when its levels are invalid.
  std::optional<RobotAndType> parse_robot_topic(std::string_view topic) const;
  std::optional<RobotAndType> parse_command_topic(std::string_view topic) const;

  std::string state_topic() const { return gateway_root_ + "state"; }
  std::string stats_topic() const { return gateway_root_ + "stats"; }
  std::string numbers_topic() const { return gateway_root_ + "numbers"; }
  std::string join_request_topic() const { return gateway_root_ + "request/permit_join"; }
  std::string join_response_topic() const { return gateway_root_ + "response/permit_join"; }
  std::string thread_topic() const { return gateway_root_ + "thread"; }
  std::string presence_topic(std::string_view robot) const;
  /// Where another gateway publishes a robot's presence.
  std::string presence_topic_at(const std::string& gateway, std::string_view robot) const;
  struct GatewayAndRobot {
    std::string_view gateway;
    std::string_view robot;
  };
  /// Reads a presence topic of any gateway.
  std::optional<GatewayAndRobot> parse_presence_topic(std::string_view topic) const;
  std::string presence_filter() const { return gateways_root_ + "+/robots/+"; }
  /// Returns the gateway whose `state` is published on this topic.
  std::optional<std::string_view> gateway_of_state(std::string_view topic) const;
  std::string state_filter() const { return gateways_root_ + "+/state"; }
  /// The topic on which gateways whose boards share a BLE mesh publish what their boards hear.
  std::string hears_topic() const { return hears_root_ + gateway_id_; }
  std::string hears_filter() const { return hears_root_ + "+"; }
  std::optional<std::string_view> gateway_of_hears(std::string_view topic) const;
  std::string outcome_topic(std::string_view robot) const;
  std::string rejected_topic(std::string_view robot, std::string_view type) const;

  const std::string& prefix() const { return prefix_; }
  const std::string& gateway_id() const { return gateway_id_; }
  const std::string& robot_root() const { return robot_root_; }      ///< `<prefix>/robot/`
  const std::string& command_root() const { return command_root_; }  ///< `<prefix>/server/`

 private:
  std::string prefix_;
  std::string gateway_id_;
  std::string robot_root_;
  std::string command_root_;
  std::string gateways_root_;
  std::string gateway_root_;
  std::string hears_root_;
};

/// The access rules for MQTT-SN (docs/topics.md). `%c` in an extra filter stands for the client id.
class TopicPolicy {
 public:
  TopicPolicy(TopicScheme scheme, std::vector<std::string> extra_publish,
              std::vector<std::string> extra_subscribe);

  /// `topic` must be a valid topic name. A robot's own topics are `<prefix>/robot/<robot>/<type>`.
  bool may_publish(std::string_view client_id, std::string_view robot,
                   std::string_view topic) const;
  /// `filter` must be a valid filter. Allows the robot's own commands, anything under
  /// `<prefix>/robot/`, and the extra filters.
  bool may_subscribe(std::string_view client_id, std::string_view robot,
                     std::string_view filter) const;
  const TopicScheme& scheme() const { return scheme_; }

 private:
  TopicScheme scheme_;
  std::vector<std::string> extra_publish_;
  std::vector<std::string> extra_subscribe_;
};

}  // namespace slamgw
