// SPDX-License-Identifier: Apache-2.0
// A robot message as a line of the log, `thread NRF_5 update x=120 y=-33 obstacles=2`, and as
// fields of the journal. Pure.
#pragma once

#include <string>

#include "daemon/core/traffic_event.hpp"
#include "daemon/observability/log.hpp"
#include "daemon/observability/traffic_sampler.hpp"

namespace slamgw {

std::string traffic_text(const TrafficEvent& event, const TrafficLine& line);
LogFields traffic_fields(const TrafficEvent& event);

}  // namespace slamgw
