// SPDX-License-Identifier: Apache-2.0
// The `mqttsn.*` keys of the configuration; defaults as in config/gateway.json.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace slamgw::mqttsn {

struct PredefinedTopic {
  std::uint16_t id = 0;  ///< 1..65534
  std::string name;
  std::optional<std::string> client_id;  ///< nothing: for every client
  bool operator==(const PredefinedTopic&) const = default;
};

/// Returns true for the names that otbr-agent and wpantund give their interfaces.
inline bool is_thread_interface(std::string_view name) { return name.starts_with("wpan"); }

enum class WhenFull : std::uint8_t { silent, reject };

/// The clients that must prove their identity over DTLS.
enum class RequireIdentity : std::uint8_t { none, with_key, all };

/// DTLS is on while there is a file of keys.
struct DtlsSettings {
  std::vector<std::string> listen = {"[::]:47194"};
  std::optional<std::string> keys_file;
  bool operator==(const DtlsSettings&) const = default;
};

struct Settings {
  bool enabled = true;
  std::vector<std::string> listen = {"[::]:47193"};
  std::string interface = "auto";                          ///< or "*", or an interface's name
  bool announce = false;                                   ///< on the LAN, by DNS-SD
  std::optional<std::string> multicast_group = "ff03::1";  ///< nothing: no multicast
  std::uint8_t gateway_id = 1;                             ///< 1-255
  std::chrono::seconds advertise_interval{900};            ///< T_ADV, at most 65535 s
  std::vector<PredefinedTopic> predefined_topics;
  bool allow_unconnected_publish = false;  ///< QoS -1
  std::size_t max_clients = 10000;
  std::size_t max_sleeping_messages = 64;
  double keep_alive_tolerance = 1.5;
  std::chrono::seconds retry_interval{10};  ///< T_retry
  unsigned retry_count = 3;                 ///< N_retry
  WhenFull when_full = WhenFull::silent;
  bool revive_lost = true;  ///< R113
  bool forwarders = true;
  bool disconnect_unknown = true;
  DtlsSettings dtls;
  RequireIdentity require_identity = RequireIdentity::none;
  bool is_full_silent() const { return when_full == WhenFull::silent; }
  bool is_auto() const { return interface == "auto"; }
  /// Returns true if `mqttsn.interface` names the one interface that the sockets are bound to.
  bool names_interface() const { return !is_auto() && interface != "*"; }
  /// Returns true for an address that stands for all addresses of this host.
  static bool is_wildcard(std::string_view address) {
    return address.starts_with("[::]:") || address.starts_with("0.0.0.0:");
  }
  bool listens_widely() const { return std::any_of(listen.begin(), listen.end(), is_wildcard); }
  /// Returns true if the operator wants every network of this host to reach the gateway.
  bool is_open_to_all() const { return interface == "*" && listens_widely(); }
  bool operator==(const Settings&) const = default;
};

}  // namespace slamgw::mqttsn
