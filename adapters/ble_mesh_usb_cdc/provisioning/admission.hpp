// SPDX-License-Identifier: Apache-2.0
// Takes devices into the mesh as nodes, one at a time: chooses the next device, gives it an
// address, and handles the result. Part of Provisioner.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner_part.hpp"

namespace slamgw::ble {

/// A device whose beacon says that it is not in a mesh.
struct Candidate {
  Uuid uuid{};
  std::optional<std::int8_t> rssi_dbm;
  TimePoint first_heard{};
  TimePoint last_heard{};
  TimePoint not_before{};  ///< of the next attempt
  int failures = 0;
  std::uint8_t elements = 1;  ///< as it reported at an earlier attempt
};

/// The devices that may join: when each was heard, and which is next. After each failure a device
/// waits longer, so that it does not hold up the others. Called by Admission.
class Candidates {
 public:
  /// A further device takes the place of the one that was silent for longest.
  static constexpr std::size_t max_candidates = 64;
  /// Beacons come every few seconds (Mesh Profile 1.0 section 3.9.2). After this silence a device
  /// counts as gone.
  static constexpr Duration max_silence = std::chrono::seconds{60};
  static constexpr Duration first_pause = std::chrono::seconds{5};
  static constexpr Duration max_pause = std::chrono::minutes{5};

  using Filter = std::function<bool(const Candidate&)>;

  void on_beacon(const UnprovisionedBeacon& beacon, TimePoint now);
  void on_failure(const Uuid& uuid, TimePoint now);
  void on_elements(const Uuid& uuid, std::uint8_t elements);
  void erase(const Uuid& uuid) { candidates_.erase(uuid); }

  const Candidate* find(const Uuid& uuid, TimePoint now) const;
  /// Returns the device with the fewest failures, then the first heard, of those that are due and
  /// wanted; null without one.
  const Candidate* next(const Filter& is_wanted, TimePoint now) const;
  /// The devices that were heard lately.
  std::vector<Candidate> all(TimePoint now) const;

 private:
  std::map<Uuid, Candidate> candidates_;
};

/// Returns 5 s, 10 s, 20 s ... after the first, second, third failure; at most five minutes.
Duration pause_after(int failures);

/// An operator's permission for new robots to join for a while although
/// `ble_mesh.provisioning.enabled` is false, and its events (`slam-gatewayctl ble permit-join`).
/// Forgotten when the daemon ends. Pure; part of Admission.
class JoinPermit {
 public:
  /// Maximum of events that are kept. A new one replaces the oldest.
  static constexpr std::size_t max_events = 256;

  /// `robot` is the name for the only robot that may join; empty: all may. Replaces an open permit;
  /// devices that are under way stay so.
  void open(std::chrono::seconds time, std::string robot, TimePoint now);
  void close() { until_.reset(); }
  bool is_open() const { return until_.has_value(); }
  /// Closes the permit when its time is over. Returns true if it was closed now.
  bool on_time(TimePoint now);
  std::optional<TimePoint> deadline() const { return until_; }

  /// Returns true if this device may join now.
  bool admits(const Uuid& uuid) const;
  /// Returns the name that the device will get; empty: as the configuration says.
  const std::string& robot() const { return robot_; }

  /// A device was chosen while the permit was open. The other events are noted only of such
  /// devices.
  void on_chosen(const Uuid& uuid);
  void on_joined(const Uuid& uuid, const std::string& robot);
  void on_configured(const Uuid& uuid, const std::string& robot);
  /// The device did not join, or could not be configured yet.
  void on_failed(const Uuid& uuid, const std::string& why);

  /// Returns `seconds_left`, `under_way` (devices that were chosen and have not ended), `last` (the
  /// number of the last event), and the `events` after number `after`: `number`, `event`
  /// (`joining`, `joined`, `configured`, `failed`), `uuid`, `robot`, `why`.
  std::string json(std::uint64_t after, TimePoint now) const;

