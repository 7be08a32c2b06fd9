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

using Key = std::array<std::uint8_t, 16>;
/// Of a device, most significant octet first.
using Uuid = std::array<std::uint8_t, 16>;

/// The secrets of one mesh. Never printed, never in a Notice.
struct MeshKeys {
  Key net_key{};
  Key app_key{};
  bool operator==(const MeshKeys&) const = default;
};

/// The keys for a radio. During a key refresh the nodes use two pairs of keys.
struct RadioKeys {
  MeshKeys keys;                      ///< sends under these, and hears them
  std::optional<MeshKeys> next = {};  ///< hears these, too
  std::optional<MeshKeys> former =
      {};                      ///< a radio that still has these forgets all and starts again
  std::uint32_t iv_index = 0;  ///< of the mesh, as far as it is known
};

/// One access message to send. Urgent ones (acknowledgements) overtake the others.
struct Outgoing {
  std::uint16_t destination = 0;          ///< unicast, or a group: nothing acknowledges it then
  std::optional<std::uint16_t> key = {};  ///< of `MessageReceived`; else the mesh's application key
  Bytes payload;
  bool is_urgent = false;
  bool is_under_device_key = false;  ///< the destination's, after DeviceKeyUsed
};

/// A device that joins.
struct ProvisionDevice {
  Uuid uuid{};
  Key net_key{};
  std::uint32_t iv_index = 0;
  std::uint16_t address = 0;  ///< of the device's first element
  std::optional<Key> static_oob;
};

// What the radio asks of its shell, when it is behind a serial port.

/// To the port, in order.
struct WriteSerial {
  Bytes bytes;
};
/// Close the port, wait, open it again; answered by on_port_open or on_port_closed.
struct ReopenPort {
  Duration after{};
};

// Events that the radio reports.

/// Make keys for a new mesh and store them; answered by Radio::on_keys or on_keys_failed. The mesh
/// itself asks for those of a refresh, and has them stored.
struct GenerateKeys {
  bool is_refresh = false;
};

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
  std::optional<std::uint8_t> ttl;   ///< on arrival; nothing when the radio does not tell it
  std::optional<std::int8_t> rssi_dbm;
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
  std::optional<std::int8_t> rssi_dbm;
};

/// The device that joins has answered, and waits for Radio::answer_device.
struct DeviceAnswered {
  std::uint8_t elements = 0;
};
/// It has become a node. Never printed.
struct DeviceJoined {
  std::optional<Key> device_key;  ///< nothing when the radio keeps it to itself
};
/// Radio::provision is over; the radio can take in the next device.
struct JoinEnded {
  std::string failure = {};      ///< empty when the device has joined
  bool may_have_joined = false;  ///< despite the failure: it keeps the address until it is reset
  bool is_key_lost = false;      ///< it has joined, and only a reset by hand brings it back
  std::string remark = {};       ///< for the operator, after all else
};
/// The answer to Radio::use_device_key and forget_device_key.
struct DeviceKeyUsed {
  std::uint16_t address = 0;
  std::string problem;  ///< why messages under the key can't be sent; else empty
};

struct LinkIsUp {
  std::string detail;
  std::string radio;         ///< tells one radio from another; empty when that is unknown
  std::uint16_t source = 0;  ///< the address that it sends from
  bool has_kept = false;     ///< it restarted, and still had its address
};
/// Also sent while down, when the reason changes.
struct LinkIsDown {
  std::string why;
  std::optional<JoinEnded> join = {};  ///< there when a device was joining
};
/// How Radio::clear ended.
struct RadioCleared {
  std::string problem;  ///< empty when it is cleared
};

/// Which address should the radio send from? Answered by Radio::use_source or delay_source. A radio
/// that keeps its sequence numbers for ever does not ask.
struct SourceWanted {
  std::string radio;            ///< as in LinkIsUp
  std::uint16_t addresses = 0;  ///< that it has; 0: it has no sequence numbers of this mesh
  bool was_cleared = false;     ///< by an operator's order
};

/// What concerns taking in and configuring nodes.
using ProvisionerEvent = std::variant<SourceWanted, UnprovisionedBeacon, DeviceAnswered,
                                      DeviceJoined, JoinEnded, DeviceKeyUsed, RadioCleared>;
using RadioEvent = std::variant<LinkIsUp, LinkIsDown, GenerateKeys, SendRefused, MessageReceived,
                                Heartbeat, IvUpdate, ProvisionerEvent, Notice>;
using RadioAction = std::variant<WriteSerial, ReopenPort, RadioEvent>;

/// A radio that goes down forgets what it was asked for. No call leads back into the mesh: what
/// comes of it is an action.
class Radio {
 public:
  virtual ~Radio() = default;

  /// The longest access message that it sends.
  virtual std::size_t max_send_bytes() const = 0;
  /// How many senders its replay list keeps apart; it does not hear further ones.
  virtual std::size_t max_senders() const = 0;
  virtual Counters counters() const = 0;

  /// Drops it when the link is down, the queue full or the device key not there: senders repeat. A
  /// message that is already waiting is not queued twice.
  virtual void send(Outgoing message, TimePoint now) = 0;
  /// Takes a message back if it still waits.
  virtual void withdraw(std::uint16_t destination, const Bytes& payload) = 0;
  /// Nothing waits to be sent.
  virtual bool is_idle() const = 0;

  /// Report devices that are in no mesh, or stop.
  virtual void scan(bool is_on) = 0;
  /// Take this device in, one at a time. DeviceAnswered and DeviceJoined may come, then JoinEnded.
  virtual void provision(const ProvisionDevice& device) = 0;
  /// The answer to DeviceAnswered; `refusal` is empty when each element has an address on disk.
  virtual void answer_device(const std::string& refusal, TimePoint now) = 0;
  /// Get ready to speak with the node under its device key. `key`: as DeviceJoined told it.
  virtual void use_device_key(std::uint16_t address, const std::optional<Key>& key) = 0;
  /// It is not needed any more.
  virtual void forget_device_key(std::uint16_t address) = 0;

  /// The answer to GenerateKeys.
  virtual void on_keys(const MeshKeys& keys, TimePoint now) = 0;
  virtual void on_keys_failed(const std::string& why, TimePoint now) = 0;
  /// The mesh has other keys than the radio was started up with. The link goes down when those that
  /// it sends under change.
  virtual void change_keys(const RadioKeys& keys, TimePoint now) = 0;

  /// Sends from this address, which the disk has. `count`: of the addresses for a radio without
  /// one.
  virtual void use_source(std::uint16_t source, std::uint16_t count, TimePoint now) = 0;
  /// The disk does not have it yet.
  virtual void delay_source(const std::string& why) = 0;
  /// Forgets keys, addresses and sequence numbers, on an operator's word only; answered by
  /// RadioCleared.
  virtual void clear(TimePoint now) = 0;
  /// Comes back without its replay list. False when it can't now, or has none to lose.
  virtual bool restart(TimePoint now) = 0;

  /// Drain until empty after each call.
  virtual std::optional<RadioAction> next_action(TimePoint now) = 0;
  virtual std::optional<TimePoint> deadline() const = 0;
  virtual void on_deadline(TimePoint now) = 0;
};

}  // namespace slamgw::ble
