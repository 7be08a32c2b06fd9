// SPDX-License-Identifier: Apache-2.0
// The interface between the mesh and its radio, in the words of the Mesh Profile. It has the
// requests of provisioning, configuration and robots, and the radio's reports. Only nordic/ knows
// the protocol of Nordic's serial board, so another radio can take its place.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <variant>

#include "daemon/core/bytes.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

inline constexpr std::uint16_t last_unicast_address = 0x7fff;  // Mesh Profile section 3.4.2.2

using Key = std::array<std::uint8_t, 16>;
/// A device's UUID, most significant octet first.
using Uuid = std::array<std::uint8_t, 16>;

/// Fills a span with random octets fit for keys. Returns false if the system has no randomness.
using RandomSource = std::function<bool(std::span<std::uint8_t>)>;

/// The secrets of one mesh. Never printed, never in a Notice.
struct MeshKeys {
  Key net_key{};
  Key app_key{};
  bool operator==(const MeshKeys&) const = default;
};

/// The keys for a radio. During a key refresh the nodes use two pairs of keys.
struct RadioKeys {
  MeshKeys keys;                        ///< the radio sends and hears under these
  std::optional<MeshKeys> next = {};    ///< the radio hears under these, too
  std::optional<MeshKeys> former = {};  ///< a radio that still has these is cleared
  std::uint32_t iv_index = 0;           ///< the mesh's, as far as it is known
};

/// One access message to send. Urgent ones (acknowledgements) overtake the others.
struct Outgoing {
  std::uint16_t destination = 0;          ///< unicast, or a group, which does not acknowledge
  std::optional<std::uint16_t> key = {};  ///< MessageReceived::key; empty: the application key
  Bytes payload;
  bool is_urgent = false;
  bool is_under_device_key = false;  ///< the destination's device key, after DeviceKeyUsed
};

/// A device that joins.
struct ProvisionDevice {
  Uuid uuid{};
  Key net_key{};
  std::uint32_t iv_index = 0;
  std::uint16_t address = 0;      ///< of the device's first element
  std::optional<Key> static_oob;  ///< a device without it may not join
};
/// JoinEnded::failure of a device that is not taken in without ProvisionDevice::static_oob.
inline constexpr const char* lacks_static_oob =
    "the device says that it has no static OOB value: give it that of "
    "ble_mesh.provisioning.static_oob, or remove this key";

// Requests of a radio behind a serial port to its shell.

/// Write these octets to the port, in order.
struct WriteSerial {
  Bytes bytes;
};
/// Close the port, wait, open it again; answered by on_port_open or on_port_closed.
struct ReopenPort {
  Duration after{};
};

// Events that the radio reports.

/// Asks for the keys of a new mesh; answered by Radio::change_keys when they are on disk, or by
/// on_keys_failed.
struct KeysWanted {};

/// The radio did not send a message to `destination`. The mesh repeats messages by its own rules.
struct SendRefused {
  std::uint16_t destination = 0;
  std::string why;
};

/// An access message for a unicast address of the gateway, or for a group that it hears.
struct MessageReceived {
  std::uint16_t source = 0;
  std::uint16_t key = 0;  ///< the radio's number of the key; an answer is sent under the same key
  bool is_under_device_key = false;  ///< the source's device key, which was added
  std::optional<std::uint8_t> ttl;   ///< on arrival; empty if the radio does not report it
  std::optional<std::int8_t> rssi_dbm;
  std::uint16_t actual_length = 0;  ///< larger than the size of `payload` if the radio cut it short
  Bytes payload;                    ///< opcode first
};

struct IvUpdate {
  std::uint32_t iv_index = 0;
};

struct Heartbeat {
  std::uint16_t source = 0;
};

/// The beacon of a device that is not in a mesh.
struct UnprovisionedBeacon {
  Uuid uuid{};
  std::optional<std::int8_t> rssi_dbm;
};

/// The device that joins has answered, and waits for Radio::answer_device.
struct DeviceAnswered {
  std::uint8_t elements = 0;
};
/// The device has become a node. Never printed.
struct DeviceJoined {
  std::optional<Key> device_key;  ///< empty if the radio does not reveal it
};
/// A device has become a node whose Radio::provision has ended, or was called by an earlier daemon.
/// Never printed.
struct DeviceHadJoined {
  std::uint16_t address = 0;
  Key net_key{};
  Key device_key{};
};
/// Radio::provision has ended; the radio can take in the next device.
struct JoinEnded {
  std::string failure = {};      ///< empty when the device has joined
  bool may_have_joined = false;  ///< despite the failure; the device keeps its address until reset
  bool is_key_lost = false;      ///< the device has joined; only a reset by hand brings it back
  std::string remark = {};       ///< for the operator, at the end of the warning
};
/// The answer to Radio::use_device_key and forget_device_key.
struct DeviceKeyUsed {
  std::uint16_t address = 0;
  std::string problem;  ///< why messages under the key can't be sent; else empty
};

