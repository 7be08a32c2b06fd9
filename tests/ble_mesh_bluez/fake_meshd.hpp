// SPDX-License-Identifier: Apache-2.0
// A bluetooth-meshd with robots in reach, as values. It follows recordings of 5.66 and 5.82, but
// also refuses calls that violate their description. Answers arrive at once, in the order in which
// meshd sends them.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>

#include "adapters/ble_mesh_bluez/meshd_call.hpp"
#include "tests/ble_mesh_usb_cdc/fake_devices.hpp"

namespace slamgw::ble {

/// A local node, as meshd has it on disk.
struct FakeNode {
  Uuid uuid{};
  Key device_key{};
  Key net_key{};
  std::uint32_t iv_index = 0;
  std::uint16_t address = 0;
  bool is_final = false;  ///< its token was accepted
  std::optional<Key> subnet = {};
  std::optional<Key> app_key = {};      ///< in the database
  std::optional<Key> own_app_key = {};  ///< of the node itself
  std::map<std::uint16_t, Key> remote_keys = {};
  std::set<std::uint16_t> subscriptions = {};
  bool is_bound = false;
  int ttl = 127;
  int transmit = 0;
  std::uint32_t sequence_number = 0;
  bool is_replaying = false;  ///< its sequence number is lower than one it has used
};

class FakeMeshd {
 public:
  FakeDevices robots;
  std::map<std::uint64_t, FakeNode> nodes;  ///< by token
  std::deque<MeshdEvent> events;            ///< for the gateway
  std::deque<Send> sent;                    ///< application messages
  std::set<std::string> broken_rules;       ///< rules of the interface that calls have violated
  int imports = 0;

  // Faults.
  bool is_without_controller = false;  ///< has its bus name, but no interfaces
  bool does_not_answer = false;
  bool does_not_complete = false;  ///< no JoinComplete follows an import
  bool has_other_keys = false;     ///< refuses the keys of each node
  std::string fails_to_join;       ///< the reason; once
  std::int16_t rssi = -60;

  void call(const CallMeshd& wanted);
  void accept_token();
  void give_address(std::optional<std::uint16_t> address);
  /// Restarts; the state on disk stays.
  void restart();
  /// Call when the application leaves the bus.
  void detach() { attached_.reset(); }
  /// Delivers a robot's message if an application is attached.
  void say(std::uint16_t source, Bytes payload);
  /// Sends the beacons of robots in no mesh.
  void beacon();
  const FakeNode* attached() const { return attached_ ? &nodes.at(*attached_) : nullptr; }

 private:
  void take(const Attach& call, MeshdAnswer& answer);
  void take(const Import& call, MeshdAnswer& answer);
  void take(const Leave& call, MeshdAnswer& answer);
  void take(const ImportSubnet& call, MeshdAnswer& answer);
  void take(const ImportAppKey& call, MeshdAnswer& answer);
  void take(const ImportRemoteNode& call, MeshdAnswer& answer);
  void take(const ExportKeys& call, MeshdAnswer& answer);
  void take(const UnprovisionedScan& call, MeshdAnswer& answer);
  void take(const UnprovisionedScanCancel& call, MeshdAnswer& answer);
  void take(const AddNode& call, MeshdAnswer& answer);
  void take(const Send& call, MeshdAnswer& answer);
  void take(const DevKeySend& call, MeshdAnswer& answer);
  void take(const GetAddresses& call, MeshdAnswer& answer);
  void take(const GetIvIndex& call, MeshdAnswer& answer);
  FakeNode* node(MeshdAnswer& answer);
  void configure_own(FakeNode& node, const Bytes& request);
  void demand(bool is_right, const std::string& rule) {
    if (!is_right) broken_rules.insert(rule);
  }

  std::optional<std::uint64_t> attached_;
  std::optional<std::uint64_t> unaccepted_;  ///< JoinComplete has no answer yet
  std::uint64_t last_token_ = 0x815320361e31bae0;
  bool is_scanning_ = false;
  std::set<Bytes> reported_;  ///< devices reported by this scan
  std::optional<Bytes> joining_;
};

}  // namespace slamgw::ble
