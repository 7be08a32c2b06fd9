// SPDX-License-Identifier: Apache-2.0
// The id of a topic for one client, with regard to what is on its way to that client.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

#include "adapters/mqttsn_udp/clients/client_session.hpp"

namespace slamgw::mqttsn {

/// As TopicTable::assign(); no id is given anew that an open REGISTER or PUBLISH names.
std::optional<std::uint16_t> assign_topic(ClientSession& session, std::string_view name);

}  // namespace slamgw::mqttsn
