// SPDX-License-Identifier: Apache-2.0
// The settings of the broker and the store (`broker.*`, `store.*`); defaults as in
// config/gateway.json.
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
  /// Returns `mqtt://host:port`, as in the configuration.
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
  std::vector<BrokerAddress> others;  ///< tried after this broker, in this order
  bool is_cluster = false;            ///< all are nodes of one cluster, which share sessions
  bool returns_to_first = false;      ///< leaves another broker when the first is back
  std::string gateway_id;             ///< for the user property `gateway`
  /// `slam-gateway-<gateway.id>` unless set; %n: the broker's place in the list, from 1.
  std::string client_id;
  /// Nothing: the systemd credential `broker`, if there is one.
  std::optional<std::string> credentials_file;
  std::optional<Credentials> credentials;  ///< the contents of that file
  std::optional<std::string> ca_file;
  std::optional<std::string> certificate_file;
  std::optional<std::string> key_file;
  std::chrono::seconds keep_alive{30};
  std::size_t max_inflight = 16;

  /// Returns all addresses of `broker.uri`, in its order; never empty.
  std::vector<BrokerAddress> addresses() const {
    std::vector<BrokerAddress> all{{host, port, tls}};
    all.insert(all.end(), others.begin(), others.end());
    return all;
  }
  /// Returns true when any of the brokers uses TLS.
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
