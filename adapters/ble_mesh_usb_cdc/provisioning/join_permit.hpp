// SPDX-License-Identifier: Apache-2.0
// For how long an operator lets new robots in although `ble_mesh.provisioning.enabled` is false,
// and what has come of it (`slam-gatewayctl ble permit-join`). Forgotten when the daemon ends.
// Pure; part of Admission.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <optional>
#include <set>
#include <string>

#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

class JoinPermit {
 public:
  static constexpr std::chrono::minutes longest{24 * 60};
  /// What happened, for those who watch; the oldest go first.
  static constexpr std::size_t max_events = 256;

  /// `robot`: the name of the one robot that may join; empty: all may. A permit that is open is
  /// replaced.
  void open(std::chrono::minutes time, std::string robot, TimePoint now);
  void close() { until_.reset(); }
  bool is_open() const { return until_.has_value(); }
  /// Closes it when its time is over; true when it was closed now.
  bool on_time(TimePoint now);
  std::optional<TimePoint> deadline() const { return until_; }

  /// Whether this device may join now.
  bool admits(const Uuid& uuid) const;
  /// The name that it will get; empty: as the configuration says.
  const std::string& robot() const { return robot_; }

  /// A device was chosen while the permit was open. The other events are noted only of such
  /// devices.
  void on_chosen(const Uuid& uuid);
  void on_joined(const Uuid& uuid, const std::string& robot);
  void on_configured(const Uuid& uuid, const std::string& robot);
  /// It did not join, or could not be configured yet.
  void on_failed(const Uuid& uuid, const std::string& why);

  /// `seconds_left`, `under_way` (devices that were chosen and have not ended), and the `events`
  /// after number `after`: `number`, `event` (`joining`, `joined`, `configured`, `failed`), `uuid`,
  /// `robot`, `why`.
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
  std::optional<Uuid> named_;  ///< the device that gets the name
  std::set<Uuid> under_way_;
  std::deque<Event> events_;
  std::uint64_t last_number_ = 0;
};

}  // namespace slamgw::ble
