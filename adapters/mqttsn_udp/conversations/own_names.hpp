// SPDX-License-Identifier: Apache-2.0
// Topics of a client that `robots[].mqttsn_client_id` renames: firmware that builds its topics from
// its client id goes on working, because its own topics are translated both ways.
#pragma once

#include <string>

#include "adapters/mqttsn_udp/clients/client_session.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::mqttsn {

/// Returns `<prefix>/robot/<from>/...` or `<prefix>/server/<from>/...` with `to` in the place of
/// `from`; nothing for any other topic or filter.
std::optional<std::string> replace_robot(const TopicScheme& scheme, std::string_view topic,
                                         std::string_view from, std::string_view to);

/// Returns the topic or filter as the broker knows it. Notes if the client uses its client id.
std::string to_broker_name(const TopicScheme& scheme, ClientSession& session, std::string topic);
/// Returns the topic as the client names it.
std::string to_client_name(const TopicScheme& scheme, const ClientSession& session,
                           const std::string& topic);

/// Renames the client's robot from `from` to `to` in all topics that the session keeps. The client
/// sees its topics as before. The caller changes the robot's name itself and all indexes.
void rename_topics(const TopicScheme& scheme, ClientSession& session, std::string_view from,
                   const std::string& to);

}  // namespace slamgw::mqttsn
