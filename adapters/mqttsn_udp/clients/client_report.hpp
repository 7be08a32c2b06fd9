// SPDX-License-Identifier: Apache-2.0
// What an operator sees of MQTT-SN sessions (`slam-gatewayctl mqttsn clients`). Pure.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>

#include "adapters/mqttsn_udp/clients/client_table.hpp"

namespace slamgw::mqttsn {

/// A row for each client, by robot. `robot`: a row for that one alone, with its topics,
/// subscriptions and the topics of the messages that wait for it; no row when it is unknown.
/// `longest_wait`: `mqttsn.retry_interval_s`.
nlohmann::json client_report(const ClientTable& clients, const std::optional<std::string>& robot,
                             Duration longest_wait, TimePoint now);

}  // namespace slamgw::mqttsn
