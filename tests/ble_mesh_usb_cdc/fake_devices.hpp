// SPDX-License-Identifier: Apache-2.0
// Devices behind a FakeBoard that wait to be provisioned and obey their configuration, and the
// board's half of it. Events and answers come at once; faults are scripted. Written from the
// protocol's description.
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
  Bytes net_key;  ///< with which it joined; empty: it hears whatever the board sends
  Bytes new_net_key;
  Bytes new_app_key;
  int refresh_phase = 0;
  std::vector<std::string> requests;  ///< configuration messages that it carried out, hex
  /// Groups of each model, by its element and identifier as they are on air, hex.
  std::map<std::string, std::set<std::uint16_t>> subscriptions;

  Bytes default_ttl{4};
  Bytes relay{1, 0x0a};  ///< on, three times, 20 ms apart
  Bytes network_transmit{0};

  struct Heartbeats {
    std::uint16_t publishes_to = 0;
    std::uint16_t source = 0;  ///< that it counts
    std::uint16_t destination = 0;
    unsigned count = 0;
    std::uint8_t min_hops = 0x7f;
    std::uint8_t max_hops = 0;
  };
  Heartbeats heartbeats;

  bool keeps_subscriptions = false;   ///< they outlive provisioning, as with code that has a fault
  bool shares_subscriptions = false;  ///< all models have one list of groups
  /// As robots that run Nordic's code do: Subscription Delete All and Overwrite (of a model with
  /// many groups) and a TTL from 128 to 254 stop it on a failed assertion, and it answers no more.
  bool has_stopped = false;

  // Faults.
  std::set<std::string> deaf_to;                ///< requests that begin so get no answer
  std::multiset<std::string> lost_requests;     ///< one that begins so is lost, for each
  std::multiset<std::string> lost_answers;      ///< the answer to one that begins so, for each
  std::map<std::string, std::uint8_t> refuses;  ///< requests that begin so: status
  std::map<std::string, std::string> lies;      ///< requests that begin so: this answer, hex

  /// In phases 1 and 2 of a key refresh it hears both keys.
  bool hears(const Bytes& key) const {
    return net_key.empty() || key == net_key || (refresh_phase > 0 && key == new_net_key);
  }
  /// From phase 2 on it sends under the new key.
  const Bytes& sending_key() const { return refresh_phase == 2 ? new_net_key : net_key; }
};

class FakeDevices {
 public:
  std::vector<FakeDevice> devices;
  /// How many heartbeats the second device hears of the first, and over how many hops; else all of
  /// them directly.
  struct Hearing {
    unsigned count;
    std::uint8_t min_hops;
    std::uint8_t max_hops;
  };
  std::map<std::pair<std::uint16_t, std::uint16_t>, Hearing> hearing;
  bool is_scanning = false;
  /// Events that the board does not send, the next time each.
  std::set<std::uint8_t> lost_events;
  /// At this event the link closes instead (c2, reason 2), once.
  std::optional<std::uint8_t> closes_at;
  /// At this event provisioning fails instead (c9, this code; then c2), once.
  std::optional<std::pair<std::uint8_t, std::uint8_t>> fails_at;
  /// Contexts that wait for the end of an earlier link.
  std::set<std::uint8_t> busy_contexts;
  /// Device keys that the board holds, by handle.
  std::map<std::uint16_t, std::pair<std::uint16_t, Bytes>> device_keys;
  std::size_t max_device_keys = 10;
  std::size_t most_device_keys = 0;
  /// The board's network keys: first the one that it sends under.
  std::vector<Bytes> net_keys;
  std::uint32_t last_iv_index = 0;  ///< that a device was given
  std::uint16_t context_count = 0;  ///< provisioning links that were opened

  /// A device with the thesis's robot models: clients 0x0004 and 0x0006, server 0x0009, on/off,
  /// health.
  FakeDevice& add(std::uint8_t number);
  FakeDevice* at(std::uint16_t address);

  /// A provisioning command; nothing for opcodes of others. The answer's frames.
  std::optional<Bytes> execute(std::uint8_t opcode, ByteView params);
  /// An access message under the device key with this handle; what comes back.
  Bytes on_access(std::uint16_t devkey_handle, std::uint16_t destination, ByteView payload);
  /// What a device answers to a configuration message, as hex.
  Bytes answer(FakeDevice& device, const std::string& request);
  /// What the devices say while the board scans.
  Bytes beacons() const;
  /// The board has lost what was in RAM.
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
