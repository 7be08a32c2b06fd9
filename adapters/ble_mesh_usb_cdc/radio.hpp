// SPDX-License-Identifier: Apache-2.0
// The seam between the mesh and its radio, in the words of the Mesh Profile: what provisioning,
// configuration and robots ask of a radio, and what it reports. Only nordic/ knows how Nordic's
// serial board is spoken to, so another radio can take its place.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>

#include "daemon/core/bytes.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

inline constexpr std::uint16_t last_unicast_address = 0x7fff;  // Mesh Profile section 3.4.2.2
/// Longest access message that a radio sends; old firmware sends less.
inline constexpr std::size_t max_send_bytes = 244;

using Key = std::array<std::uint8_t, 16>;
/// Of a device, most significant octet first.
using Uuid = std::array<std::uint8_t, 16>;

/// The secrets of one mesh. Never printed, never in a Notice.
struct MeshKeys {
  Key net_key{};
  Key app_key{};
  bool operator==(const MeshKeys&) const = default;
};

/// One access message to send. Urgent ones (acknowledgements) overtake the others.
struct Outgoing {
  std::uint16_t destination = 0;     ///< unicast
  std::optional<std::uint16_t> key;  ///< of `MessageReceived`; else the mesh's application key
  Bytes payload;
  bool is_urgent = false;
};

/// Sends access messages to robots. Called by Uplink and Downlink.
class Radio {
 public:
  virtual bool is_up() const = 0;
  /// Drops it when the link is down or the queue full: senders repeat. A message that is already
  /// waiting is not queued twice. A message longer than the firmware sends ends in SendRefused.
  virtual void send(Outgoing message, TimePoint now) = 0;
  /// Takes a message back if it still waits.
  virtual void withdraw(std::uint16_t destination, const Bytes& payload) = 0;

 protected:
  ~Radio() = default;
};

// Commands of the mesh to the radio.

/// Report devices that are in no mesh, or stop.
struct Scan {
  bool is_on = false;
};
/// Take this device in, one at a time. DeviceAnswered and DeviceJoined may come, then JoinEnded.
struct ProvisionDevice {
  Uuid uuid{};
  Key net_key{};
  std::uint32_t iv_index = 0;
  std::uint16_t address = 0;  ///< of the device's first element
  std::optional<Key> static_oob;
};
/// The answer to DeviceAnswered; `refusal` is empty when each element has an address on disk.
struct AnswerDevice {
  std::string refusal;
};
/// Get ready to speak with the node under this device key. Without one: the node's key is not
/// needed any more. Answered by DeviceKeyUsed.
struct UseDeviceKey {
  std::uint16_t address = 0;
  std::optional<Key> key = {};
};
struct SendUnderDeviceKey {
  std::uint16_t address = 0;
  Bytes access;
};
/// The mesh has other keys than the radio was started up with.
struct UseKeys {
  MeshKeys keys;
};
/// Answered by BoardCleared.
struct ClearBoard {};
/// It comes back without its replay list.
struct RestartBoard {};
/// The board sends from this address; the disk has it.
struct UseSource {
  std::uint16_t source = 0;
  std::uint16_t count = 1;  ///< of the addresses for a board without one
};
/// The disk does not have it yet.
struct DelaySource {
  std::string why;
};

/// A radio that goes down forgets what it was asked for.
using RadioCommand =
    std::variant<Scan, ProvisionDevice, AnswerDevice, UseDeviceKey, SendUnderDeviceKey, UseKeys,
                 ClearBoard, RestartBoard, UseSource, DelaySource>;

// Events that the radio reports.

/// Make keys for a new mesh and store them; answered by on_keys or on_keys_failed.
struct GenerateKeys {};

/// The radio did not send to `destination`; the mesh above repeats by its own rules.
struct SendRefused {
  std::uint16_t destination = 0;
  std::string why;
};

/// An access message for a unicast address of the gateway, or for a group that it hears.
struct MessageReceived {
  std::uint16_t source = 0;
  std::uint16_t key = 0;  ///< the radio's number for it; an answer goes under the same key
  bool is_under_device_key = false;  ///< the source's, which was added
  std::uint8_t ttl = 0;              ///< on arrival
  std::int8_t rssi_dbm = 0;
  std::uint16_t actual_length = 0;  ///< more than `payload` holds: the radio cut it short
  Bytes payload;                    ///< opcode first
};

struct IvUpdate {
  std::uint32_t iv_index = 0;
};

struct Heartbeat {
  std::uint16_t source = 0;
};

/// A device that is in no mesh says so.
struct UnprovisionedBeacon {
  Uuid uuid{};
  std::int8_t rssi_dbm = 0;
};

/// The device that joins has answered, and waits for AnswerDevice.
struct DeviceAnswered {
  std::uint8_t elements = 0;
};
/// It has become a node. Never printed.
struct DeviceJoined {
  Key device_key{};
};
/// ProvisionDevice is over; the radio can take in the next device.
struct JoinEnded {
  std::string failure = {};      ///< empty when the device has joined
  bool may_have_joined = false;  ///< despite the failure: it keeps the address until it is reset
  bool is_key_lost = false;      ///< it has joined, and only a reset by hand brings it back
  std::string remark = {};       ///< for the operator, after all else
};
/// The answer to UseDeviceKey.
struct DeviceKeyUsed {
  std::uint16_t address = 0;
  std::string problem;  ///< why the key was not added; else empty
};

struct LinkIsUp {
  std::string detail;
  std::string board;         ///< its UUID in hex; empty when it did not answer
  std::uint16_t source = 0;  ///< the address that it sends from
  bool has_kept = false;     ///< it restarted, and still had its address
};
/// Also sent while down, when the reason changes.
struct LinkIsDown {
  std::string why;
  std::optional<JoinEnded> join = {};  ///< there when a device was joining
};
/// How ClearBoard ended.
struct BoardCleared {
  std::string problem;  ///< empty when it is cleared
};

/// Which address should the board send from? Answered by UseSource or DelaySource.
struct SourceWanted {
  std::string board;            ///< its UUID in hex; empty when it did not answer
  std::uint16_t addresses = 0;  ///< that it has; 0: it has no sequence numbers of this mesh
  bool was_cleared = false;     ///< by an operator's order
};

/// What concerns taking in and configuring nodes.
using ProvisionerEvent = std::variant<SourceWanted, UnprovisionedBeacon, DeviceAnswered,
                                      DeviceJoined, JoinEnded, DeviceKeyUsed, BoardCleared>;
using RadioEvent = std::variant<LinkIsUp, LinkIsDown, GenerateKeys, SendRefused, MessageReceived,
                                Heartbeat, IvUpdate, ProvisionerEvent, Notice>;

}  // namespace slamgw::ble
