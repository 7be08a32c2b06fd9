// SPDX-License-Identifier: Apache-2.0
// A real Mosquitto for tests that must pass over either version of MQTT.
#pragma once

#include <gtest/gtest.h>

#include <optional>
#include <string>

#include "daemon/mqtt/version_choice.hpp"
#include "tests/support/mosquitto.hpp"
#include "tests/support/mqtt311_proxy.hpp"

namespace slamgw::test {

/// Mosquitto itself, or behind a proxy that speaks MQTT 3.1.1 only.
class BrokerOfVersion : public Mosquitto {
 public:
  explicit BrokerOfVersion(MqttVersion version, std::string extra_configuration = {})
      : Mosquitto(std::move(extra_configuration)) {
    if (version == MqttVersion::v3_1_1) proxy_.emplace(port());
  }
  /// For the gateway; `port()` and `uri()` are the Mosquitto's own.
  std::uint16_t link_port() const { return proxy_ ? proxy_->port() : port(); }
  std::string link_uri() const { return "mqtt://127.0.0.1:" + std::to_string(link_port()); }

 private:
  std::optional<Mqtt311Proxy> proxy_;
};

inline std::string name_of(MqttVersion version) {
  return version == MqttVersion::v5 ? "Mqtt5" : "Mqtt311";
}
inline const auto either_version = testing::Values(MqttVersion::v5, MqttVersion::v3_1_1);

/// A test over either version, with a broker of its own.
class OverEitherVersion : public testing::TestWithParam<MqttVersion> {
 public:
  static std::string name(const testing::TestParamInfo<MqttVersion>& info) {
    return name_of(info.param);
  }

 protected:
  BrokerOfVersion broker{GetParam()};
};

}  // namespace slamgw::test
