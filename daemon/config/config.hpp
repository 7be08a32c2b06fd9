// SPDX-License-Identifier: Apache-2.0
// The whole configuration as one value. Each module owns its settings; Config only gathers them.
// Parsing: parse.hpp.
#pragma once

#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "adapters/mqttsn_udp/settings.hpp"
#include "daemon/core/normalizer.hpp"
#include "daemon/core/robot_keys.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/mqtt/settings.hpp"
#include "daemon/observability/log_settings.hpp"
#include "web/server/settings.hpp"

namespace slamgw {

struct TopicSettings {
  std::string prefix = "ntnu-slam";
  std::vector<std::string> extra_publish;
  std::vector<std::string> extra_subscribe;
  std::vector<std::string> retain = {"*"};  ///< types that devices may retain; "*": any
  bool home_assistant = false;              ///< describes each robot to Home Assistant
  bool operator==(const TopicSettings&) const = default;
};

struct Config {
  std::string gateway_id;  ///< the host name unless set
  BrokerSettings broker;
  TopicSettings topics;
  UpdateMode update_mode = UpdateMode::positions;  ///< `payload.update`
  std::vector<RobotName> robots;
  std::vector<std::string> bans;  ///< see Bans
  ble::Settings ble_mesh;
  mqttsn::Settings mqttsn;
  RobotKeys robot_keys;  ///< secret: the content of `mqttsn.dtls.keys_file`
  StoreSettings store;
  LogSettings log;
  std::string control_socket = "/run/slam-gateway/control.sock";
  web::Settings web;  ///< for slam-gateway-web; the daemon only checks them
};

}  // namespace slamgw