 private:
  struct Event {
    std::uint64_t number = 0;
    std::string_view what;
    Uuid uuid{};
    std::string robot;
    std::string why;
  };

  void note(std::string_view what, const Uuid& uuid, std::string robot, std::string why);

  std::optional<TimePoint> until_;
  std::string robot_;
  std::optional<Uuid> named_;  ///< the device that joins to get the name
  std::set<Uuid> under_way_;
  std::deque<Event> events_;
  std::uint64_t last_number_ = 0;
};

class Admission : private ProvisionerPart {
 public:
  /// A node counts as reset by hand only if its beacon says so and it was not heard for this long.
  /// A robot that has nothing else to say publishes its health each 10 s, and one may be lost.
  static constexpr Duration reset_silence = std::chrono::seconds{25};
  /// The same for a node that the gateway has asked to leave the mesh.
  static constexpr Duration removal_silence = std::chrono::seconds{5};
  static constexpr Duration order_time_limit = std::chrono::seconds{150};

  /// Returns true during a conversation with the node: it must not be provisioned again then.
  using IsBusy = std::function<bool(const Node&)>;

  explicit Admission(const ProvisionerPart& shared);

  void on_start();
  void on_stop();
  void on_answered(const DeviceAnswered& answered) { elements_ = answered.elements; }
  void on_joined(const std::optional<Key>& device_key, TimePoint now) {
    if (joining_) take_in(*joining_, device_key, now);
  }
  void on_had_joined(const DeviceHadJoined& joined, TimePoint now);
  void on_join_ended(const JoinEnded& ended, TimePoint now);
  void on_link_up(TimePoint now) { up_since_ = now; }
  void on_link_down(const LinkIsDown& down, TimePoint now);

  /// Continues steps that have waited for the disk.
  void advance(TimePoint now);
  void choose_next(const IsBusy& is_busy, TimePoint now);

  bool wants_scan() const;
  bool is_idle() const { return !joining_ && !chosen_; }
  /// This device is joining now.
  bool is_joining(const Uuid& uuid) const { return joining_ == uuid; }
  /// This device is joining now, or next.
  bool is_chosen(const Uuid& uuid) const { return is_joining(uuid) || chosen_ == uuid; }

  /// Returns true if the node was not heard for this long.
  bool was_silent(const Node& node, Duration silence, TimePoint now) const;
  /// A message came from this unicast address.
  void on_heard(std::uint16_t address);
  /// Removes a node, or a device that may join, on an operator's order.
  void remove(Uuid uuid);

  JoinPermit& permit() { return permit_; }
  const JoinPermit& permit() const { return permit_; }
  Candidates& candidates() { return candidates_; }

 private:
  bool is_open() const { return settings_.provisioning.enabled || permit_.is_open(); }
  bool is_wanted(const Candidate& candidate, const IsBusy& is_busy, TimePoint now) const;
  bool reserve(const Candidate& candidate, const std::string& name, TimePoint now);
  void keep(const Uuid& uuid, std::uint16_t address, std::uint8_t elements,
            const std::string& name);
  void fail(const Uuid& uuid, const std::string& why, TimePoint now);
  void refuse(const Uuid& uuid, const std::string& why, TimePoint now);
  bool make_room();
  void begin_joining(TimePoint now);
  void keep_addresses(TimePoint now);
  void take_in(const Uuid& uuid, const std::optional<Key>& device_key, TimePoint now);
  void on_not_joined(const Uuid& uuid);
  void release(const Uuid& uuid);
  void warn_of_replay_list(const Node& node);

  std::optional<Key> static_oob_;
  Candidates candidates_;
  JoinPermit permit_;
  std::optional<Uuid> chosen_;  ///< has its address and waits for the disk
  std::optional<Uuid> joining_;
  bool is_stopping_ = false;
  TimePoint up_since_{};       ///< when the link came up: before that, no robot was heard
  std::uint8_t elements_ = 0;  ///< of the joining device, while it waits for addresses
};

}  // namespace slamgw::ble
