// SPDX-License-Identifier: Apache-2.0
// The topic tree of docs/topics.md, both directions, and who may use what in it. Pure functions on
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
/// An MQTT topic filter: the same, with wildcards only where MQTT allows them.
bool is_valid_filter(std::string_view filter);
bool has_wildcard(std::string_view filter);
/// MQTT matching, including that a leading wildcard does not match `$…`.
bool filter_matches(std::string_view filter, std::string_view topic);

/// `<prefix>/robot/<id>/<type>` and its relatives. Immutable.
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
  /// Views into `topic`; nothing when it is not such a topic or its levels are invalid.
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
  /// Of any gateway.
  std::optional<GatewayAndRobot> parse_presence_topic(std::string_view topic) const;
  std::string presence_filter() const { return gateways_root_ + "+/robots/+"; }
  /// Whose `state` it is.
  std::optional<std::string_view> gateway_of_state(std::string_view topic) const;
  std::string state_filter() const { return gateways_root_ + "+/state"; }
  /// What gateways whose boards share a BLE mesh tell each other.
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

/// Who may do what on MQTT-SN (docs/topics.md). `%c` in an extra filter stands for the client
/// id.
class TopicPolicy {
 public:
  TopicPolicy(TopicScheme scheme, std::vector<std::string> extra_publish,
              std::vector<std::string> extra_subscribe);

  /// `topic` is a valid topic name; own topics are `<prefix>/robot/<robot>/<type>`.
  bool may_publish(std::string_view client_id, std::string_view robot,
                   std::string_view topic) const;
  /// `filter` is a valid filter; own commands, and anything under `<prefix>/robot/`.
  bool may_subscribe(std::string_view client_id, std::string_view robot,
                     std::string_view filter) const;
  const TopicScheme& scheme() const { return scheme_; }

 private:
  TopicScheme scheme_;
  std::vector<std::string> extra_publish_;
  std::vector<std::string> extra_subscribe_;
};

}  // namespace slamgw
