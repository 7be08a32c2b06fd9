// SPDX-License-Identifier: Apache-2.0
// The fields of the journal's entries beside their text: those of a Notice and of a robot's
// message, and the MESSAGE_ID of each kind of entry (documented in slam-gatewayd(8); the ids never
// change). Pure.
#pragma once

#include <string>
#include <string_view>

#include "daemon/core/messages.hpp"
#include "daemon/core/traffic_event.hpp"
#include "daemon/observability/log.hpp"
#include "daemon/observability/traffic_sampler.hpp"

namespace slamgw {

/// 32 hex digits (sd-id128(3)); empty for `other` and `broker_refusal`.
std::string_view message_id_of(Occasion occasion);
LogFields notice_fields(const Notice& notice);

/// A robot's message as a line of the log: `thread NRF_5 update x=120 y=-33 obstacles=2`.
std::string traffic_text(const TrafficEvent& event, const TrafficLine& line);
LogFields traffic_fields(const TrafficEvent& event);

}  // namespace slamgw
