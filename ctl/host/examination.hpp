// SPDX-License-Identifier: Apache-2.0
// Gathers what `slam-gatewayctl doctor` judges (doctor.hpp): files, interfaces, the daemon's own
// account, and one MQTT-SN search sent to it over loopback.
#pragma once

#include <string>

#include "ctl/connection.hpp"
#include "ctl/host/doctor.hpp"
#include "ctl/host/installation.hpp"

namespace slamgw::ctl {

/// Takes up to some seconds; nothing that it does changes anything.
HostFacts gather_facts(const Installation& installation, const std::string& socket);
/// Asks the daemon, and the journal of the last day.
RobotFacts gather_robot_facts(const std::string& robot, Connection& daemon);

}  // namespace slamgw::ctl
