// SPDX-License-Identifier: Apache-2.0
// Devices behind a FakeBoard that wait to be provisioned and obey their configuration, and the
// board's half of provisioning. Events and answers come at once; faults are scripted. Written from
// the protocol's description.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "daemon/core/bytes.hpp"

namespace slamgw::ble {

struct FakeDevice {
  Bytes uuid;
  std::uint8_t elements = 1;
  Bytes static_oob;  ///< empty: it has none
  Bytes composition;

  std::uint16_t address = 0;  ///< 0: not provisioned
  Bytes device_key;
  Bytes app_key;
  Bytes net_key;  ///< of its mesh; empty: receives under any network key
  Bytes new_net_key;
  Bytes new_app_key;
  int refresh_phase = 0;
  std::vector<std::string> requests;  ///< configuration messages carried out, hex
  /// Groups of each model, by its element and identifier as on air, hex.
  std::map<std::string, std::set<std::uint16_t>> subscriptions;

  Bytes default_ttl{4};
  Bytes relay{1, 0x0a};  ///< on, three times, 20 ms apart
  Bytes network_transmit{0};

  struct Heartbeats {
    std::uint16_t publishes_to = 0;
    std::uint16_t source = 0;  ///< whose heartbeats it counts
    std::uint16_t destination = 0;
    unsigned count = 0;
    std::uint8_t min_hops = 0x7f;
    std::uint8_t max_hops = 0;
  };
  Heartbeats heartbeats;

  bool keeps_subscriptions = false;   ///< they survive provisioning, a firmware fault
  bool shares_subscriptions = false;  ///< all models have one list of groups
  /// A failed assertion stops it, as Nordic's code. It fails after Subscription Delete All or
  /// Overwrite of a model with many groups, or a TTL from 128 to 254.
  bool has_stopped = false;

  // Faults.
  std::set<std::string> deaf_to;                ///< prefixes of requests without an answer
  std::multiset<std::string> lost_requests;     ///< prefixes; loses one request for each
  std::multiset<std::string> lost_answers;      ///< prefixes; loses one answer for each
  std::map<std::string, std::uint8_t> refuses;  ///< status by prefix of the request
  std::map<std::string, std::string> lies;      ///< answer by prefix of the request, hex

  /// Returns true for both keys in phases 1 and 2 of a key refresh.
  bool hears(const Bytes& key) const {
    return net_key.empty() || key == net_key || (refresh_phase > 0 && key == new_net_key);
  }
  /// Returns the new key from phase 2 on.
  const Bytes& sending_key() const { return refresh_phase == 2 ? new_net_key : net_key; }
};

class FakeDevices {
 public:
  std::vector<FakeDevice> devices;
  /// Heartbeats that the second device receives from the first, and over how many hops. Others
  /// receive all of them directly.
  struct Hearing {
    unsigned count;
    std::uint8_t min_hops;
    std::uint8_t max_hops;
  };
  std::map<std::pair<std::uint16_t, std::uint16_t>, Hearing> hearing;
  bool is_scanning = false;
  /// Events that the board omits once each.
  std::set<std::uint8_t> lost_events;
  /// Closes the link once in place of this event (c2, reason 2).
  std::optional<std::uint8_t> closes_at;
  /// Fails provisioning once in place of this event (c9 with this code, then c2).
  std::optional<std::pair<std::uint8_t, std::uint8_t>> fails_at;
  /// Contexts that are still busy with an earlier link.
  std::set<std::uint8_t> busy_contexts;
  /// Device keys that the board holds, by handle.
  std::map<std::uint16_t, std::pair<std::uint16_t, Bytes>> device_keys;
  std::size_t max_device_keys = 10;
  std::size_t most_device_keys = 0;
  /// The board's network keys; it sends under the first.
  std::vector<Bytes> net_keys;
  std::uint32_t last_iv_index = 0;  ///< given to a device
  std::uint16_t context_count = 0;  ///< provisioning links that were opened

  /// Adds a device with the thesis's robot models: clients 0x0004 and 0x0006, server 0x0009,
  /// on/off, health.
  FakeDevice& add(std::uint8_t number);
  FakeDevice* at(std::uint16_t address);

  /// Returns the frames that answer a provisioning command; empty for other opcodes.
  std::optional<Bytes> execute(std::uint8_t opcode, ByteView params);
  /// Returns the answer to an access message under the device key with this handle.
  Bytes on_access(std::uint16_t devkey_handle, std::uint16_t destination, ByteView payload);
  /// Returns a device's answer to a configuration message, as hex.
  Bytes answer(FakeDevice& device, const std::string& request);
  /// Returns the devices' beacons while the board scans.
  Bytes beacons() const;
  /// Loses the contents of the board's RAM.
  void on_restart();

 private:
  Bytes provision(ByteView params);
  Bytes event(std::uint8_t opcode, Bytes params);
  Bytes capabilities();
  Bytes ecdh_request();
  Bytes complete(ByteView secret);
  Bytes add_device_key(ByteView params);
  std::optional<Bytes> answer_heartbeats(FakeDevice& device, const Bytes& request);
  static std::optional<Bytes> answer_state(FakeDevice& device, const std::string& request);
  static Bytes answer_refresh(FakeDevice& device, std::uint8_t status, const Bytes& request);
  static Bytes answer_publication(FakeDevice& device, std::uint8_t status, Bytes params);
  static Bytes answer_subscription(FakeDevice& device, std::uint8_t status, ByteView request);
  static Bytes answer_list(const FakeDevice& device, std::uint8_t status, ByteView request);

  Bytes board_public_;
  std::uint8_t context_ = 0;
  FakeDevice* joining_ = nullptr;
  std::uint16_t joining_address_ = 0;
  Bytes joining_net_key_;
};

}  // namespace slamgw::ble
