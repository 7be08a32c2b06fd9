// SPDX-License-Identifier: Apache-2.0
// One robot on BLE Mesh: three vendor models, an on/off server and a health server. No radio and no
// clock: Network delivers its messages and reports whether the board can receive.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "simulation/ble/access.hpp"
#include "simulation/ble/firmware.hpp"
#include "simulation/robot_body.hpp"
#include "simulation/tally.hpp"
#include "simulation/update_record.hpp"

namespace slamgw::sim::ble {

constexpr std::chrono::seconds reliable_timeout{60};
constexpr std::chrono::seconds health_interval{10};
constexpr std::chrono::seconds same_transaction{6};  ///< Generic OnOff: same TID, same command

struct RobotSettings {
  Address address = first_robot;  ///< 0 until provisioned
  unsigned number = 1;            ///< from 1
  std::uint8_t ttl = default_ttl;
  bool is_acknowledged = false;  ///< SET with repeats until STATUS, else SET_UNRELIABLE
  bool is_numbered = false;      ///< its SETs have a transaction number, and STATUS names it
  bool has_segment_timing = false;
  /// Nothing: no update is measured while one is in flight, so that `messages` are complete. Else
  /// one is measured each period, and `messages` includes those that could not be sent.
  std::optional<OnBusy> on_busy{};
  bool obeys = false;
  bool is_recorded = false;               ///< leaves events
  std::optional<std::uint64_t> messages;  ///< updates to send; nothing: no end
  Duration period = std::chrono::milliseconds{200};
};

class Robot {
 public:
  struct Outgoing {
    MeshMessage message;
    bool is_unacknowledged_update = false;
  };
  struct Publication {
    Address address = 0;
    std::uint8_t ttl = default_ttl;
    Duration period{};  ///< of periodic publications; 0: none
  };
  /// Destinations of the robot's models; a model without one does not publish.
  struct Publications {
    std::optional<Publication> min_com;
    std::optional<Publication> sensor_update;
    std::optional<Publication> health;
  };

  Robot(const RobotSettings& settings, const RobotBody& body);

  void on_start(TimePoint now);
  void on_deadline(const Publications& publications, TimePoint now);
  /// Call for a decrypted message to this robot.
  void on_message(const MeshMessage& message, TimePoint now);
  /// Call when an unacknowledged update is lost on the air.
  void on_update_dropped() { ++tally_.lost; }
  /// Call when the segments of its last message are not acknowledged, so that the transport repeats
  /// them.
  void on_unacknowledged_segments(const MeshMessage& message, TimePoint now);
  /// Call when its firmware has failed an assertion, which stops the robot.
  void on_failed_assertion();
  TimePoint deadline() const;
  std::optional<Outgoing> next_transmission();
  std::optional<UpdateEvent> next_event();

  /// Call with its address when its stack joins a mesh, and with 0 when it leaves.
  void set_address(Address address) { settings_.address = address; }
  bool has_sent_everything() const;
  const Tally& tally() const { return tally_; }

 private:
  /// A reliable message that waits for its STATUS; one at a time, as in Nordic's access layer.
  struct Reliable {
    MeshMessage message;
    Vendor status;
    std::uint64_t number;     ///< of an update; else 0
    Bytes status_parameters;  ///< required parameters of its STATUS; empty: any
    Duration interval;
    TimePoint repeat_at;
    TimePoint gives_up_at;
  };

  MeshMessage set_message(bool is_positions, const Bytes& parameters, const Publication& to);
  bool is_status_for_open(Vendor opcode, ByteView parameters) const;
  void publish_health(const std::optional<Publication>& to, TimePoint now);
  void produce(const Publications& publications, TimePoint now);
  void tick(const Publication& to, TimePoint now);
  void record(UpdateEvent::Kind kind, std::uint64_t number, Bytes payload = {});
  void cancel();
  void refuse(const Bytes& update);
  void publish(bool is_update, const Bytes& parameters, const Publication& to, TimePoint now);
  void repeat(TimePoint now);
  void transmit(const MeshMessage& message, TimePoint now);
  bool may_transmit(const MeshMessage& message, TimePoint now) const;
  void on_vendor(Vendor opcode, const MeshMessage& message, TimePoint now);
  void on_on_off(const MeshMessage& message, ByteView parameters, bool is_simple, bool wants_status,
                 TimePoint now);
  void on_command(std::string_view type, ByteView payload);
  void on_relayed(ByteView parameters);
  void answer(const MeshMessage& request, Bytes payload);

  RobotSettings settings_;
  RobotBody body_;
  bool is_gone_ = false;
  bool has_introduced_itself_ = false;
  TimePoint next_update_{};
  TimePoint first_update_{};  ///< when the first was measured; then `produced_` is above 0
  TimePoint next_health_{};
  std::uint64_t produced_ = 0;
  std::uint8_t transaction_ = 0;  ///< of the last numbered SET
  std::optional<Reliable> reliable_;
  TimePoint segmented_until_{};  ///< no other segmented message before
  bool is_on_ = true;
  struct Transaction {
    Address source;
    std::uint8_t tid;
    TimePoint at;
  };
  std::optional<Transaction> last_transaction_;
  std::deque<Outgoing> outbox_;
  std::deque<UpdateEvent> events_;
  Tally tally_;
};

}  // namespace slamgw::sim::ble