struct LinkIsUp {
  std::string detail;
  std::string radio;              ///< identifies the radio; empty if unknown
  std::uint16_t source = 0;       ///< the address that the radio sends from
  bool has_kept_address = false;  ///< the radio restarted and still had its address
};
/// The link is down. Also sent when the reason changes while the link is down.
struct LinkIsDown {
  std::string why;
  std::optional<JoinEnded> join = {};  ///< set if a device was joining
  bool is_restart = false;             ///< Radio::restart has asked for it
};
/// Radio::clear has ended.
struct RadioCleared {
  std::string problem;  ///< empty if the radio was cleared
};

/// Asks for the address to send from; answered by Radio::use_source or delay_source. A radio that
/// never loses its sequence numbers does not ask.
struct SourceWanted {
  std::string radio;            ///< as in LinkIsUp
  std::uint16_t addresses = 0;  ///< number that the radio has; 0: no sequence numbers of this mesh
  bool was_cleared = false;     ///< by an operator's order
};

/// The events about taking in and configuring nodes.
using ProvisionerEvent =
    std::variant<KeysWanted, SourceWanted, UnprovisionedBeacon, DeviceAnswered, DeviceJoined,
                 DeviceHadJoined, JoinEnded, DeviceKeyUsed, RadioCleared>;
using RadioEvent = std::variant<LinkIsUp, LinkIsDown, SendRefused, MessageReceived, Heartbeat,
                                IvUpdate, ProvisionerEvent, Notice>;
using RadioAction = std::variant<WriteSerial, ReopenPort, RadioEvent>;

/// A radio that goes down forgets all requests. No call leads back into the mesh: results are
/// actions.
class Radio {
 public:
  virtual ~Radio() = default;

  /// Returns the size of the longest access message that the radio sends.
  virtual std::size_t max_send_bytes() const = 0;
  /// Returns the number of senders that the replay list holds. The radio does not hear further
  /// senders.
  virtual std::size_t max_senders() const = 0;
  /// Returns true if the radio also hears messages to the addresses of its earlier lives.
  virtual bool hears_earlier_lives() const = 0;
  virtual Counters counters() const = 0;

  /// Queues a message. Drops it if the link is down, the queue is full or the device key is
  /// missing: senders repeat. A message that already waits is not queued twice.
  virtual void send(Outgoing message, TimePoint now) = 0;
  /// Takes a message back if it still waits.
  virtual void withdraw(std::uint16_t destination, const Bytes& payload) = 0;
  /// Returns true if nothing waits to be sent.
  virtual bool is_idle() const = 0;

  /// Starts or stops reporting devices that are not in a mesh.
  virtual void scan(bool is_on) = 0;
  /// Takes this device into the mesh; one device at a time. DeviceAnswered and DeviceJoined may
  /// follow, then JoinEnded.
  virtual void provision(const ProvisionDevice& device) = 0;
  /// Answers DeviceAnswered. `refusal` is empty if each element has an address on disk.
  virtual void answer_device(const std::string& refusal, TimePoint now) = 0;
  /// Ends the join under way with this failure, unless the device may have its address already.
  virtual void break_off_join(const std::string& why) = 0;
  /// Prepares messages under the node's device key; answered by DeviceKeyUsed. `key` is as in
  /// DeviceJoined.
  virtual void use_device_key(std::uint16_t address, const std::optional<Key>& key) = 0;
  /// Removes the node's device key; answered by DeviceKeyUsed.
  virtual void forget_device_key(std::uint16_t address) = 0;

  /// Answers KeysWanted.
  virtual void on_keys_failed(const std::string& why, TimePoint now) = 0;
  /// Call when the mesh's keys have changed, or are there. The link goes down if the keys change
  /// under which the radio sends.
  virtual void change_keys(const RadioKeys& keys, TimePoint now) = 0;

  /// Answers SourceWanted with an address that is on disk. `count` is the number of addresses for a
  /// radio that has none.
  virtual void use_source(std::uint16_t source, std::uint16_t count, TimePoint now) = 0;
  /// Answers SourceWanted: the address is not on disk yet.
  virtual void delay_source(const std::string& why) = 0;
  /// Erases keys, addresses and sequence numbers. Call only on an operator's order. Answered by
  /// RadioCleared.
  virtual void clear(TimePoint now) = 0;
  /// Restarts the radio as soon as it can, which empties its replay list. Returns false if the link
  /// is down, or if the radio has no list to empty.
  virtual bool restart(TimePoint now) = 0;

  // Inputs of the serial port, for a radio that leaves WriteSerial and ReopenPort.
  virtual void on_port_open(TimePoint) {}
  /// Call also when an attempt to open the port failed.
  virtual void on_port_closed(const std::string&, TimePoint) {}
  virtual void on_bytes(ByteView, TimePoint) {}

  /// Drain until empty after each call.
  virtual std::optional<RadioAction> next_action(TimePoint now) = 0;
  virtual std::optional<TimePoint> deadline() const = 0;
  virtual void on_deadline(TimePoint now) = 0;
};

}  // namespace slamgw::ble
