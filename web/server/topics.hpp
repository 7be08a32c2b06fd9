// SPDX-License-Identifier: Apache-2.0
// What a topic of docs/topics.md means to a page. Pure.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace slamgw::web {

enum class TopicKind : std::uint8_t {
  robot,    ///< `<prefix>/robot/<id>/<type>`: a robot's message
  command,  ///< `<prefix>/server/<id>/<type>`: a command to it
  state,    ///< of a gateway, the newest is all: `state`, `stats`, `numbers`, `thread`,
            ///< `robots/<id>`, who joins
  event,    ///< of a gateway, each one counts: `commands/<id>`, `rejected/<id>/<type>`
  foreign,  ///< nothing of the tree
};

class Topics {
 public:
  /// Below a gateway: who joins since robots may (docs/topics.md).
  static constexpr std::string_view join_response = "response/permit_join";

  explicit Topics(std::string prefix) : prefix_(std::move(prefix)) {}

  TopicKind kind_of(std::string_view topic) const;
  /// `<gw>` and what follows it, of a topic under `<prefix>/gateway/`; both empty for others.
  struct GatewayTopic {
    std::string_view gateway;
    std::string_view rest;
  };
  GatewayTopic gateway_topic(std::string_view topic) const;
  /// `<id>` of a topic under `<prefix>/robot/`; empty for others.
  std::string_view robot_of(std::string_view topic) const;
  /// Whether a page may publish here: `<prefix>/server/<id>/<type>` with two valid levels, or
  /// `<prefix>/gateway/<gw>/request/permit_join`.
  bool may_publish(std::string_view topic) const;
  const std::string& prefix() const { return prefix_; }

 private:
  /// What follows `<prefix>/<branch>/`; empty when it is not below.
  std::string_view below(std::string_view topic, std::string_view branch) const;

  std::string prefix_;
};

}  // namespace slamgw::web
