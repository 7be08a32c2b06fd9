// SPDX-License-Identifier: Apache-2.0
// The document by which Home Assistant's MQTT discovery finds a robot (docs/home-assistant.md): one
// device, retained. Pure functions; called by PresencePublisher.
#pragma once

#include <string>
#include <string_view>

#include "daemon/core/normalizer.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw {

/// `homeassistant/device/<prefix>/<robot>/config`. Characters that Home Assistant does not allow
/// there are escaped, so no two robots share a topic.
std::string home_assistant_topic(const TopicScheme& topics, std::string_view robot);

/// JSON. Its ids depend on the robot alone, so a robot stays one device at each gateway. It names
/// this gateway where Home Assistant looks for presence, because availability takes no wildcards.
/// `robot` is valid UTF-8; `has_signal`: the robot's presence may carry `rssi_dbm`.
std::string home_assistant_document(const TopicScheme& topics, std::string_view robot,
                                    UpdateMode update_mode, bool has_signal);

}  // namespace slamgw
