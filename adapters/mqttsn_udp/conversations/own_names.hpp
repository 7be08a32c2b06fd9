// SPDX-License-Identifier: Apache-2.0
// Topics of a client that `robots[].mqttsn_client_id` renames: firmware that builds its topics from
// its client id goes on working, because its own topics are translated both ways.
#pragma once

#include <string>

#include "adapters/mqttsn_udp/clients/client_session.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::mqttsn {

/// `<prefix>/robot/<from>/...` or `<prefix>/server/<from>/...` with `to` in the place of `from`;
/// nothing for any other topic or filter.
std::optional<std::string> replace_robot(const TopicScheme& scheme, std::string_view topic,
                                         std::string_view from, std::string_view to);

/// The topic or filter as the broker knows it. Takes note when the client uses its client id.
std::string to_broker_name(const TopicScheme& scheme, ClientSession& session, std::string topic);
/// The topic as the client calls it.
std::string to_client_name(const TopicScheme& scheme, const ClientSession& session,
                           const std::string& topic);

/// The client's robot was called `from` and is called `to`: all that the session keeps of its own
/// topics goes on under the new name, and the client is spoken to as before. Leaves the robot's
/// name itself and all indexes to the caller.
void rename_topics(const TopicScheme& scheme, ClientSession& session, std::string_view from,
                   const std::string& to);

}  // namespace slamgw::mqttsn
