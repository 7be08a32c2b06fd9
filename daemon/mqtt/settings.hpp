// SPDX-License-Identifier: Apache-2.0
// What the configuration says about the broker and the store (`broker.*`, `store.*`); defaults as
// in config/gateway.json.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace slamgw {

struct Credentials {
  std::string username;
  std::string password;  ///< secret: never logged, never printed
  bool operator==(const Credentials&) const = default;
};

/// The library that speaks MQTT to the broker.
enum class MqttClient : std::uint8_t { paho, mosquitto };

struct BrokerAddress {
  std::string host;  ///< a name or an address; IPv6 without brackets
  std::uint16_t port = 1883;
  bool tls = false;  ///< `mqtts://`
  /// `mqtt://host:port`, as in the configuration.
  std::string uri() const {
    const bool is_ipv6 = host.find(':') != std::string::npos;
    return (tls ? "mqtts://" : "mqtt://") + (is_ipv6 ? "[" + host + "]" : host) + ":" +
           std::to_string(port);
  }
  bool operator==(const BrokerAddress&) const = default;
};

struct BrokerSettings {
  MqttClient client = MqttClient::paho;
  std::string host = "127.0.0.1";  ///< a name or an address; IPv6 without brackets
  std::uint16_t port = 1883;
  bool tls = false;                   ///< `mqtts://`
  std::vector<BrokerAddress> others;  ///< tried after it, in this order
  bool returns_to_first = false;      ///< leaves another one when the first is there again
  std::string gateway_id;             ///< for the user property `gateway`
  std::string
      client_id;  ///< `slam-gateway-<gateway.id>` unless set; %n: the broker's place, from 1
  std::optional<std::string>
      credentials_file;  ///< nothing: the systemd credential `broker`, if there is one
  std::optional<Credentials> credentials;  ///< what that file says
  std::optional<std::string> ca_file;
  std::optional<std::string> certificate_file;
  std::optional<std::string> key_file;
  std::chrono::seconds keep_alive{30};
  std::size_t max_inflight = 16;

  /// All of `broker.uri`, in its order; never empty.
  std::vector<BrokerAddress> addresses() const {
    std::vector<BrokerAddress> all{{host, port, tls}};
    all.insert(all.end(), others.begin(), others.end());
    return all;
  }
  /// With any of the brokers.
  bool uses_tls() const {
    return tls ||
           std::any_of(others.begin(), others.end(), [](const auto& each) { return each.tls; });
  }
  bool operator==(const BrokerSettings&) const = default;
};

struct StoreSettings {
  std::string directory = "/var/lib/slam-gateway";
  std::uint64_t max_bytes = 268435456;
  bool operator==(const StoreSettings&) const = default;
};

}  // namespace slamgw
