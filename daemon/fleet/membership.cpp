// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/membership.hpp"

#include <utility>

namespace slamgw::fleet {

Membership::Membership(FleetTopics own_topics, Life process)
    : topics(std::move(own_topics)), me(topics.gateway()), lease(process) {}

void Membership::publish(std::string topic, const Body& body, Qos qos) {
  actions.push(PublishNow{{std::move(topic), to_bytes(encode(lease.life(), body)), qos, false}});
}

void Membership::notice(Severity severity, std::string text, const std::string& robot) {
  actions.push(Notice{severity, std::move(text), robot});
}

}  // namespace slamgw::fleet
