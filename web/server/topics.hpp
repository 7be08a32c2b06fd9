// SPDX-License-Identifier: Apache-2.0
// The meaning of a topic of docs/topics.md to a page. Pure.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace slamgw::web {

enum class TopicKind : std::uint8_t {
  robot,    ///< `<prefix>/robot/<id>/<type>`: a robot's message
  command,  ///< `<prefix>/server/<id>/<type>`: a command to a robot
  state,    ///< a gateway's, only the newest counts: `state`, `stats`, `numbers`, `thread`,
            ///< `robots/<id>`, `response/permit_join`
  event,    ///< a gateway's, each one counts: `commands/<id>`, `rejected/<id>/<type>`
  foreign,  ///< not part of this tree
};

class Topics {
 public:
  /// Below a gateway: the robots that join while joining is permitted (docs/topics.md).
  static constexpr std::string_view join_response = "response/permit_join";

  explicit Topics(std::string prefix) : prefix_(std::move(prefix)) {}

  TopicKind kind_of(std::string_view topic) const;
  /// `<gw>` and the levels below it, of a topic under `<prefix>/gateway/`; both empty for others.
  struct GatewayTopic {
    std::string_view gateway;
    std::string_view rest;
  };
  GatewayTopic gateway_topic(std::string_view topic) const;
  /// `<id>` of a topic under `<prefix>/robot/`; empty for others.
  std::string_view robot_of(std::string_view topic) const;
  /// Returns whether a page may publish here: `<prefix>/server/<id>/<type>` with two valid levels,
  /// or `<prefix>/gateway/<gw>/request/permit_join`.
  bool may_publish(std::string_view topic) const;
  const std::string& prefix() const { return prefix_; }

 private:
  /// The levels below `<prefix>/<branch>/`; empty for a topic in another place.
  std::string_view below(std::string_view topic, std::string_view branch) const;

  std::string prefix_;
};

}  // namespace slamgw::web
