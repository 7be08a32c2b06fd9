// SPDX-License-Identifier: Apache-2.0
// Calls of org.bluez.mesh (BlueZ's doc/mesh-api.txt) that the gateway makes, and the answers and
// events of BlueZ's bluetooth-meshd, as values. Both keys have index 0. io/meshd_bus.hpp puts the
// calls on D-Bus.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/radio.hpp"

namespace slamgw::ble {

// Calls of Network1.

/// Takes over a node that meshd keeps; its token proves that the node is the gateway's.
struct Attach {
  std::uint64_t token = 0;
};
/// Makes a node of this mesh. JoinComplete follows the answer.
struct Import {
  Uuid uuid{};
  Key device_key{};
  Key net_key{};
  std::uint32_t iv_index = 0;
  std::uint16_t address = 0;
};
/// Removes a node, with its sequence numbers and its replay list.
struct Leave {
  std::uint64_t token = 0;
};

// Calls of Management1: the database of keys, and joining devices.

struct ImportSubnet {
  Key net_key{};
};
struct ImportAppKey {
  Key app_key{};
};
struct ImportRemoteNode {
  std::uint16_t address = 0;
  Key device_key{};
};
struct ExportKeys {};
struct UnprovisionedScan {};
struct UnprovisionedScanCancel {};
struct AddNode {
  Uuid uuid{};
};

// Calls and properties of Node1.

struct Send {
  std::uint16_t destination = 0;
  std::uint16_t key = 0;  ///< index of an application key
  Bytes payload;
};
/// Sends under the device key of the destination, which may be the node itself.
struct DevKeySend {
  std::uint16_t destination = 0;
  Bytes payload;
};
struct GetAddresses {};
struct GetIvIndex {};

using MeshdCall = std::variant<Attach, Import, Leave, ImportSubnet, ImportAppKey, ImportRemoteNode,
                               ExportKeys, UnprovisionedScan, UnprovisionedScanCancel, AddNode,
                               Send, DevKeySend, GetAddresses, GetIvIndex>;

/// Make this call; a MeshdAnswer with its number follows.
struct CallMeshd {
  std::uint64_t number = 0;
  MeshdCall call;
};
/// Answer JoinComplete: the token is on disk.
struct AcceptToken {};
/// Answer RequestProvData; without an address, the device is refused.
struct GiveAddress {
  std::optional<std::uint16_t> address;
};
/// Leave the bus and come back, so that meshd releases the node; MeshdCame or MeshdGone follows.
struct Reconnect {};
using MeshdRequest = std::variant<CallMeshd, AcceptToken, GiveAddress, Reconnect>;

/// meshd, or a new one in its place, came to the bus.
struct MeshdCame {};
/// meshd or the bus has gone. Open calls get no answer any more.
struct MeshdGone {
  std::string why;
};
/// meshd, or the bus in its place, has answered a call.
struct MeshdAnswer {
  std::uint64_t number = 0;
  std::string error = {};                         ///< name of the D-Bus error; empty: success
  std::string why = {};                           ///< the error's text
  std::map<std::uint16_t, Key> device_keys = {};  ///< to ExportKeys, by address. Never printed.
  std::uint32_t iv_index = 0;                     ///< to GetIvIndex
  std::uint16_t address = 0;                      ///< to GetAddresses: of the first element

  bool is_success() const { return error.empty(); }
};
/// meshd has made the node; AcceptToken answers this.
struct JoinComplete {
  std::uint64_t token = 0;
};
struct ScanResult {
  std::int16_t rssi = 0;
  Bytes data;  ///< begins with the UUID
};
/// meshd has asked for the static OOB value, and has it now. It asks before RequestProvData, and
/// not at all for a device that says that it has none.
struct StaticOobGiven {};
/// A joining device needs an address; GiveAddress answers this.
struct RequestProvData {
  std::uint8_t elements = 0;
};
struct AddNodeComplete {
  Uuid uuid{};
  std::uint16_t address = 0;
};
struct AddNodeFailed {
  Uuid uuid{};
  std::string why;
};
/// MessageReceived of Element1; radio.hpp has taken that name already.
struct AppMessage {
  std::uint16_t source = 0;
  std::uint16_t key = 0;
  Bytes payload;
};
struct DevKeyMessage {
  std::uint16_t source = 0;
  bool is_remote = false;  ///< under the source's device key, not the own node's
  Bytes payload;
};
using MeshdEvent =
    std::variant<MeshdCame, MeshdGone, MeshdAnswer, JoinComplete, ScanResult, StaticOobGiven,
                 RequestProvData, AddNodeComplete, AddNodeFailed, AppMessage, DevKeyMessage>;

}  // namespace slamgw::ble
